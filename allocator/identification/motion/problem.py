"""Least-squares problem of a moving joint: the output error of a free run, without feedback of measured angles.

    P_i = regulator(u_i; ρ^(∓1/2) (τ_up, τ_down), t_dead, dead band, filling), gas  `loops.follow`
    u   = Σ c_j φ_j(P1, P2)                                                     static angle
    θ   = H[u],   H = 1 - Σ w_i (1 - play_{r_i s(P1 + P2)})                     `PrandtlIshlinskii` of gain 1

    minimise  Σ_k (θ_k - θ̂_k)²   over τ_up, τ_down, ρ, t_dead, dead band, filling, s_0, c,   w_i ≥ 0,  Σ w_i ≤ 1 - w_min

ρ is the ratio of the antagonist's lags to the agonist's, so τ_up and τ_down are geometric means of both muscles.

For given nonlinear unknowns the weights are a problem of nonnegative least squares, convex with one optimum, and are
eliminated (variable projection). Motion compresses the gas of a given joint: without the regulator (P_i + p_a) V_i^κ
would be constant   (G3). V_i follows the measured angle, its only use in a free run.

If the log shows inertia and damping, H acts inside the balance of torques over the stiffness, with the springs of its
inverse, because an oscillating joint reverses where u does not.

    (a2 θ'' + a1 θ')/k(P1 + P2) + H⁻¹[θ] = u,   H⁻¹[θ] = θ + f Σ κ_i e_i[θ],   κ_i ≥ 0            `loops.swing`

with stops e_i, and k the stiffness over that at the mean pressures, of the given joint, else as P1 + P2. The κ_i are
unknowns then. The springs of the stops are shares of the muscles' stiffness, with f their share of all of it (1 without
gravity), or with a given joint also springs of their own, f = 1/k. The gain of H is 1: any other gain belongs to the
static angle. φ are monomials in s and q, q the equilibrium angle of a given joint, else (P1 - P2)/(P1 + P2 + P_max/2),
s the co-contraction in units of P_max.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.motion import loops
from allocator.identification.motion.samples import TAUT_FROM, MotionLog
from allocator.identification.motion.static import Difference, Equilibrium
from allocator.identification.recording import even_times, evenly, stretches
from allocator.joint.hysteresis import FILLED, PrandtlIshlinskii
from allocator.units import BAR, DEG

T = TypeVar("T")
Static = Difference | Equilibrium
Parts = Sequence[slice]
_WHOLE = (slice(None),)

STIFFEST = 0.1  # w_min: the least weight without play; keeps H invertible and a stuck joint compliant
_FINEST = 0.004  # least half width r_1, relative to the range of the angle
_WIDTHS = np.geomspace(1, 40, 8)  # r_i over the least
_POWERS = ((0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 1))  # of q and s
_STRONGEST = 1 / STIFFEST - 1  # Σ κ_i at most
_NO_SPRING = 1e-4  # κ_i below which there is no stop
_LEAST_STIFF = 0.05  # of the usual stiffness: lower limit
_ROUNDS, _CLOSE = 60, 1e-4  # of a free run without a measured angle, and its convergence [rad]
_RIDGE = 1e-4 * DEG  # per unit of a coefficient: determines those that the log leaves open

REGULATOR = ("lag_up", "lag_down", "dead_time", "dead_band", "filling", "lag_ratio", "volume")
NONLINEAR = (*REGULATOR, "base", "damping", "inertia")
LOWER = dict(zip(NONLINEAR, (0.0, 0.0, 0.0, 0.0, 0.0, 0.25, 0.5, 0.05, 0.0, 0.0), strict=True))
UPPER = dict(zip(NONLINEAR, (3.0, 3.0, 0.5, 1 * BAR, 2 / BAR, 4.0, 5.0, 1.0, 1.0, 0.1), strict=True))
_CHANGES = (0.1, 0.1, 0.05, 0.2 * BAR, 0.1 / BAR, 0.3, 0.3, 0.3, 0.05, 2e-3)
STEP = dict(zip(NONLINEAR, _CHANGES, strict=True))  # usual size of a change
ABSENT = dict(zip(NONLINEAR, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0), strict=True))


class Prediction(NamedTuple):
    """Free run over the whole log; arrays (n,)."""

    theta: Array  # [rad]
    static: Array  # u [rad]
    P1: Array  # after the regulators [Pa]
    P2: Array
    weights: Array  # w_1 … of the plays (widths,); κ_i where the joint swings


@dataclass(frozen=True)
class MotionProblem:
    """Problem of this module. The unknowns x are those of `free` in this order, then the coefficients c."""

    log: MotionLog
    static: Static = field(repr=False)  # q(P1, P2)
    free: tuple[str, ...]
    finest: float = _FINEST  # least half width in the range of the angle
    assumed: tuple[tuple[str, float], ...] = ()  # values of unknowns that are not free
    taper: float = 0.0  # relative reduction of widths at the ends of the range
    one_lag: bool = False  # whether pressures rise and fall with the lag of rising ones
    elastic: bool = True  # whether the stops' springs are shares of the stiffness
    _last: dict[str, tuple[object, Any]] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, log: MotionLog, static: Static) -> Self:
        """Return the problem with the unknowns that this log can determine, without inertia and damping."""
        delays = ("lag_up", "lag_down", "dead_time", "dead_band") if log.varies_speed else ()
        return cls(log, static, delays + (("base",) if log.varies_sum else ()))

    @cached_property
    def widths(self) -> Array:
        """Return r_i [rad], half widths of the plays where P1 + P2 = 5 bar."""
        return self.finest * _WIDTHS * self.log.swing

    @cached_property
    def powers(self) -> tuple[tuple[int, int], ...]:
        """Return the powers of q and s of the monomials, those of s only if the log varies it."""
        return _POWERS if self.log.varies_sum else tuple(p for p in _POWERS if not p[1])

    def basis(self, P1: Array, P2: Array) -> Array:
        """Return φ_j (monomials, …) at the pressures [Pa]."""
        q, s = self.static(P1, P2), (P1 + P2) / self.log.greatest_pressure - 1
        qs, ss = (1 + 0 * q, q, q * q, q * q * q), (1 + 0 * s, s, s * s)
        return np.stack([qs[i] * ss[j] for i, j in self.powers])

    def values(self, x: Array) -> dict[str, float]:
        """Return the nonlinear unknowns by name; those that are not free are absent."""
        values = ABSENT | dict(self.assumed) | dict(zip(self.free, x.tolist(), strict=False))
        return values | {"lag_down": values["lag_up"]} if self.one_lag else values

    def coefficients(self, x: Array) -> Array:
        """Return c (monomials,) [rad]."""
        return x[x.size - len(self.powers) :]

    @property
    def gas(self) -> bool:
        """Return whether motion compresses the gas of the given joint's muscles."""
        return isinstance(self.static, Equilibrium) and self.static.gas

    @property
    def swings(self) -> bool:
        """Return whether inertia and damping are unknowns, and with them the springs of the stops."""
        return "damping" in self.free

    @property
    def may_have_own_springs(self) -> bool:
        """Return whether springs of its own could be told from shares of the stiffness, and have a unit."""
        return self.swings and isinstance(self.static, Equilibrium)

    def springs(self, x: Array) -> Array:
        """Return κ_i (widths,) [-] of a joint that swings."""
        kappa = x[len(self.free) : x.size - len(self.powers)]
        if kappa.size != self.widths.size:  # the compiled loops do not check bounds
            raise ValueError(f"{self.widths.size} springs expected between the other unknowns, not {kappa.size}")
        return np.asarray(kappa * min(1.0, _STRONGEST / max(float(kappa.sum()), _STRONGEST)))

    # --- the free run -----------------------------------------------------------------------------------------------

    def regulated(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the muscle pressures P1, P2 (n,) [Pa], and φ (monomials, n) there."""
        log, lags = self.log, self._lags(x)

        def regulated() -> tuple[Array, Array, Array]:
            P1, P2 = self.pressures(log.t, (log.P1, log.P2), log.theta, lags)
            return P1, P2, self.basis(P1, P2)

        return self._kept("regulated", lags, regulated)

    def _kept(self, name: str, key: object, compute: Callable[[], T]) -> T:
        """Return the last result of this name if the key is the same: most differences of a Jacobian concern others."""
        if name not in self._last or self._last[name][0] != key:
            self._last[name] = key, compute()
        value: T = self._last[name][1]
        return value

    def pressures(
        self, t: Array, commands: tuple[Array, Array], theta: Array, lags: tuple[float, ...]
    ) -> tuple[Array, Array]:
        """Return both pressures (m,) [Pa] of regulators and gas with the values `lags` of `REGULATOR`."""
        up, down, *others, ratio, volume = lags
        squeezed, around = self._squeezed(theta, volume)
        one, two = (
            np.concatenate(
                [loops.pressures(t[i], u[i], s[i], around, (share * up, share * down, *others)) for i in stretches(t)]
            )
            for u, s, share in zip(commands, squeezed, shares_of_lag(ratio), strict=True)
        )
        return one, two

    def _squeezed(self, theta: Array, volume: float) -> tuple[tuple[Array, Array], float]:
        """Return the factors of both pressures."""
        if theta is not self.log.theta:
            return self.static.squeezed(theta, volume)
        return self._kept("squeezed", volume, lambda: self.static.squeezed(theta, volume))

    def _lags(self, x: Array) -> tuple[float, ...]:
        values = self.values(x)
        return tuple(values[name] for name in REGULATOR)

    def run(self, x: Array, used: Mask) -> Prediction:
        """Run freely over the whole log, with the best weights on the rows `used` (n,)."""
        P1, P2, phi = self.regulated(x)
        u = np.einsum("j,jn", self.coefficients(x), phi)
        return self.hysteretic(u, P1, P2, x, used)

    def hysteretic(self, u: Array, P1: Array, P2: Array, x: Array, used: Mask) -> Prediction:
        """Return the prediction from the static angle u (n,) [rad] on, with the best weights on the rows `used`."""
        if self.swings:
            kappa = self.springs(x)
            return Prediction(self.swung(u, P1, P2, x, kappa, self.log.step, self.log.parts), u, P1, P2, kappa)
        behind = self.behind(u, P1, P2, x, self.log.parts)
        weights = best_weights(behind[:, used], (self.log.theta - u)[used], 1 - STIFFEST)
        return Prediction(u + np.einsum("i,in", weights, behind), u, P1, P2, weights)

    def behind(self, u: Array, P1: Array, P2: Array, x: Array, parts: Parts = _WHOLE) -> Array:
        """Return p_i - u (widths, n) [rad]; each of the `parts` begins without memory."""
        return self._plays(u, self._scale(u, P1, P2, x), parts) - u

    def _plays(self, u: Array, scale: Array, parts: Parts) -> Array:
        return np.concatenate([loops.plays(u[part], scale[part], self.widths) for part in parts], axis=1)

    def swung(
        self, u: Array, P1: Array, P2: Array, x: Array, kappa: Array, step: float, parts: Parts = _WHOLE
    ) -> Array:
        """Return θ (n,) [rad] of a joint that swings, for rows that are `step` [s] apart; each of the `parts` anew."""
        v, k, s = self.values(x), self._stiffness(P1, P2), self._scale(u, P1, P2, x)
        a1, a2 = v["damping"], v["inertia"]
        f = self._firm(k, P1, P2)
        return np.concatenate([loops.swung(u[i], s[i], k[i], f[i], kappa, self.widths, a1, a2, step) for i in parts])

    def _firm(self, k: Array, P1: Array, P2: Array) -> Array:
        """Return f (n,) [-] at these pressures, where the stiffness is `k` (n,) times the usual one."""
        return self.static.muscles_share(P1, P2) if self.elastic else 1 / k

    def _stiffness(self, P1: Array, P2: Array) -> Array:
        """Return k (n,) [-] over the usual stiffness."""
        which = id(P1), id(P2)  # unique, since both are kept with the result

        def stiffness() -> tuple[Array, Array, Array]:
            return np.maximum(self.static.stiffness(P1, P2) / self._usual, _LEAST_STIFF), P1, P2

        return self._kept("stiffness", which, stiffness)[0]

    def _scale(self, u: Array, P1: Array, P2: Array, x: Array) -> Array:
        base = self.values(x)["base"]
        scale = base + (1 - base) * (P1 + P2) / FILLED
        if not self.taper:
            return np.asarray(scale)
        ends = np.minimum(1.0, np.abs(u - self.log.middle) / (self.log.swing / 2))
        return np.asarray(scale * (1 - self.taper * ends**2))

    @cached_property
    def _usual(self) -> float:
        """Return the stiffness at the mean pressures, the divisor of inertia and damping."""
        return float(self.static.stiffness(*np.mean([self.log.P1, self.log.P2], axis=1, keepdims=True))[0])

    def first_springs(self, u: Array, P1: Array, P2: Array, x: Array, used: Mask) -> Array:
        """Return κ (widths,) [-] to begin with: u - θ ≈ Σ κ_i e_i with the stops of the measured angle."""
        theta = self.log.theta
        stops = theta - self._plays(theta, self._scale(u, P1, P2, x), self.log.parts)
        stops = stops * self._firm(self._stiffness(P1, P2), P1, P2)
        return best_weights(stops[:, used], (u - theta)[used], _STRONGEST)

    def elsewhere(self, t: Array, commands: tuple[Array, Array], x: Array, weights: Array) -> Prediction:
        """Return a free run over other rows: times [s], commands (m,) [Pa] of both muscles."""
        parts = stretches(t)
        if len(parts) > 1:
            runs = [self.elsewhere(t[i], (commands[0][i], commands[1][i]), x, weights) for i in parts]
            rows = [np.concatenate([run[column] for run in runs]) for column in range(4)]
            return Prediction(rows[0], rows[1], rows[2], rows[3], weights)
        if not evenly(t):
            even = even_times(t)
            before = np.searchsorted(t, even, side="right") - 1
            one, two = commands
            run = self.elsewhere(even, (one[before], two[before]), x, weights)
            theta, u, P1, P2 = (np.interp(t, even, rows) for rows in run[:4])
            return Prediction(theta, u, P1, P2, weights)
        theta, last = np.zeros(t.size), np.zeros(t.size)
        for _ in range(_ROUNDS if self.gas else 1):  # the motion compresses the gas, which moves the joint
            P1, P2 = self.pressures(t, commands, theta, self._lags(x))
            u = np.einsum("j,jn", self.coefficients(x), self.basis(P1, P2))
            if self.swings:
                theta = self.swung(u, P1, P2, x, weights, float(np.median(np.diff(t))))
            else:
                theta = np.asarray(u + np.einsum("i,in", weights, self.behind(u, P1, P2, x)))
            if np.abs(theta - last).max() < _CLOSE:
                break
            last = theta = (theta + last) / 2 if self.gas else theta
        return Prediction(theta, u, P1, P2, weights)

    # --- least squares ----------------------------------------------------------------------------------------------

    def residual(self, x: Array, used: Mask) -> Array:
        """Return the errors (used,) [°] and the ridge of the coefficients."""
        error = self.log.theta - self.run(x, used).theta
        return np.concatenate([error[used], _RIDGE * np.sqrt(used.sum()) * self.coefficients(x)]) / DEG

    def start(self, lag: float, used: Mask) -> Array:
        """Return x with both lags `lag` [s]: c by linear least squares, without hysteresis."""
        usual = {"lag_up": lag, "lag_down": lag, "dead_time": 0.02, "dead_band": 0.0, "base": 0.7}
        head = np.array([usual[name] for name in self.free])
        return self.anew(np.concatenate([head, np.zeros(self._stops + len(self.powers))]), used)

    def anew(self, x: Array, used: Mask) -> Array:
        """Return x with c by linear least squares, without hysteresis."""
        phi = self.regulated(x)[2][:, used]
        c, *_ = np.linalg.lstsq(phi.T, self.log.theta[used], rcond=1e-8)
        return np.concatenate([x[: x.size - c.size], c])

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the greatest x."""
        m = np.full(len(self.powers), np.inf)
        low, high = (np.array([end[name] for name in self.free]) for end in (LOWER, UPPER))
        least, most = np.zeros(self._stops), np.full(self._stops, _STRONGEST)
        return np.concatenate([low, least, -m]), np.concatenate([high, most, m])

    def sizes(self) -> Array:
        """Return the usual change of each of x."""
        return np.concatenate(
            [[STEP[name] for name in self.free], np.full(self._stops, 0.1), np.full(len(self.powers), 0.2)]
        )

    @property
    def _stops(self) -> int:
        return self.widths.size if self.swings else 0

    # --- results ----------------------------------------------------------------------------------------------------

    def operator(self, x: Array, weights: Array, k: float = 1.0) -> PrandtlIshlinskii:
        """Return H, without plays of zero weight; the `weights` are those of a `Prediction`.

        With springs of its own it is that at `k` times the usual stiffness.
        """
        if self.swings:
            there, K = weights > _NO_SPRING, None if self.elastic else k * self._usual
            kappa, r = weights[there] / (1.0 if self.elastic else k), tuple(self.widths[there])
            back = (1 + float(kappa.sum()), *-kappa)
            return PrandtlIshlinskii(back, r, base=self.values(x)["base"], stiffness=K).inverse
        there = weights > 0
        first = 1 - float(weights.sum())
        return PrandtlIshlinskii((first, *weights[there]), tuple(self.widths[there]), base=self.values(x)["base"])

    def stiffest(self, x: Array, weights: Array) -> bool:
        """Return whether the weight without play is at its bound."""
        return self.operator(x, weights).weights[0] <= STIFFEST * (1 + 1e-4)

    def filled(self, x: Array, weights: Array) -> PrandtlIshlinskii:
        """Return `operator` at two equal pressures whose sum is that of the widths."""
        half = np.array([FILLED / 2])
        return self.operator(x, weights, float(self.static.stiffness(half, half)[0]) / self._usual)

    def taut(self, run: Prediction) -> Mask:
        """Return the rows (n,) in which both muscles are taut by their pressures."""
        return np.asarray((run.P1 >= TAUT_FROM) & (run.P2 >= TAUT_FROM))


def shares_of_lag(ratio: float) -> tuple[float, float]:
    """Return the lags of agonist and antagonist over their geometric mean [-]; `ratio` is the second over the first."""
    return ratio**-0.5, ratio**0.5


def best_weights(D: Array, y: Array, most: float) -> Array:
    """Return w ≥ 0 (n,) with Σ w ≤ `most` that minimises |y - wᵀ D|², D (n, rows): one convex problem.

    By Lawson & Hanson's nonnegative least squares (SciPy) of the square roots of D Dᵀ: |y - wᵀ D|² = |b - A w|² + …;
    where the sum binds, it is one row more of great weight. (einsum, since BLAS would wake its threads for so little.)
    """
    from scipy.optimize import nnls

    n = D.shape[0]
    values, vectors = np.linalg.eigh(np.einsum("ik,jk", D, D))
    there = values > 1e-13 * values[-1]
    A = np.sqrt(values[there])[:, None] * vectors[:, there].T
    b = (vectors[:, there].T @ np.einsum("ik,k", D, y)) / np.sqrt(values[there])
    if not there.any():
        return np.zeros(n)
    w = nnls(A, b)[0]
    if w.sum() > most:
        heavy = 1e5 * max(float(np.abs(A).max()), 1e-12)
        w = nnls(np.vstack([A, np.full(n, heavy)]), np.append(b, heavy * most))[0]
        w *= most / w.sum()
    return np.asarray(w)
