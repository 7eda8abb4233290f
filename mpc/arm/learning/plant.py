"""Many simulated arms in one compiled loop; each may differ in strength, lag, mass and muscle parameters.

    q' = ω,   s M(q) ω' = τ(q, P) - s (C(q, ω) + g(q)) - b D ω + τ_stop - N Jᵀν + d,   τ = Σ_j r_j g_j max(F_j, 0)  (M1)
    P_j' = (u_j - P_j)/τ_j - κ (P_j + p_a) V_j'/V_j^eff, the second term with `gas` only                        (G3)

The factors s, b and g_j, the lags τ_j, the muscles' parameters and the numbers of the wall differ between arms: each
has a row of values of a `VariedArm`. τ_stop is that of end stops at the angle limits (`mpc.model.stops`), N the force
of the hand on a wall with the normal ν (`Wall`), J the Jacobian of the hand; without a wall N = 0.

A `Wall` that the hand touches is a spring and a damper behind a plane, which push and never pull.

With the penetration e = ν·x - e0 of the hand at x, the force of the hand on the wall is

    N = max(k e + c e', 0)  if e > 0,  else 0

along the normal ν, without friction: the law of Kelvin and Voigt, cut off where it would pull. With c > 0 the force
begins with a step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput, notice
from allocator.joint.gas import Gas
from allocator.joint.one_muscle import OneMuscle
from allocator.lazy import SX
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.formulas import symbolic_lengths, symbolic_position
from allocator.muscles import Muscle
from mpc.codegen.buffered import Buffered
from mpc.codegen.text import IMPORTS, filling
from mpc.model.arm.formulas import varied_acceleration
from mpc.model.arm.model import Arm
from mpc.model.arm.ranges import about_the_middle
from mpc.model.experiment import integrated
from mpc.model.pressures import fall
from mpc.model.stops import STOP_RATE, pushed_back, stop_torque
from mpc.tracking.qp.step import SlowStep

_UNIT = 1e-9  # greatest error of the square of a unit vector


@dataclass(frozen=True)
class Wall:
    """Half space behind a plane, without friction; immutable. SI units."""

    normal: tuple[float, ...] = (1.0, 0.0)  # ν, a unit vector into the wall, of the hand's coordinates
    offset: float = 0.59  # e0 = ν·x of the surface [m]
    stiffness: float = 3000.0  # k [N/m]
    damping: float = 30.0  # c [N·s/m]

    def __post_init__(self) -> None:
        """Check the fields and convert them to floats. Raises `InvalidInput`."""
        normal = checks.real("Wall: normal", self.normal, "-")
        if normal.ndim != 1 or abs(float(normal @ normal) - 1) > _UNIT:
            raise InvalidInput(
                f"Wall: normal = {checks.brief(self.normal)} has to be a unit vector, such as (1.0, 0.0)"
            )
        object.__setattr__(self, "normal", tuple(normal.tolist()))
        object.__setattr__(self, "offset", checks.number("Wall: offset", self.offset, "m"))
        object.__setattr__(self, "stiffness", checks.positive("Wall: stiffness", self.stiffness, "N/m"))
        object.__setattr__(self, "damping", checks.not_negative("Wall: damping", self.damping, "N·s/m"))

    @property
    def numbers(self) -> Array:
        """Row (3,) of offset [m], stiffness [N/m] and damping [N·s/m], which vary between arms."""
        return np.array([self.offset, self.stiffness, self.damping])


Move: TypeAlias = Callable[[Array, Array, Array, Array, float, int], None]
"""Function (x, u, v, d, h, substeps) ↦ None, which advances the states x."""

RESOLUTION = 0.25  # step times the rate of the fastest motion: an error of about 3e-5 of the change


@dataclass(frozen=True)
class VariedArm:
    """Arm with variable numbers.

    In this order: the parameters of every distinct fitted muscle, the muscles' gains g (m), lags (m) [s], the
    factor s of all masses and b of the damping, and offset, stiffness and damping of the wall, if there is one.
    """

    arm: Arm
    gas: Gas | None = None
    wall: Wall | None = None  # met by the arm's endpoint, or by the end of the last link if the arm has none

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput`."""
        for name, value, kinds in (
            ("arm", self.arm, Arm),
            ("gas", self.gas, Gas | None),
            ("wall", self.wall, Wall | None),
        ):
            if not isinstance(value, kinds):
                raise InvalidInput(f"{name} is a {type(value).__name__}; expected an {kinds}")
        if self.wall is not None and len(self.wall.normal) != self.hand.dim:
            raise InvalidInput(f"Wall: normal has {len(self.wall.normal)} coordinates; it meets {self.hand.text}")

    @property
    def hand(self) -> Endpoint:
        """Point that touches a wall. Raises `InvalidInput` if the arm has no endpoint."""
        hand = self.arm.endpoint or getattr(self.arm.bodies, "endpoint", None)
        if hand is None:
            raise InvalidInput("a wall needs a hand: give the arm an endpoint (Arm(…, endpoint=…))")
        return hand

    @cached_property
    def kinds(self) -> tuple[Muscle, ...]:
        """Distinct muscles that were fitted; the parameters of others are constants."""
        return tuple(dict.fromkeys(kind for kind in self.arm.mechanism.muscles if kind.covariance is not None))

    @cached_property
    def places(self) -> dict[str, slice]:
        """Places in a row of values by name: "kind 0", …, "gains", "lags", "mass", "damping", "wall"."""
        sizes = {f"kind {k}": len(kind.parameters) for k, kind in enumerate(self.kinds)}
        sizes |= {"gains": self.arm.m, "lags": self.arm.m, "mass": 1, "damping": 1, "wall": 3 * (self.wall is not None)}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        return {name: slice(begin, end) for name, begin, end in zip(sizes, ends[:-1], ends[1:], strict=True)}

    @cached_property
    def nominal(self) -> Array:
        """Row of values (p,) of the nominal arm."""
        own = [list(kind.parameters.values()) for kind in self.kinds]
        wall: Array | list[float] = [] if self.wall is None else self.wall.numbers
        return np.concatenate([*own, np.ones(self.arm.m), self.arm.lags, [1.0, 1.0], wall])

    @cached_property
    def fastest_rate(self) -> float:
        """Estimate of the fastest eigenvalue [1/s] of the nominal arm, its end stops and its touch of the wall."""
        arm = self.arm
        rates = [arm.fastest_rate, 2 * STOP_RATE if arm.has_stops else 0.0]
        if self.wall is not None:
            q = about_the_middle(arm)
            across = np.array(self.wall.normal) @ self.hand.jacobian(q)
            moved = np.linalg.solve(arm.bodies.mass_matrix(q), across[..., None])[..., 0]
            mobility = float(np.einsum("ij,ij->i", across, moved).max())  # ν·J M⁻¹ Jᵀν [1/kg]
            modes = np.roots([1.0, mobility * self.wall.damping, mobility * self.wall.stiffness])
            rates.append(float(np.abs(modes).max()))
        return max(rates)

    # --- formulas ---------------------------------------------------------------------------------------------------

    def muscles(self, v: "SX") -> list[Muscle]:
        """Return the m muscles with the parameters in the CasADi column `v` (p, 1)."""
        import casadi as ca

        varied = {kind: kind.unchecked(ca.vertsplit(v[self.places[f"kind {k}"]])) for k, kind in enumerate(self.kinds)}
        return [varied.get(muscle, muscle) for muscle in self.arm.mechanism.muscles]

    def forces(self, length: "SX", P: "SX", v: "SX") -> "SX":
        """Return the forces (m, 1) [N] of muscles of the `length` (m, 1) [m], 0 for slack cables. CasADi symbols."""
        import casadi as ca

        gains, L = v[self.places["gains"]], self.arm.mechanism.routes.rest_length
        said = [muscle.law(P[j], 1 - length[j] / L[j]) for j, muscle in enumerate(self.muscles(v))]
        forces: SX = ca.vertcat(*(ca.fmax(gains[j] * F, 0.0) for j, F in enumerate(said)))
        return forces

    def rate(self, x: "SX", u: "SX", v: "SX", d: "SX") -> "SX":
        """Return x' (2n + m, 1) of the state `x`, commands `u` [Pa], values `v` and torques `d` [N·m], all symbols."""
        import casadi as ca

        n = self.arm.n
        q, omega, P = x[:n], x[n : 2 * n], x[2 * n :]
        length, slope = _with_slope(lambda angles: symbolic_lengths(self.arm.mechanism.routes, angles), q)
        F = self.forces(length, P, v)
        torque = d - slope.T @ F + self._stop(q, omega)
        if self.wall is not None:
            torque += self.touch(q, omega, v)[2]
        mass, damping = v[self.places["mass"]], v[self.places["damping"]]
        alpha = varied_acceleration(self.arm.bodies, q, omega, torque, mass, damping)
        filling = (u - P) / v[self.places["lags"]] - self._falls(length, slope @ omega, P, F, v)
        return ca.vertcat(omega, alpha, filling)

    def _falls(self, length: "SX", speed: "SX", P: "SX", F: "SX", v: "SX") -> "SX":
        """Return the fall of the pressures (m, 1) [Pa/s] as taut muscles swell.

        The swelling follows the force of the varied models, from the volumes of the nominal models.
        """
        import casadi as ca

        if self.gas is None:
            return 0.0 * P
        gains, L, found = v[self.places["gains"]], self.arm.mechanism.routes.rest_length, []
        for j, (muscle, own) in enumerate(zip(self.arm.mechanism.muscles, self.muscles(v), strict=True)):
            eps = 1 - length[j] / L[j]
            side = OneMuscle(muscle, "muscle", L[j], eps, 1.0, 0.0, 1.0, self.gas)
            V, rest = side.volume(P[j]), muscle.volume_at_rest(L[j])
            pulls = gains[j] * own.gain(P[j], eps) / muscle.gain(P[j], eps)
            taut = ca.if_else(F[j] > 0, 1.0, 0.0)
            found.append(-pulls * fall(side, P[j]) * V / (rest + gains[j] * (V - rest)) * taut * speed[j])
        falls: SX = ca.vertcat(*found)
        return falls

    def _stop(self, q: "SX", omega: "SX") -> "SX":
        """Return the torques (n, 1) [N·m] of the end stops, symbols."""
        import casadi as ca

        if not self.arm.has_stops:
            return ca.SX.zeros(self.arm.n)
        low, high = map(ca.DM, self.arm.angle_limits)
        stopping: SX = stop_torque(q, omega, low, high, ca.DM(self.inertia))
        return stopping

    def touch(self, q: "SX", omega: "SX", v: "SX") -> tuple["SX", "SX", "SX"]:
        """Return x (dim, 1) [m] of the hand, N (1, 1) [N] on the wall and the torques -N Jᵀν (n, 1) [N·m], symbols."""
        import casadi as ca

        assert self.wall is not None
        x, J = _with_slope(lambda angles: symbolic_position(self.hand, angles), q)
        offset, stiffness, damping = ca.vertsplit(v[self.places["wall"]])
        normal = ca.DM(self.wall.normal)
        N = pushed_back(normal.T @ x - offset, normal.T @ (J @ omega), stiffness, damping)
        return x, N, -N * (J.T @ normal)

    @cached_property
    def inertia(self) -> Array:
        """Inertias (n,) [kg·m²] of the joints at q = 0, each with all other joints free."""
        return np.asarray(1 / np.diag(np.linalg.inv(self.arm.bodies.mass_matrix(np.zeros(self.arm.n)))))

    def symbols(self) -> tuple["SX", "SX", "SX", "SX"]:
        """Return CasADi columns x, u, v, d."""
        import casadi as ca

        sizes = {"x": self.arm.size, "u": self.arm.m, "v": self.nominal.size, "d": self.arm.n}
        x, u, v, d = (ca.SX.sym(name, size) for name, size in sizes.items())
        return x, u, v, d


