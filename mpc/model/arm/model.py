"""Model of an arm: a mechanism whose muscles move bodies, with first-order lags of the pressures.

    q' = ω,   M(q) ω' = τ(q, P) - C(q, ω) - D ω - g(q) + d
    P_j' = (u_j - P_j)/τ_j - κ (P_j + p_a) V_j'/V_j^eff, the second term not with `gas=False`                     (G3)
    K(q, P) = -∂τ/∂q at constant pressures                                                                        (M2)

The state is x = (q, ω, P) ∈ R^(2n+m), in SI units. Over a sample of constant commands it is integrated by the classical
Runge–Kutta method. Without gas the pressures are known, P(t) = u + (P - u) exp(-t/τ), and only the bodies are
integrated along them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.allocation.box import pivoting
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.assumption import filled
from allocator.joint.gas import Gas
from allocator.lazy import SX, Function
from allocator.mechanism import Mechanism, machines
from allocator.mechanism.bodies import BODIES, check_bodies
from allocator.mechanism.endpoint.endpoint import Endpoint, stiffness_of
from allocator.mechanism.routes.mjcf import Source
from allocator.muscles import Muscle
from allocator.units import BAR
from mpc.model.arm import formulas, ranges, tangents
from mpc.model.arm.formulas import Statics
from mpc.model.arm.pneumatics import Pneumatics
from mpc.model.experiment import FINE, RESOLUTION, ExactExperiment, Held, Labels, check_stiffness, substeps
from mpc.model.pressures import gas_of, text_of

_MOST_SUBSTEPS = 1000  # per sample
_MISSED = 1e-6  # [-] of a stiffness, or [N·m]


@dataclass(frozen=True)
class Arm:
    """Mechanism with bodies and regulators; immutable. SI units."""

    mechanism: Mechanism
    bodies: Any  # `Bodies`, `TreeBodies` or `MujocoBodies`
    lag: float | tuple[float, ...] = 0.1  # τ of the regulators [s], one or m of them
    slew: float = 5 * BAR  # greatest change of a command [Pa/s]
    endpoint: Endpoint | None = None  # with the tracked stiffness K_x [N/m]; None: K of the joints
    gas: Gas | bool | None = True  # the mechanism's; False, None: regulators hold the pressures

    def __post_init__(self) -> None:
        """Check the consistency of the parts. Raises `InvalidInput`."""
        if not isinstance(self.mechanism, Mechanism) or not hasattr(self.bodies, "mass_matrix"):
            raise InvalidInput("Arm: expected a Mechanism and its Bodies, such as Arm.machine('arm26')")
        n, m = self.mechanism.n, self.mechanism.m
        check_bodies(self.bodies, self.mechanism)
        if self.endpoint is not None:
            if not isinstance(self.endpoint, Endpoint):
                raise InvalidInput(f"Arm: endpoint is a {type(self.endpoint).__name__}; expected an Endpoint")
            if not self.endpoint.dim <= self.endpoint.n == n:
                raise InvalidInput(f"Arm: {self.endpoint.text} for n = {n} joints: at most {n} coordinates (tip:xy)")
        self._check_gas()
        lag = checks.real("Arm: lag", self.lag, "s")
        if lag.shape not in ((), (m,)) or not ((lag >= 1e-4) & (lag <= 10)).all():
            raise InvalidInput(f"Arm: lag = {checks.brief(self.lag)} has to be one time, or m = {m}, of 0.0001 to 10 s")
        object.__setattr__(self, "lag", tuple(np.broadcast_to(lag, (m,)).tolist()))
        object.__setattr__(self, "slew", checks.number("Arm: slew", self.slew, "Pa/s"))
        if not self.slew > checks.LOOKS_LIKE_BAR[1]:
            raise InvalidInput(f"Arm: slew = {self.slew:g} Pa/s is tiny; if bar/s was meant, multiply by 1e5")

    def __getstate__(self) -> dict[str, object]:
        """Leave out the formulas, which cannot be pickled; each process creates them for itself."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def _check_gas(self) -> None:
        gas = gas_of("Arm: gas", self.gas, self.mechanism.gas)
        object.__setattr__(self, "gas", gas)
        if gas is None:
            return
        try:
            lengths = self.mechanism.routes.rest_length
            muscles, assumed = filled(self.mechanism.muscles, lengths, self.pressure_limits[1])
            if assumed or self.mechanism.gas != gas:
                object.__setattr__(self, "mechanism", replace(self.mechanism, muscles=muscles, gas=gas))
            Pneumatics(muscles, lengths, gas=gas)  # checks the volumes
        except InvalidInput as error:
            raise InvalidInput(f"{error}; gas=False or --no-gas leaves the gas out") from None

    @classmethod
    def machine(cls, name: str) -> "Arm":
        """Return the ready-made machine of this name, a key of `BODIES`. Raises `MissingBackend` for another name."""
        if name not in BODIES:
            raise MissingBackend("arm", name, list(BODIES))
        return cls(machines.MACHINES[name](), BODIES[name]())

    @classmethod
    def from_mjcf(
        cls,
        source: Source,
        muscles: Muscle | Sequence[Muscle],
        rest_length: ArrayLike | None = None,
        *,
        cable: ArrayLike | None = None,
        contraction: ArrayLike | None = None,
        pressure_limits: tuple[float, float] = (0.0, 5 * BAR),
        lag: float | tuple[float, ...] = 0.1,
        slew: float = 5 * BAR,
    ) -> Self:
        """Return the arm of a MuJoCo model: a file, MJCF text or an `MjModel`, whose joints are hinges.

        `muscles`, `rest_length` and `cable` [m] are those of `Mechanism.from_mjcf`; `contraction` [-] of the muscles in
        the model's own posture may replace `cable`. MuJoCo evaluates parts without formulas, slowly. Contacts, stops,
        dry friction and actuators are left out. Raises `InvalidFile`, `InvalidInput` and `MissingPackage`.
        """
        from mpc.model.arm.reading import read_arm

        read = read_arm(source, muscles, rest_length, cable, contraction, pressure_limits)
        return cls(read.mechanism, read.bodies, lag, slew)

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return self.mechanism.n

    @cached_property
    def m(self) -> int:
        """Number of muscles."""
        return self.mechanism.m

    @property
    def size(self) -> int:
        """Number of states, 2n + m."""
        return 2 * self.n + self.m

    @property
    def angle_shape(self) -> tuple[int]:
        """Shape (n,) of an angle reference."""
        return (self.n,)

    @property
    def stiffness_shape(self) -> tuple[int, int]:
        """Shape (k, k) of a stiffness reference."""
        return self.tracked, self.tracked

    @property
    def has_stops(self) -> bool:
        """Whether the angles are limited by end stops."""
        return self.mechanism.angle_limits is not None

    @property
    def inertias(self) -> Array:
        """Moments of inertia (n,) [kg·m²] for the acceleration of each joint alone, in the middle of the ranges."""
        return np.asarray(np.diag(self.bodies.mass_matrix(self.middle)))

    @cached_property
    def labels(self) -> Labels:
        """Names of its columns in tables."""
        pairs = zip(*np.triu_indices(self.tracked), strict=True)
        joints, muscles = self.mechanism.joint_names, self.mechanism.muscle_names
        entries = tuple(f"{self.stiffness_name}{i + 1}{j + 1}" for i, j in pairs)
        return Labels(joints, joints, entries, muscles, tuple(f"{name} force" for name in muscles))

    @property
    def lags(self) -> Array:
        """Time constants of the regulators (m,) [s]."""
        return np.array(self.lag)

    @property
    def lags_each_way(self) -> tuple[Array, Array]:
        """Time constants (m,) [s] of rising and of falling pressures, the same."""
        return self.lags, self.lags

    @property
    def pressure_limits(self) -> tuple[float, float]:
        """Least and greatest command [Pa]."""
        return self.mechanism.pressure_limits

    @cached_property
    def angle_limits(self) -> tuple[Array, Array]:
        """Least and greatest angles (n,) [rad]; one turn to both sides if there are no limits."""
        limits = self.mechanism.angle_limits
        turn = np.full(self.n, 2 * np.pi)
        return (-turn, turn) if limits is None else (np.array(limits)[:, 0], np.array(limits)[:, 1])

    def stiffness(self, x: Array) -> Array:
        """Return K (…, n, n) [N·m/rad] in the states `x` (…, 2n + m)."""
        return self.mechanism.stiffness(*self._held(x))

    def tracked_stiffness(self, x: Array) -> Array:
        """Return K (…, k, k) in the states `x` (…, 2n + m): of the joints [N·m/rad], or of the endpoint [N/m].

        It is the muscles' stiffness, without `bodies.gravity_stiffness`. NaN where the endpoint is singular.
        """
        return self.seen(np.asarray(x[..., : self.n]), self.stiffness(x))

    def seen(self, q: Array, K: Array) -> Array:
        """Return the tracked stiffness (…, k, k) for joint stiffness `K` (…, n, n) at the postures `q` (…, n)."""
        return K if self.endpoint is None else stiffness_of(self.endpoint.at(q), K)

    def forces(self, x: Array) -> Array:
        """Return the muscles' forces (…, m) [N] in the states `x` (…, 2n + m); negative means slack."""
        return self.mechanism.forces(*self._held(x))

    def _held(self, x: Array) -> tuple[Array, Array]:
        return x[..., : self.n], x[..., 2 * self.n :]

    def at_rest(self, q: ArrayLike, K: ArrayLike, min_force: float = 0.0) -> Array:
        """Return the state (2n + m,) in equilibrium at `q` (n,) [rad], with the feasible stiffness nearest to `K`.

        `K` is a matrix (k, k), its diagonal (k,) or a number for the whole diagonal. Raises `InvalidInput`.
        """
        posture, asked = self.mechanism.posture(q), checks.real("K", K, self.stiffness_unit)
        if posture.ndim > 1:
            raise InvalidInput(f"q has the shape {posture.shape}; a rest is at one posture ({self.n},) [rad]")
        T = self.bodies.gravity_torque(posture)
        held = self.held(posture[None], asked[None] if asked.ndim else asked, T[None], min_force)
        return np.concatenate([posture, np.zeros(self.n), held.P[0]])

    def held(self, theta: Array, K: Array, T: Array, min_force: float) -> Held:
        """Return the pressures along a motion: angles (M, n), stiffness (M, k, k) and torques (M, n)."""
        found = tangents.allocated(self, theta, K, T, min_force)
        joints = self.endpoint is None
        given, missed = (found.K, found.K_error) if joints else (found.K_x, found.K_x_error)
        return Held(found.P, self.svec(given), missed, found.T_error)

    def torque_for(self, theta: Array, omega: Array, alpha: Array, d: Array | float = 0.0) -> Array:
        """Return the muscle torques (…, n) [N·m] of a motion (q, ω, ω'): M ω' + C + D ω + g - d."""
        return np.asarray(self.bodies.torque_for(theta, omega, alpha) - d)

    def balance(self, x: Array) -> Array:
        """Return the external torques (n,) [N·m] that hold the state `x` (2n + m,) against gravity and muscles."""
        q, P = self._held(x)
        return np.asarray(self.bodies.gravity_torque(q) - self.mechanism.torque(q, P))

    def torque_reach(self) -> tuple[Array, Array]:
        """Return the greatest |T| (n,) [N·m] of the muscles together in the middle of the ranges, and anywhere."""
        return ranges.torque_reach(self)

    def expansion(self, x: Array) -> Array:
        """Return the fall of the pressures (m, …) [Pa/s] as the muscles swell, in the states `x` [2n + m, …]."""
        q, omega, P = x[: self.n].T, x[self.n : 2 * self.n].T, x[2 * self.n :].T
        if self.gas is None:
            return np.asarray(0.0 * P.T)
        routed = self.mechanism.routes.at(np.asarray(q, float))
        speed = -(routed.arm @ np.asarray(omega, float)[..., None])[..., 0]  # l' = -r·ω
        filled = Pneumatics(self.mechanism.muscles, self.mechanism.routes.rest_length, gas=self.gas)
        return np.asarray(-filled.squeezed(np.asarray(P, float), routed.length, speed).T)

    def angles(self, x: Array) -> Array:
        """Return the angles (…, n) [rad] in the states `x` (…, 2n + m)."""
        return x[..., : self.n]

    def along(self, x: Array, gains: ArrayLike = 1.0) -> tuple[Array, Array]:
        """Return the tracked stiffness (M, k, k) and the muscle forces (M, m) [N] in the states `x` (M, 2n + m).

        `gains` [-], a number or (m,), multiply the forces of the muscle models. States are not checked: an arm
        without stops may turn over. A state with NaN, as of a silent encoder, gives NaN.
        """
        known = np.asarray(np.isfinite(x).all(axis=-1))
        q, P = self._held(np.where(known[:, None], x, np.append(self.middle, np.zeros(self.n + self.m))))
        gains = np.broadcast_to(np.asarray(gains, float), (self.m,))
        muscles = list(zip(self.mechanism.at(q), P.T, gains.tolist(), strict=True))
        K = sum(gain * muscle.stiffness(pressure) for muscle, pressure, gain in muscles)
        F = np.stack([gain * muscle.force(pressure) for muscle, pressure, gain in muscles], axis=-1)
        return np.where(known[:, None, None], self.seen(q, np.asarray(K)), np.nan), np.where(known[:, None], F, np.nan)

    @property
    def stiffness_text(self) -> str:
        """Kind of the tracked stiffness, in words."""
        return "isobaric stiffness" if self.endpoint is None else "isobaric stiffness of the endpoint"

    def assumed(self, x: Array) -> str:
        """Return "": an arm does not know which of its forces were measured."""
        return ""

    def reachable(self, theta: Array, K: Array, T: Array) -> Array:
        """Return whether (M,) any pressures give these stiffnesses and torques."""
        found = self.held(theta, K, T, 0.0)
        missed = np.abs(found.K_error).max(axis=(-2, -1)) > _MISSED * np.abs(K).max(axis=(-2, -1))
        return np.asarray(~(missed | (np.abs(found.T_error).max(axis=-1) > _MISSED)))

    def warm_up(self, min_force: float) -> None:
        """Compile the allocation."""
        pivoting.warm_up()

    def check_angles(self, name: str, theta: Array) -> None:
        """Raise `InvalidInput` for implausible angles (M, n), or where the endpoint is singular."""
        if not np.abs(theta).max() <= 2 * np.pi:  # for the message
            checks.angle(name, theta)
        if self.endpoint is not None:
            try:
                self.endpoint.check_rank(self.endpoint.at(np.clip(theta, *self.angle_limits)))
            except InvalidInput as singular:
                raise InvalidInput(f"{name}: {singular}") from None

    def check_stiffness(self, name: str, K: Array) -> None:
        """Raise `InvalidInput` for implausible stiffness matrices (M, k, k)."""
        check_stiffness(name, K, self.stiffness_unit)

    @property
    def nominal(self) -> "Arm":
        """Model of the arm for controllers: the arm itself."""
        return self

    def begin(self, dt: float, x0: Array, seed: int) -> ExactExperiment:
        """Begin an experiment from the state `x0` (2n + m,) with commands every `dt` [s]; no noise needs the `seed`."""
        return ExactExperiment(self.discrete(dt, FINE), x0)

    @property
    def unformulated(self) -> str:
        """Description of the parts without formulas; "" if there are none."""
        return formulas.missing(self.mechanism.routes, self.bodies)

    @property
    def tracked(self) -> int:
        """Number of rows of the tracked stiffness: n joints, or the coordinates of the endpoint."""
        return self.n if self.endpoint is None else self.endpoint.dim

    @property
    def stiffnesses(self) -> int:
        """Number of entries of svec K."""
        return self.tracked * (self.tracked + 1) // 2

    @property
    def stiffness_name(self) -> str:
        """Symbol of the tracked stiffness."""
        return "K" if self.endpoint is None else "Kx"

    @property
    def stiffness_unit(self) -> str:
        """Unit of the tracked stiffness."""
        return "N·m/rad" if self.endpoint is None else "N/m"

    @cached_property
    def middle(self) -> Array:
        """Posture (n,) [rad] in the middle of the ranges, or near it if the endpoint is singular there."""
        return ranges.middle(self)

    @cached_property
    def entries(self) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Rows, columns and factors of svec K: K11, √2 K12, …, K22, …, with the same square as all entries of K.

        The endpoint's are those of lever² K_x [N·m/rad], which has the weight of a joint's stiffness (`ranges.lever`).
        """
        rows, columns = np.triu_indices(self.tracked)
        return rows, columns, ranges.lever(self) ** 2 * np.where(rows == columns, 1.0, 2**0.5)

    def svec(self, K: Array) -> Array:
        """Return svec K (…, k(k+1)/2) of matrices (…, k, k)."""
        rows, columns, factors = self.entries
        return np.asarray(K[..., rows, columns] * factors)

    def matrix(self, vector: Array) -> Array:
        """Return the matrices (…, k, k) of svec K (…, k(k+1)/2)."""
        return np.take(vector / self.entries[2], self._places, axis=-1)

    @cached_property
    def _places(self) -> NDArray[np.intp]:
        """Places (k, k) of the entries of K in svec K."""
        rows, columns, factors = self.entries
        places = np.empty((self.tracked, self.tracked), np.intp)
        places[rows, columns] = places[columns, rows] = np.arange(factors.size)
        return places

    @cached_property
    def statics(self) -> Statics:
        """Torques, stiffness and forces as formulas. Raises `InvalidInput` for routes without any."""
        return formulas.statics(self.mechanism)

    @cached_property
    def outputs(self) -> "SX":
        """CasADi column (svec K, F) over `statics.q` and `statics.P`."""
        return formulas.outputs(self)

    def symbolic_outputs(self, x: Value) -> Value:
        """Return the CasADi column (svec K, F) in the state `x` (2n + m,)."""
        return formulas.along("outputs", self.statics, self.outputs)(x[: self.n], x[2 * self.n :])

    def discrete(self, dt: float, resolution: float = RESOLUTION) -> "Function":
        """Return the CasADi function (x, u, d) ↦ x after `dt` [s] of constant u (m,) [Pa] and d (n,) [N·m]."""
        return formulas.discrete(self, dt, self.substeps(dt, resolution))

    @cached_property
    def fastest_rate(self) -> float:
        """Estimate of the fastest eigenvalue [1/s] at full pressure, which determines integration steps."""
        return ranges.fastest_rate(self)

    def substeps(self, dt: float, resolution: float) -> int:
        """Return the number of equal steps over `dt` [s] for `fastest_rate`. Raises `InvalidInput` above 1000."""
        check = "; check masses, inertias and damping of its bodies"
        return substeps("this arm", dt, self.fastest_rate, resolution, _MOST_SUBSTEPS, check)

    def __repr__(self) -> str:
        return f"Arm: {self.summary}"

    @property
    def summary(self) -> str:
        """One line with the numbers."""
        lags = "/".join(f"{lag:g}" for lag in dict.fromkeys(self.lags.tolist()))
        gas = text_of(self.gas, self.mechanism.muscles, self.mechanism.routes.rest_length)
        return (
            f"{self.n} joints, {self.m} muscles, lag {lags} s, slew {self.slew / BAR:g} bar/s, {self.bodies.summary}, "
            f"{gas}"
        )
