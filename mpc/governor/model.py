"""Formulas of the governor: the arm's motion, and its energy at the pressures of the rest.

With the mass matrix M(q) the bodies' equations are M q'' = τ(q, P) - C - D q' - g(q) + d, where by Lagrange
C = (∂(M ω)/∂q) ω - ½ ∂(ωᵀM ω)/∂q; d is the greatest load, which pushes away from the rest. Slack cables do not push,
nor do they compress gas.

Muscles, damping and bodies may be uncertain: an `Interval` for strengths, damping, masses and lags. The uncertain
numbers are an argument of the formulas, a column called *scene*; the formulas contain all other numbers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.gas import Gas
from allocator.lazy import SX, Function
from allocator.mechanism import Mechanism
from allocator.mechanism.formulas import symbolic_lengths

Posed: TypeAlias = Callable[[Value], Value]  # a function of the posture q, for numbers or CasADi symbols


@dataclass(frozen=True)
class Interval:
    """Least and greatest value of a constant, uncertain quantity.

    Both are numbers, rows of numbers or, for masses, matrices or functions, in the unit of the quantity.
    """

    low: Value | Posed
    high: Value | Posed

    @classmethod
    def about(cls, value: ArrayLike, share: float) -> Self:
        """Return `value` (…) ± a `share` of it: `Interval.about(0.25, 0.1)` is 0.225 … 0.275.

        Raises `InvalidInput`.
        """
        share = checks.number("Interval: share", share, "-")
        if not 0 <= share < 1:
            raise InvalidInput(f"Interval: share = {share:g} has to lie between 0 and 1, such as 0.1")
        row = np.asarray(checks.real("Interval: value", value, "SI"))
        off = share * np.abs(row)
        return cls((row - off).tolist(), (row + off).tolist())


@dataclass(frozen=True)
class Scaled:
    """Function times a number."""

    function: Posed
    factor: float

    def __call__(self, q: Value) -> Value:
        """Return the function of `q` times the factor."""
        return self.factor * self.function(q)


def ends(value: Value | Posed | Interval) -> tuple[Value, Value]:
    """Return the ends of an interval; for any other value, the value twice."""
    return (value.low, value.high) if isinstance(value, Interval) else (value, value)


def rows(
    name: str, value: ArrayLike | Interval, unit: str, size: int, letter: str, above: float | None = None
) -> Array:
    """Return the bounds (2, size) of one or `size` numbers, or of an interval of them.

    They are not negative, or greater than `above`. Raises `InvalidInput`.
    """
    found = []
    for end in ends(value):
        array = checks.real(name, end if np.size(end) else 0.0, unit)
        low_enough = array >= 0 if above is None else array > above
        if array.shape not in ((), (size,)) or not low_enough.all():
            sign = "not negative" if above is None else f"greater than {above:g}"
            raise InvalidInput(f"{name} has to be one number or {letter} = {size}, {sign} [{unit}]")
        found.append(np.broadcast_to(array, (size,)))
    bounds = np.array(found)
    if (bounds[0] > bounds[1]).any():
        raise InvalidInput(f"{name}: the interval has to begin with its least value, as Interval(low, high) [{unit}]")
    return bounds


_NODES = 3  # of the quadrature of a potential

MatrixOrFunction: TypeAlias = ArrayLike | Posed


class Dynamics(NamedTuple):
    """Mechanism with bodies, each number with its least and its greatest value."""

    mechanism: Mechanism
    inertia: tuple[MatrixOrFunction, MatrixOrFunction]  # M (n, n) [kg·m²] of the lightest and the heaviest bodies
    gravity: tuple[Posed | None, ...]  # g (n) [N·m] of both; None: no gravity
    damping: Array  # (2, n) [N·m·s/rad]
    strength: Array  # (2, m) of the forces, relative to the model
    load: Array  # (n) [N·m]
    gas: Gas | None  # None: regulators hold the pressures against every motion

    @property
    def bounds(self) -> Array:
        """Bounds (2, m + n + 1) of strengths, damping and the share of the heaviest bodies' masses."""
        heavier = float(self.inertia[0] is not self.inertia[1] or self.gravity[0] is not self.gravity[1])
        return np.column_stack([self.strength, self.damping, [0.0, heavier]])

    @property
    def uncertain(self) -> Array:
        """Mask (m + n + 1) of the numbers with different bounds."""
        low, high = self.bounds
        return np.asarray(low < high)

    def scenes(self, values: Array) -> Array:
        """Return the scenes (s, k) of values (s, m + n + 1); without any uncertain ones a column of zeros."""
        return values[:, self.uncertain] if self.uncertain.any() else np.zeros((len(values), 1))

    @property
    def middle(self) -> Array:
        """Scene (k) in the middle of all bounds."""
        return np.asarray(self.scenes(self.bounds.mean(axis=0, keepdims=True))[0])