class ArmBatch:
    """N simulated arms of one kind; states and values are arrays to be read and written."""

    def __init__(self, varied: VariedArm, size: int, dt: float, *, compiled: bool = True) -> None:
        """Prepare `size` nominal arms at rest in the middle, without pressure, for samples of `dt` [s].

        The first arm of a kind compiles for some seconds, once. With `compiled` False, or after a `SlowStep` warning
        that nothing can be compiled, CasADi evaluates the formulas, about a hundred times more slowly. Raises
        `InvalidInput`.
        """
        if not (isinstance(size, int) and size >= 1):
            raise InvalidInput(f"size = {size!r} has to be a whole number of arms, 1 or more")
        if not 0 < dt <= 1:
            raise InvalidInput(f"dt = {dt!r} has to be the time of a sample [s], at most 1")
        self.varied, self.dt = varied, float(dt)
        arm = varied.arm
        self.x = np.zeros((size, arm.size))
        self.q, self.omega, self.P = views(self.x, arm.n)
        self.v = np.tile(varied.nominal, (size, 1))
        self.substeps = max(int(np.ceil(dt * varied.fastest_rate / RESOLUTION)), 1)
        self._move = _moving(varied) if compiled else _evaluated(varied)

    def renew(self, which: Mask) -> None:
        """Apply changed states and values of the arms `which` (N,); nothing to do, since `x` and `v` hold them."""

    def advance(self, u: Array, d: Array) -> None:
        """Advance all arms by a sample under the commands `u` (N, m) [Pa] and the torques `d` (N, n) [N·m]."""
        if u.shape != self.P.shape or d.shape != self.q.shape:  # compiled code would read beyond the ends
            raise InvalidInput(f"u {u.shape}, d {d.shape}: expected {self.P.shape} and {self.q.shape}")
        self._move(self.x, u, self.v, d, self.dt / self.substeps, self.substeps)


