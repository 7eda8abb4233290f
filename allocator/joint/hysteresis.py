"""Hysteresis of a joint, and its equilibrium angles without friction and after a history of pressures.

The hysteresis is a Prandtl–Ishlinskii operator of the static angle, the equilibrium without hysteresis.

    θ = H[u] = w_0 u + Σ w_i p_i,    p_i(k) = max(u_k - ρ_i, min(u_k + ρ_i, p_i(k-1)))       u: static angle, p_i: plays
    ρ_i = r_i s(P1 + P2),            s = s_0 + (1 - s_0) (P1 + P2)/5 bar

If all partial sums W_j = w_0 + … + w_j are positive, H is invertible, and its inverse is another such operator (Krejčí
& Kuhnen 2001; Kuhnen 2003), so feed-forward through hysteresis needs no iteration:

    r'_j = Σ_{i≤j} w_i (r_j - r_i),   w'_0 = 1/w_0,   w'_j = -w_j/(W_j W_{j-1})                               [PI]

its plays p'_j = W_j p_j + Σ_{i>j} w_i p_i, whose neighbours differ by p'_j - p'_{j-1} = W_{j-1} (p_j - p_{j-1}).

Plays of constant widths are never further apart than their widths differ: |p_j - p_{j-1}| ≤ ρ_j - ρ_{j-1}. Where the
widths shrink with P1 + P2, the differences are cut to this and the widest play is unchanged. This holds for p and p',
whose differences are proportional, so the inverse is also exact for varying widths.

P. Krejčí & K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. Control Theory Appl. 148
(2001) 185–192; K. Kuhnen, "Modeling, identification and compensation of complex hysteretic nonlinearities", European
Journal of Control 9 (2003) 407–418.

The weights are those at the `stiffness` K_0 if the stops of H⁻¹ have springs of their own, k_i = κ_i K_0, like friction
in the sleeves of muscles; without it the springs are shares κ_i of K, so that the weights hold at any stiffness.

A history of pressures is quasi-static: only the order counts, not the times. Its angles are H of the static angles.
With springs of their own, or with friction μ alone, each angle is the root of

    T(θ, P) - Σ k_i e_i = load,              e_i = max(-ρ_i, min(e_i0 + Δθ, ρ_i))
    T(θ, P) - μ (a1 F1 + a2 F2) z = load,    z = s - (s - z_0) exp(-|Δθ|/δ),  s = sign(Δθ)          Dahl 1968

with e_i0 or z_0 of the previous angle: exact for any rotation in one direction between two pressures.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from math import copysign, exp, inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value, is_symbol, rising_roots
from allocator.errors import InvalidInput
from allocator.joint.gravity import Gravity
from allocator.units import BAR, DEG

FILLED = 5 * BAR  # P1 + P2 [Pa] of the given widths
PRESLIDING = 0.5 * DEG  # δ of measured joints in slow sweeps [rad]
NO_GAIN = 1e-12  # a smaller deviation of a gain from 1 is rounding
_PIECES = 32  # of the way to the end of the joint range in the search for the nearest root


class Slip(NamedTuple):
    """Hysteresis as friction: Maxwell's springs in series with sliders, see `PrandtlIshlinskii.slip`."""

    springs: tuple[float, ...]  # κ_i [-], shares of the isobaric stiffness K(θ, P1, P2); or k_i [N·m/rad]
    widths: tuple[float, ...]  # r'_i, half widths of the plays where P1 + P2 = 5 bar [rad]; inf: it never slips
    base: float  # s_0 [-], share of the widths without pressure
    gain: float = 1.0  # W_n [-], of wide motions
    elastic: bool = True  # whether the springs are shares of K

    @property
    def with_gain(self) -> "Slip":
        """The same with the gain as an element that never slips."""
        if abs(self.gain - 1) <= NO_GAIN:
            return self._replace(gain=1.0)
        return Slip((*self.springs, 1 / self.gain - 1), (*self.widths, inf), self.base)