class _Formulas(NamedTuple):
    """CasADi expressions at a posture `q` in a scene."""

    scene: "SX"  # (k)
    strength: "SX"  # (m)
    damping: "SX"  # (n)
    slope: "SX"  # ∂l/∂q (m, n)
    A: "SX"  # (m) of the model's forces A P + B
    B: "SX"  # (m)
    V: "SX"  # (m) volumes of the gas [m³], 0 without
    M: "SX"  # (n, n)
    g: "SX"  # (n)

    @classmethod
    def at(cls, dynamics: Dynamics, q: "SX") -> "_Formulas":
        import casadi as ca

        n, m = dynamics.mechanism.n, dynamics.mechanism.m
        places = np.flatnonzero(dynamics.uncertain).tolist()
        scene = ca.SX.sym("scene", max(len(places), 1))
        values = ca.SX(ca.DM(dynamics.bounds[0]))
        for k, place in enumerate(places):
            values[place] = scene[k]
        strength, damping, share = values[:m], values[m : m + n], values[m + n]
        M = _between([_matrix(inertia, q) for inertia in dynamics.inertia], share)
        g = _between([_torque(gravity, q) for gravity in dynamics.gravity], share)
        V = 0 * strength if dynamics.gas is None else _volumes(dynamics.mechanism, q, strength)
        return cls(scene, strength, damping, *_muscles(dynamics.mechanism, q), V, M, g)

    def torque(self, pull: "SX") -> "SX":
        """Return τ - g of muscles with the model's forces `pull` (m) [N]."""
        return -self.slope.T @ (self.strength * pull) - self.g

    def squeeze(self, gas: Gas | None, P: "SX") -> "SX":
        """Return the fall of the pressures [Pa/m] of taut muscles that shorten: κ (P + p_a) A/V (m), 0 without gas."""
        if gas is None:
            return 0 * P
        taut = self.A * P + self.B > 0
        return taut * gas.kappa * (P + gas.atmosphere) * self.strength * self.A / self.V


def statics_function(dynamics: Dynamics) -> "Function":
    """Return the CasADi function (q, P, scene) ↦ (τ - g, ∂τ/∂P, -∂(τ - g)/∂q, M, ∂l/∂q, A, B, K_shut, V).

    A and B are those of the model's forces A P + B, K_shut is the stiffness -∂(τ - g)/∂q with trapped gas, and V the
    volumes, 0 without gas. Raises `InvalidInput` for muscles that are not affine and for
    routes without formulas.
    """
    import casadi as ca

    q, P = ca.SX.sym("q", dynamics.mechanism.n), ca.SX.sym("P", dynamics.mechanism.m)
    f = _Formulas.at(dynamics, q)
    torque = f.torque(f.A * P + f.B)  # (M1)
    gain = -f.slope.T @ ca.diag(f.strength * f.A)
    K = -ca.jacobian(torque, q)
    made = [torque, gain, K, f.M, f.slope, f.A, f.B, K - gain @ ca.diag(f.squeeze(dynamics.gas, P)) @ f.slope, f.V]
    return ca.Function("statics", [q, P, f.scene], list(map(ca.densify, ca.cse(made))))


def motion_function(dynamics: Dynamics, rest: Array) -> "Function":
    """Return the CasADi function (q, ω, P, scene) ↦ (ω', A, B, -l', squeeze, (½ ωᵀM ω, -ω·g)).

    A and B are those of the model's forces A P + B. The load pushes every joint away from `rest` (n) [rad]. Raises
    `InvalidInput` like `statics_function`.
    """
    import casadi as ca

    n, m = dynamics.mechanism.n, dynamics.mechanism.m
    q, omega, P = ca.SX.sym("q", n), ca.SX.sym("omega", n), ca.SX.sym("P", m)
    f = _Formulas.at(dynamics, q)
    momentum = f.M @ omega
    kinetic = ca.dot(omega, momentum) / 2
    pushing = f.torque(ca.fmax(f.A * P + f.B, 0)) - f.damping * omega
    pushing -= ca.jacobian(momentum, q) @ omega - ca.gradient(kinetic, q)
    if dynamics.load.any():
        pushing += ca.DM(dynamics.load) * ca.sign(q - ca.DM(rest))
    alpha = ca.ldl_solve(pushing, *ca.ldl(f.M))
    squeeze = f.squeeze(dynamics.gas, P)
    made = [alpha, f.A, f.B, -(f.slope @ omega), squeeze, ca.vertcat(kinetic, -ca.dot(omega, f.g))]
    names = ["q", "omega", "P", "scene"], ["alpha", "gain", "force", "speed", "squeeze", "energy"]
    return ca.Function("motion", [q, omega, P, f.scene], list(map(ca.densify, ca.cse(made))), *names)