class Touched(NamedTuple):
    """Hands at a wall."""

    x: Array  # positions (N, dim) [m]
    force: Array  # N on the wall (N,) [N]
    torque: Array  # of the walls on the joints (N, n) [N·m]


class Touch:
    """Function of N arms that evaluates their hands and walls by the formulas of `VariedArm.touch`."""

    def __init__(self, varied: VariedArm, size: int) -> None:
        """Prepare `size` arms."""
        import casadi as ca

        n, (x, _, v, _) = varied.arm.n, varied.symbols()
        q, omega = x[:n], x[n : 2 * n]
        found = [ca.densify(part) for part in varied.touch(q, omega, v)]
        self._touch = Buffered(ca.Function("touch", [q, omega, v], found).map(size))

    def __call__(self, q: Array, omega: Array, v: Array) -> Touched:
        """Return the touch of arms at `q`, `omega` (N, n) with the values `v` (N, p)."""
        x, force, torque = self._touch(q, omega, v)
        return Touched(x, force[:, 0], torque)


def views(x: Array, n: int) -> tuple[Array, Array, Array]:
    """Return views of the angles (N, n), velocities (N, n) and pressures (N, m) in states `x` (N, 2n + m)."""
    return x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]


def _with_slope(formula: Callable[["SX"], "SX"], q: "SX") -> tuple["SX", "SX"]:
    """Return the `formula` of the angles and its Jacobian at `q` (n, 1), any expression."""
    import casadi as ca

    angles = ca.SX.sym("q", q.shape[0])
    value = formula(angles)
    at, slope = ca.Function("at", [angles], [value, ca.jacobian(value, angles)])(q)
    return at, slope