@dataclass(frozen=True)
class PrandtlIshlinskii:
    """Prandtl–Ishlinskii operator H, given by its weights and thresholds. The caller stores its memory, the plays.

    Angles in rad, pressures in Pa. Everything takes floats or arrays (the plays are rows: (n,) or (n, …)), and `moved`
    and `output` also CasADi symbols (plays: a column).
    """

    weights: tuple[float, ...] = (1.0,)  # w_0, …, w_n [-]
    thresholds: tuple[float, ...] = ()  # r_1 < … < r_n, half widths of the plays where P1 + P2 = 5 bar [rad]
    base: float = field(default=1.0, kw_only=True)  # s_0 [-], share of the widths without pressure
    stiffness: float | None = field(default=None, kw_only=True)  # K_0 [N·m/rad] of the weights; None: they hold at any

    def __post_init__(self) -> None:
        """Check that the operator can be inverted."""
        for name, unit in (("weights", "-"), ("thresholds", "rad")):
            values = checks.real(name, getattr(self, name), unit)
            if values.ndim != 1:
                raise InvalidInput(f"{name} = {checks.brief(getattr(self, name))} have to be a row of numbers [{unit}]")
            object.__setattr__(self, name, tuple(values.tolist()))
        object.__setattr__(self, "base", checks.number("base", self.base, "share of the widths"))
        if len(self.weights) != len(self.thresholds) + 1:
            raise InvalidInput(
                f"{len(self.weights)} weights for {len(self.thresholds)} thresholds: there is one weight more, w_0"
            )
        if not all(a < b for a, b in pairwise((0.0, *self.thresholds))):
            raise InvalidInput(f"thresholds = {self.thresholds} rad have to be positive and to increase")
        if self.thresholds:
            checks.angle("thresholds", self.thresholds)
        if not all(slope > 0 for slope in self.slopes):
            raise InvalidInput(f"weights = {self.weights}: w_0 and all sums w_0 + … + w_i have to be positive")
        if not 0 < self.base <= 1:
            raise InvalidInput(f"base = {self.base!r} has to be above 0, and 1 at most")
        if self.stiffness is not None:
            object.__setattr__(self, "stiffness", checks.positive("stiffness", self.stiffness, "N·m/rad"))
            if abs(self.gain - 1) > NO_GAIN:
                raise InvalidInput(f"weights = {self.weights} at one stiffness have to add up to 1, not {self.gain:g}")

    @property
    def size(self) -> int:
        """n, the number of plays."""
        return len(self.thresholds)

    @cached_property
    def slopes(self) -> tuple[float, ...]:
        """W_0, …, W_n [-]: dθ/du while the first j plays slide."""
        return tuple(np.cumsum(self.weights).tolist())

    @property
    def gain(self) -> float:
        """W_n [-], dθ/du of wide motions."""
        return self.slopes[-1]

    def scale(self, filled: Value) -> Value:
        """Return s [-], the widths at P1 + P2 = `filled` [Pa] relative to those at 5 bar."""
        return self.base + (1 - self.base) * filled / FILLED

    # --- forwards ---------------------------------------------------------------------------------------------------

    def at_rest(self, u: Value) -> Value:
        """Return the plays of a joint without a history at the static angle `u` [rad]: all equal `u`."""
        if is_symbol(u):
            import casadi as ca

            return ca.repmat(u, self.size, 1)
        u = np.asarray(u, float)
        return np.repeat(u[None], self.size, axis=0)

    def moved(self, plays: Value, u: Value, filled: Value = FILLED) -> Value:
        """Return the `plays` [rad] after a monotonic motion of the static angle to `u` [rad] at P1 + P2 = `filled`."""
        s = self.scale(filled)
        known = [plays[i] for i in range(self.size)]
        for i in range(self.size - 2, -1, -1):
            gap = s * (self.thresholds[i + 1] - self.thresholds[i])
            known[i] = known[i + 1] + _clipped(plays[i] - plays[i + 1], -gap, gap)
        moved = [_clipped(p, u - s * r, u + s * r) for p, r in zip(known, self.thresholds, strict=True)]
        if any(is_symbol(p) for p in moved):
            import casadi as ca

            return ca.vertcat(*moved)
        return np.array(moved) if moved else np.zeros((0, *np.shape(u)))

    def output(self, plays: Value, u: Value) -> Value:
        """Return θ = w_0 u + Σ w_i p_i [rad]."""
        return self.weights[0] * u + sum(w * plays[i] for i, w in enumerate(self.weights[1:]))

    def step(self, plays: Value, u: Value, filled: Value = FILLED) -> tuple[Value, Value]:
        """Return θ [rad] and the plays after the static angle has moved to `u` [rad]."""
        plays = self.moved(plays, u, filled)
        return self.output(plays, u), plays

    def run(self, u: ArrayLike, filled: ArrayLike = FILLED, plays: Array | None = None) -> Array:
        """Return θ (m,) [rad] for the static angles `u` (m,) [rad] in order, with P1 + P2 = `filled` (m,) [Pa].

        It begins with `plays` (n,) [rad], by default at rest at the first angle. Raises `InvalidInput` unless angles
        and pressures are rows of finite numbers.
        """
        u, filled = checks.broadcast(u=checks.real("u", u, "rad"), filled=checks.pressure("filled", filled))
        if u.ndim != 1:
            raise InvalidInput(f"u has the shape {u.shape}: it has to be a row of angles [rad], one after the other")
        if not u.size:
            return np.zeros(0)
        if (wrong := self.scale(filled) <= 0).any():
            raise InvalidInput(
                f"filled{checks.at(filled, wrong)} Pa leaves no width to the plays: P1 + P2 is too small"
            )
        start = self.at_rest(u[0]) if plays is None else checks.real("plays", plays, "rad")
        if start.shape != (self.size,):
            raise InvalidInput(f"plays = {checks.brief(plays)} have to be {self.size} angles [rad], one for each play")
        passed = np.empty((self.size, u.size))
        pass_plays(u.tolist(), self.scale(filled).tolist(), self.thresholds, start.tolist(), passed)
        return np.asarray(self.output(passed, u))

    # --- backwards --------------------------------------------------------------------------------------------------

    @cached_property
    def inverse(self) -> "PrandtlIshlinskii":
        """H⁻¹, which maps the angle θ to the static angle u   [PI]. Its inverse is H."""
        r, w, W = (0.0, *self.thresholds), self.weights, self.slopes
        thresholds = tuple(sum(w[i] * (r[j] - r[i]) for i in range(j)) for j in range(1, len(r)))
        weights = tuple(-w[j] / (W[j] * W[j - 1]) for j in range(1, len(r)))
        return PrandtlIshlinskii((1 / w[0], *weights), thresholds, base=self.base, stiffness=self.stiffness)

    def stiffened(self, factor: float) -> "PrandtlIshlinskii":
        """Return the operator, of gain 1, whose springs as friction are stiffer by a `factor`."""
        back = self.inverse
        springs = tuple(factor * w for w in back.weights[1:])
        return replace(back, weights=(1 - sum(springs), *springs)).inverse

    @cached_property
    def slip(self) -> Slip:
        """Hysteresis as friction: Maxwell slip with springs in proportion to the stiffness K, or of their own.

        The muscles balance a load if T(u, P) = load at u = H⁻¹[θ]. In terms of the angle, friction has the torque

            T_f = T(θ, P) - T(u, P) ≈ K (u - θ) = K [(1/W_n - 1) θ + Σ κ_i e_i],     κ_i = -w'_i,   e_i = θ - p'_i

        in which the stops e_i = clip(e_i + dθ, ±ρ'_i) are those of Maxwell slip (`mpc.model.friction.maxwell_slip`),
        with springs κ_i K [N·m/rad], or κ_i K_0, and half widths r'_i s(P1 + P2). The gain W_n is not friction but
        belongs to the static joint; with W_n = 1 only the stops remain. Raises `InvalidInput` if a weight w_i is
        negative: such elements would push.
        """
        if any(w < 0 for w in self.weights[1:]):
            raise InvalidInput(f"weights = {self.weights}: hysteresis with a negative weight is no friction")
        back = self.inverse
        K = 1.0 if self.stiffness is None else self.stiffness
        springs = tuple(-w * K for w in back.weights[1:])
        return Slip(springs, back.thresholds, self.base, self.gain, elastic=self.stiffness is None)