def potential_function(dynamics: Dynamics, rest: Array, P: Array) -> "Function":
    """Return the CasADi function (q, scene) ↦ the energy [J] of muscles at `P` (m) [Pa], gravity and load.

    It is the work along the straight line from the posture `rest` (n) [rad], by Gauss's quadrature.
    """
    import casadi as ca

    q = ca.SX.sym("q", dynamics.mechanism.n)
    away, statics = q - ca.DM(rest), statics_function(dynamics)
    scene = ca.SX.sym("scene", statics.size1_in(2))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    level: SX = -ca.dot(ca.DM(dynamics.load), ca.fabs(away))
    for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        level -= weight * ca.dot(statics(ca.DM(rest) + float(node) * away, ca.DM(P), scene)[0], away)
    return ca.Function("potential", [q, scene], [ca.densify(ca.cse([level])[0])], ["q", "scene"], ["level"])


def _between(ends: list["SX"], share: "SX") -> "SX":
    """Return the value at the `share` between those of the lightest and the heaviest bodies."""
    low, high = ends
    return low if share.is_constant() else low + share * (high - low)


def _matrix(inertia: MatrixOrFunction, q: "SX") -> "SX":
    import casadi as ca

    return ca.SX(inertia(q)) if callable(inertia) else ca.SX(ca.DM(np.asarray(inertia)))


def _torque(gravity: Posed | None, q: "SX") -> "SX":
    import casadi as ca

    return ca.SX.zeros(q.shape[0]) if gravity is None else ca.SX(gravity(q))


def _muscles(mechanism: Mechanism, q: "SX") -> tuple["SX", "SX", "SX"]:
    """Return ∂l/∂q (m, n), A (m) and B (m) of the forces A P + B at `q`."""
    import casadi as ca

    mechanism.check_affine("a governor")
    pairs = list(zip(mechanism.muscles, _contractions(mechanism, q), strict=True))
    A = ca.vertcat(*(muscle.gain(0.0, e) for muscle, e in pairs))
    slope = ca.jacobian(symbolic_lengths(mechanism.routes, q), q)
    return slope, A, ca.vertcat(*(muscle.law(0.0, e) for muscle, e in pairs))


def _volumes(mechanism: Mechanism, q: "SX", strength: "SX") -> "SX":
    """Return the volumes (m) [m³] at `q`; they grow in proportion to the muscles' `strength` (m)."""
    import casadi as ca

    laws = list(zip(mechanism.muscles, mechanism.routes.rest_length, strict=True))
    rest = ca.DM([muscle.volume_at_rest(L) for muscle, L in laws])
    eps = _contractions(mechanism, q)
    now: SX = ca.vertcat(*(muscle.volume(0.0, e, L) for (muscle, L), e in zip(laws, eps, strict=True)))
    return rest + strength * (now - rest)


def _contractions(mechanism: Mechanism, q: "SX") -> list["SX"]:
    """Return the contraction ratios ε (m) at `q`."""
    length = symbolic_lengths(mechanism.routes, q)
    return [(L - length[j]) / L for j, L in enumerate(mechanism.routes.rest_length)]


class Corners(NamedTuple):
    """Corners of strengths, damping, masses and lags, s of them."""

    values: Array  # (s, m + n + 1), see `Dynamics.bounds`
    lag: Array  # (s, m) [s]


def corners(dynamics: Dynamics, lag: Array, q: Array) -> Corners:
    """Return the corners to simulate, with the bounds `lag` (2, m) [s] and a posture `q` (n) [rad] in the range.

    Without intervals there is one. Otherwise not all 2ᵏ corners are simulated. For each combination of directions in
    which the n joints can leave their range, the muscles that pull in these directions are at their strongest and the
    others at their weakest. In two more corners all are at their strongest or all at their weakest. For a joint of two
    muscles these are all corners. Each is combined with the least and the greatest damping, masses and lags, because
    less damping lets the arm swing farther, but more damping holds it longer where pressures push it outwards.
    """
    n, m = dynamics.mechanism.n, dynamics.mechanism.m
    bounds = dynamics.bounds
    rows = [
        np.concatenate([strength, bounds[damping, m : m + n], bounds[mass, m + n :], lag[slow]])
        for strength in _strengths(dynamics, q)
        for damping, mass, slow in product((0, 1), (1, 0), (1, 0))
    ]
    found = np.array(list(dict.fromkeys(map(tuple, np.array(rows).tolist()))))  # each once, the worst ones first
    return Corners(found[:, : m + n + 1], found[:, m + n + 1 :])


def _strengths(dynamics: Dynamics, q: Array) -> list[Array]:
    """Return rows (m) of strengths."""
    low, high = dynamics.strength
    slope = np.array(statics_function(dynamics)(q, np.zeros(dynamics.mechanism.m), dynamics.middle)[4])  # (m, n)
    towards = [-slope @ np.array(signs) > 0 for signs in product((1.0, -1.0), repeat=dynamics.mechanism.n)]
    return [*(np.where(pulls, high, low) for pulls in towards), low, high]