def _moving(varied: VariedArm) -> Move:
    """Return the compiled function; if compilation fails, warn with `SlowStep` and return the evaluated one."""
    try:
        move = _compiled(varied)
        arm = varied.arm
        x, u, v, d = (np.zeros((0, size)) for size in (arm.size, arm.m, varied.nominal.size, arm.n))
        move(x, u, v, d, 0.1, 1)  # compiles now rather than in the first step
        return move
    except Exception as failure:  # no compiler, cache not writable, formula too long, or a fault of the compiler
        reason = (str(failure).strip() or type(failure).__name__).splitlines()[0]
    notice(f"the arms' motion is not compiled and takes about a hundred times as long: {reason}", SlowStep)
    return _evaluated(varied)


def _compiled(varied: VariedArm) -> Move:
    """Return (x, u, v, d, h, substeps) ↦ None, compiled for this kind of arm."""
    from pathlib import Path

    import casadi as ca

    from mpc.codegen.modules import imported, with_formulas

    x, u, v, d = varied.symbols()
    source = filling("rate", ca.Function("rate", [x, u, v, d], ca.cse([varied.rate(x, u, v, d)])))
    module = imported(with_formulas(Path(__file__).with_name("step.py"), f"{IMPORTS}@inlined\n{source.text}\n\n"))
    return lambda x, u, v, d, h, substeps: module.advance(source.c, x, u, v, d, h, substeps)


def _evaluated(varied: VariedArm) -> Move:
    """Return (x, u, v, d, h, substeps) ↦ None, evaluated by CasADi."""
    import casadi as ca

    x, u, v, d = varied.symbols()
    h = ca.SX.sym("h")
    once = ca.Function("step", [x, u, v, d, h], [integrated(lambda x, t: varied.rate(x, u, v, d), x, h, 1)])
    step = Buffered(once)

    def move(x: Array, u: Array, v: Array, d: Array, h: float, substeps: int) -> None:
        for i in range(len(x)):
            for _ in range(substeps):
                x[i] = step(x[i], u[i], v[i], d[i], h)[0][0]

    return move