def pass_plays(u: Array, s: Array, r: Array | tuple[float, ...], plays: Array, out: Array) -> None:
    """Fill `out` (n, m) with the plays [rad] of half widths r (n,) [rad] for static angles u (m,) [rad].

    The widths are s (m,) times as wide. It is `PrandtlIshlinskii.moved` sample by sample, in plain Python for numba.
    `plays` (n,) are the initial ones, and the last ones on return.
    """
    n = len(r)
    for k in range(len(u)):
        at, scale, deeper, narrower = u[k], s[k], 0.0, 0.0
        for i in range(n - 1, -1, -1):
            known = plays[i]
            if i < n - 1:
                gap = scale * (r[i + 1] - r[i])
                narrower = deeper + max(-gap, min(gap, known - narrower))
            else:
                narrower = known
            deeper, narrower = narrower, known  # this play after and before the cut
            plays[i] = max(at - scale * r[i], min(at + scale * r[i], deeper))
            out[i, k] = plays[i]


def _clipped(x: Value, low: Value, high: Value) -> Value:
    """Return max(low, min(high, x)) of numbers, arrays or CasADi symbols."""
    if any(is_symbol(value) for value in (x, low, high)):
        import casadi as ca

        return ca.fmax(low, ca.fmin(high, x))
    return np.maximum(low, np.minimum(high, x))


# --- after a history of pressures -----------------------------------------------------------------------------------


def dahl(z: float, motion: float, presliding: float = PRESLIDING) -> float:
    """Return the state z [-] of Dahl's friction after a rotation by `motion` [rad] in one direction."""
    s = copysign(1.0, motion)
    return s - (s - z) * exp(-abs(motion) / presliding)


def through_plays(H: PrandtlIshlinskii, u: Array, filled: Array) -> Array:
    """Return θ (m,) [rad] for the static angles u (m,) [rad], NaN for NaN, which keeps the memory."""
    theta, known = np.full(u.size, np.nan), np.isfinite(u)
    theta[known] = H.run(u[known], filled[known])
    return theta


class Stops(NamedTuple):
    """Stops with springs of their own; the memory is e_i [rad]."""

    operator: PrandtlIshlinskii

    @property
    def begun(self) -> Array:
        """Memory (n,) without a motion before."""
        return np.zeros(self.operator.size)

    def moved(self, memory: Array, motion: float, filled: float) -> Array:
        """Return the memory after a rotation by `motion` [rad] in one direction at P1 + P2 = `filled` [Pa]."""
        width = self.operator.scale(filled) * np.array(self.operator.slip.widths)
        return np.clip(memory + motion, -width, width)

    def torque(self, memory: Array, pull: float) -> float:
        """Return Σ k_i e_i [N·m]."""
        return float(np.dot(self.operator.slip.springs, memory))


class Dahl(NamedTuple):
    """Dahl's friction of the muscles; the memory is z (1,) [-]."""

    mu: float  # μ [-]

    @property
    def begun(self) -> Array:
        """Memory (1,) without a motion before."""
        return np.zeros(1)

    def moved(self, memory: Array, motion: float, filled: float) -> Array:
        """Return the memory after a rotation by `motion` [rad] in one direction."""
        return np.array([dahl(float(memory[0]), motion)])

    def torque(self, memory: Array, pull: float) -> float:
        """Return μ z times the `pull` a1 F1 + a2 F2 [N·m]."""
        return self.mu * float(memory[0]) * pull


def through_friction(joint: "AntagonistJoint", T: float, friction: Stops | Dahl, P1: Array, P2: Array) -> Array:
    """Return θ (m,) [rad] with the load `T` [N·m] at the pressures P1, P2 (m,) [Pa] in order.

    It begins at rest without friction. NaN where the joint would leave its range, which keeps the memory. Raises
    `InvalidInput` if it rests nowhere at first.
    """
    theta, memory, found = float(joint.equilibrium(P1[0], P2[0], T)), friction.begun, np.full(P1.size, np.nan)
    if np.isnan(theta):
        raise InvalidInput("at the first pressures of the history the joint rests at no angle of its range")
    for k, (one, two) in enumerate(zip(P1.tolist(), P2.tolist(), strict=True)):

        def excess(at: float, one: float = one, two: float = two, memory: Array = memory, back: float = theta) -> float:
            agonist, antagonist = joint.sides(at)
            t1, t2 = agonist.torque(one), antagonist.torque(two)
            return float(t1 + t2 - friction.torque(friction.moved(memory, at - back, one + two), t1 - t2) - T)

        moved = _settled(excess, theta, joint.angle_range)
        if np.isfinite(moved):
            memory = friction.moved(memory, moved - theta, one + two)
            found[k] = theta = moved
    return found


def _settled(balance: Callable[[float], float], theta: float, ends: tuple[float, float]) -> float:
    """Return the first root [rad] of the falling `balance` from `theta` in the direction of the torque, else NaN."""
    from scipy.optimize import brentq

    here = balance(theta)
    if here == 0:
        return theta
    way = np.linspace(theta, ends[1] if here > 0 else ends[0], _PIECES + 1)
    for near, far in zip(way[:-1].tolist(), way[1:].tolist(), strict=True):
        if balance(far) * here <= 0:
            return float(brentq(balance, near, far, xtol=1e-12))
    return float("nan")


if TYPE_CHECKING:
    from allocator.joint.antagonist import AntagonistJoint

_REGIONS = 64  # of the joint range, each searched for one equilibrium


def nearest_equilibrium(joint: "AntagonistJoint", gravity: Gravity, P1: Array, P2: Array, T: Array) -> Array:
    """Return the stable equilibrium [rad] nearest to 0 with a torque [N·m] and gravity at pressures [Pa], else NaN."""

    def lacking(theta: Array, P1: Array, P2: Array, T: Array) -> Array:
        agonist, antagonist = joint.sides(theta)
        return np.asarray(T + gravity.moment(theta) - agonist.torque(P1) - antagonist.torque(P2))

    left, right = (np.asarray(end) for end in joint.angle_range)
    found = rising_roots(lacking, left, right, P1, P2, T, pieces=_REGIONS)  # rising: K > 0
    nearest = np.abs(np.where(np.isfinite(found), found, np.inf)).argmin(axis=0, keepdims=True)
    return np.asarray(np.take_along_axis(found, nearest, 0)[0])


def after_history(
    joint: "AntagonistJoint", history: tuple[ArrayLike, ArrayLike], P1: ArrayLike, P2: ArrayLike, T: float
) -> Array:
    """Return the angles [rad] after the `history`, see `AntagonistJoint.equilibrium`."""
    before = checks.broadcast(**checks.pressure_pair("history", history, ("history[0]", "history[1]")))
    now = checks.broadcast(P1=checks.pressure("P1", P1), P2=checks.pressure("P2", P2))
    if before[0].ndim > 1 or now[0].ndim > 1:
        raise InvalidInput("a history, and the pressures after it, have to be numbers or rows, in their order")
    one, two = (np.concatenate([np.atleast_1d(b), np.atleast_1d(n)]) for b, n in zip(before, now, strict=True))
    H = joint.hysteresis
    if H is not None and H.stiffness is None:
        theta = through_plays(H, joint.equilibrium(one, two, T), one + two)
    else:
        theta = through_friction(joint, T, Dahl(joint.friction) if H is None else Stops(H), one, two)
    left, right = joint.angle_range
    theta = np.where((theta >= left) & (theta <= right), theta, np.nan)[-now[0].size :]
    return np.asarray(theta.reshape(now[0].shape))
