"""Plant of the controllers' predictions and of nominal tests: a joint with a link and two pressure lags.

    θ' = ω
    J ω' = T(θ, P1, P2) - b ω - m g l sin(θ - θ_h) + d
    P_i' = (u_i - P_i)/τ_i  -  κ (P_i + p_a) V_i'/V_i^eff, the second term not with `gas=False`                   (G3)

with one τ_i of a rising and another of a falling pressure if `venting` is not 1 (`mpc.model.pressures`).

State x = (θ [rad], ω [rad/s], P1 [Pa], P2 [Pa]), input u = commanded pressures [Pa], disturbance torque d [N·m]. The
stiffness K(θ, P1, P2) is computed, never measured: the isobaric one, or that at a `frequency`. The controller has to
limit changes of the command to `slew` [Pa/s]. `Plant.rate` is the only implementation of this formula, for numbers and
for CasADi symbols. Slack muscles (F < 0) keep their model's force; the metrics report its use.
"""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import product
from math import inf, sqrt
from os import PathLike
from typing import ClassVar

import numpy as np

from allocator import allocate, checks, warm_up
from allocator.allocation.two_muscles.result import PairAllocation
from allocator.calculus import Array, Value
from allocator.errors import InvalidFile, InvalidInput
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.assumption import assumptions, with_volumes
from allocator.joint.gas import HELD, ISOBARIC, Gas, Shares, Stiffness, StiffnessKind
from allocator.joint.gravity import Gravity
from allocator.joint.limits import Limits
from allocator.lazy import Function
from allocator.units import BAR
from mpc.model.experiment import FINE, RESOLUTION, ExactExperiment, Held, Labels, integrated, substeps
from mpc.model.pressures import each_way, fall, gas_of, pair_of_lags, pull, text_of, trapped
from mpc.model.storage import load_plant, save_plant

STATES = ("theta", "omega", "P1", "P2")
INPUTS = ("P1_command", "P2_command")
NX, NU = len(STATES), len(INPUTS)


@dataclass(frozen=True)
class Plant:
    """Link on an `AntagonistJoint` with first-order pressure lags. Immutable; SI units."""

    joint: AntagonistJoint = field(default_factory=report_joint)
    inertia: float = 0.05  # J [kg·m²]
    damping: float = 0.1  # b [N·m·s/rad]
    lag: float | tuple[float, float] = 0.1  # τ, or (τ1, τ2) [s], each the mean of a rising and a falling pressure
    gravity_torque: float = 0.0  # m g l [N·m]
    slew: float = 5 * BAR  # greatest change of a command [Pa/s]
    gas: Gas | bool | None = True  # the joint's; False, None: regulators hold the pressures
    frequency: float = 0.0  # of K [Hz]: 0 is isobaric, inf with all of the gas trapped   (G5)
    venting: float = 1.0  # lag of a falling pressure over that of a rising one [-]
    hanging_angle: float = 0.0  # θ_h at which the link hangs [rad] (stands, if its torque is negative)

    n: ClassVar[int] = 1  # these fields make it a machine of one joint, see `mpc.model.machine`
    m: ClassVar[int] = NU
    size: ClassVar[int] = NX
    stiffnesses: ClassVar[int] = 1
    angle_shape: ClassVar[tuple[int, ...]] = ()
    stiffness_shape: ClassVar[tuple[int, ...]] = ()
    unformulated: ClassVar[str] = ""
    stiffness_unit: ClassVar[str] = "N·m/rad"
    labels: ClassVar[Labels] = Labels(("theta",), ("omega",), ("stiffness",), ("P1", "P2"), ("F1", "F2"))

    def __post_init__(self) -> None:
        """Convert the parameters to plain floats (CasADi does not accept NumPy scalars) and check them."""
        known = "an AntagonistJoint; Plant.load reads a file, and an Arm has several joints"
        checks.instance("joint", self.joint, AntagonistJoint, known)
        for name, check, unit in _CHECKS:
            object.__setattr__(self, name, check(name, getattr(self, name), unit))
        object.__setattr__(self, "hanging_angle", self.gravity.hanging)  # checked by it
        if self.inertia > _HEAVIEST:
            raise InvalidInput(f"inertia = {self.inertia:g} kg·m² is over 100; if kg·cm² was meant, divide by 10000")
        if self.slew <= checks.LOOKS_LIKE_BAR[1]:
            raise InvalidInput(f"slew = {self.slew:g} Pa/s is next to nothing; if bar/s was meant, multiply by 1e5")
        object.__setattr__(self, "lag", pair_of_lags(self.lag))
        self._check_gas()

    def _check_gas(self) -> None:
        frequency = checks.number_or_inf("frequency", self.frequency, "Hz")
        if frequency < 0:
            raise InvalidInput(f"frequency = {frequency:g} Hz has to be 0 or more")
        object.__setattr__(self, "frequency", frequency)
        gas = gas_of("gas", self.gas, self.joint.gas)
        object.__setattr__(self, "gas", gas)
        if gas is None:
            if frequency:
                raise InvalidInput(f"frequency = {frequency:g} Hz: the stiffness has none with gas=False")
            return
        try:
            joint, _ = with_volumes(self.joint)
            object.__setattr__(self, "joint", joint if joint.gas == gas else replace(joint, gas=gas))
            for angle in self.joint.angle_range:
                for side, P in product(self.joint.sides(angle, _ALL), self.joint.pressure_limits):
                    side.check_volume(P)
        except InvalidInput as error:
            raise InvalidInput(f"{error}; gas=False or --no-gas leaves the gas out") from None

    @property
    def pressure_limits(self) -> tuple[float, float]:
        """Least and greatest command [Pa]."""
        return self.joint.pressure_limits

    @property
    def angle_limits(self) -> tuple[float, float]:
        """Least and greatest angle [rad]."""
        return self.joint.angle_range

    @cached_property
    def gravity(self) -> Gravity:
        """Gravity of the link. `stiffness` is without it."""
        return Gravity(self.gravity_torque, self.hanging_angle)

    @property
    def lags(self) -> tuple[float, float]:
        """Mean time constants (τ1, τ2) of the pressures [s]."""
        assert isinstance(self.lag, tuple)  # __post_init__ made it one
        return self.lag

    @property
    def lags_each_way(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Time constants of both rising and of both falling pressures [s]."""
        return each_way(self.lags, self.venting)

    # --- the equations ----------------------------------------------------------------------------------------------

    def rate(self, x: Value, u: Value, d: Value = 0.0) -> tuple[Value, Value, Value, Value]:
        """Return x' = f(x, u, d): `x` [4, ...], `u` [2, ...], numbers or CasADi columns."""
        theta, omega, P1, P2 = x[0], x[1], x[2], x[3]
        moment = self.torque(x) - self.damping * omega - self.gravity.moment(theta) + d
        rates = tuple(map(pull, (u[0] - P1, u[1] - P2), *self.lags_each_way))
        if self.gas is not None:
            falls = self.expansion(x)
            rates = rates[0] - falls[0], rates[1] - falls[1]
        return omega, moment / self.inertia, *rates

    def expansion(self, x: Value, strengths: tuple[float, float] = (1.0, 1.0)) -> tuple[Value, Value]:
        """Return the fall of the pressures [Pa/s] as the muscles swell, in the state `x` [4, ...]; 0 without gas.

        κ (P_i + p_a) V_i'/V_i^eff   (G3), of muscles with `strengths` [-] times the forces of their models.
        """
        if self.gas is None:
            return 0.0 * x[1], 0.0 * x[1]
        sides = zip(self.joint.sides(x[0], _ALL), (x[2], x[3]), strengths, strict=True)
        one, two = (fall(side, P, strength) * x[1] for side, P, strength in sides)
        return one, two

    def torque(self, x: Value) -> Value:
        """Return T(θ, P1, P2) [N·m] of the muscles in the state `x` [4, ...]."""
        agonist, antagonist = self.joint.sides(x[0])
        return agonist.torque(x[2]) + antagonist.torque(x[3])

    def pull(self, x: Value) -> Value:
        """Return a1 F1 + a2 F2 [N·m], the sum of the opposing torques, in the state `x` [4, ...]."""
        agonist, antagonist = self.joint.sides(x[0])
        return agonist.torque(x[2]) - antagonist.torque(x[3])

    def stiffness(self, x: Value) -> Value:
        """Return the stiffness K(θ, P1, P2) [N·m/rad] in the state `x` [4, ...]: isobaric, or at the `frequency`."""
        agonist, antagonist = self.joint.sides(x[0], self.shares)
        return agonist.stiffness(x[2]) + antagonist.stiffness(x[3])

    def dynamic_stiffness(self, x: Value, frequency: Value, amplitude: float | None = None) -> Value:
        """Return the complex stiffness [N·m/rad] at a `frequency` [Hz] in the state `x` [4, ...], damping included.

        For pushes by ±`amplitude` [rad], the joint's hysteresis is included.
        """
        at = x[0], x[2], x[3], frequency, 0.0 if self.gas is None else self.lags
        return self.joint.dynamic_stiffness(*at, amplitude=amplitude, damping=self.damping)

    def isobaric(self, x: Value) -> Value:
        """Return the isobaric stiffness [N·m/rad] in the state `x` [4, ...]."""
        agonist, antagonist = self.joint.sides(x[0])
        return agonist.stiffness(x[2]) + antagonist.stiffness(x[3])

    @property
    def shares(self) -> Shares | None:
        """Shares (s1, s2) of the trapped gas in the stiffness [-]; None: it is isobaric   (G5)"""
        return self.kind.fixed if self.frequency else None

    @property
    def kind(self) -> StiffnessKind:
        """Kind of its stiffness: isobaric, shut, or dynamic at its frequency."""
        if self.frequency == inf:
            return StiffnessKind.of("shut")
        kind = StiffnessKind.of(frequency=self.frequency, lag=self.lags) if self.frequency else HELD
        return kind.of_gas(self.joint.gas, self.joint.affine)

    def allocate(self, theta: Value, K: Value, T: Value, min_force: float = 0.0) -> PairAllocation:
        """Return the allocation (`allocator.allocate`) of stiffness [N·m/rad] and torque [N·m] at the angle [rad]."""
        stiffness = Stiffness(self.kind) if self.frequency else ISOBARIC
        return allocate(theta, K, T, joint=self.joint, limits=Limits(min_force), stiffness=stiffness)

    def forces(self, x: Value) -> tuple[Value, Value]:
        """Return the muscle forces (F1, F2) [N] in the state `x` [4, ...]; negative means slack."""
        agonist, antagonist = self.joint.sides(x[0])
        return agonist.force(x[2]), antagonist.force(x[3])

    def torque_for(self, theta: Value, omega: Value, alpha: Value, d: Value = 0.0) -> Value:
        """Return the muscle torque [N·m] of the motion (θ, θ', θ''): T = J θ'' + b θ' + m g l sin(θ - θ_h) - d."""
        return self.inertia * alpha + self.damping * omega + self.gravity.moment(theta) - d

    def at_rest(self, theta: float, K: float) -> Array:
        """Return the state (4,) in equilibrium at `theta` [rad], with the feasible stiffness nearest `K` [N·m/rad]."""
        theta = float(checks.angle("theta", checks.number("theta", theta, "rad")))
        held = self.allocate(theta, K, self.torque_for(theta, 0.0, 0.0))
        return np.array([theta, 0.0, held.P1, held.P2], float)

    @property
    def nominal(self) -> "Plant":
        """Model of the plant for controllers: the plant itself."""
        return self

    def begin(self, dt: float, x0: Array, seed: int) -> ExactExperiment:
        """Begin an experiment from the state `x0` (4,) with commands every `dt` [s]; no noise needs the `seed`."""
        return ExactExperiment(self.discrete(dt, FINE), x0)

    # --- as a machine of one joint ----------------------------------------------------------------------------------

    @property
    def has_stops(self) -> bool:
        """Whether the angle is limited by end stops."""
        return self.joint.angle_limits is not None

    @property
    def middle(self) -> float:
        """Middle of the joint range [rad]."""
        return float(np.mean(self.joint.angle_range))

    @property
    def inertias(self) -> Array:
        """Moment of inertia (1,) [kg·m²]."""
        return np.array([self.inertia])

    def angles(self, x: Array) -> Array:
        """Return the angles [rad] in the states `x` (…, 4)."""
        return np.asarray(x[..., 0])

    def tracked_stiffness(self, x: Array) -> Value:
        """Return the stiffness [N·m/rad] in the states `x` (…, 4)."""
        return self.stiffness(x.T)

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return stiffness (M,) [N·m/rad] and muscle forces (M, 2) [N] in the states `x` (M, 4)."""
        return np.asarray(self.stiffness(x.T)), np.stack(self.forces(x.T), axis=1)

    @property
    def stiffness_text(self) -> str:
        """Kind of its stiffness, in words."""
        return self.kind.text

    def assumed(self, x: Array) -> str:
        """Return a sentence listing the assumptions behind the forces in the states `x` (M, 4), or ""."""
        return assumptions(self.joint, x[:, 0], x[:, 2], x[:, 3])

    def reachable(self, theta: Array, K: Array, T: Array) -> Array:
        """Return whether any pressures give the isobaric stiffness and torque at these angles (M,)."""
        return np.asarray(allocate(theta, K, T, joint=self.joint).success)

    def symbolic_outputs(self, x: Value) -> Value:
        """Return the CasADi column (K, F1, F2) in the state `x`."""
        import casadi as ca

        return ca.vertcat(self.stiffness(x), *self.forces(x))

    def matrix(self, svec: Array) -> Array:
        """Return `svec` (M,), since the stiffness of a joint is a number."""
        return svec

    def torque_reach(self) -> tuple[Array, Array]:
        """Return the greatest |T| (1,) [N·m] of the muscles in the middle of the joint range, and anywhere in it."""
        low, high = self.joint.pressure_limits
        theta = np.linspace(*self.joint.angle_range, 9)
        one, two = (np.full(theta.shape, P) for P in (low, high))
        torques = np.abs([self.torque((theta, 0 * theta, *P)) for P in ((two, one), (one, two))])
        return torques[:, theta.size // 2].max(keepdims=True), torques.max().reshape(1)

    def balance(self, x: Array) -> float:
        """Return the external torque [N·m] that holds the state `x` (4,) against gravity and muscles."""
        return float(self.gravity.moment(x[0]) - self.torque(x))

    def held(self, theta: Array, K: Array, T: Array, min_force: float) -> Held:
        """Return the pressures of `allocate` along a motion (M,)."""
        found = self.allocate(theta, K, T, min_force)
        P, given = np.stack([found.P1, found.P2], axis=1), np.asarray(found.K)[:, None]
        return Held(P, given, np.asarray(found.K_error), np.asarray(found.T_error))

    def warm_up(self, min_force: float) -> None:
        """Compile the allocation of this joint."""
        warm_up(joint=self.joint, min_force=min_force)

    def check_angles(self, name: str, theta: Array) -> None:
        """Raise `InvalidInput` for implausible angles."""
        checks.angle(name, theta)

    def check_stiffness(self, name: str, K: Array) -> None:
        """Raise `InvalidInput` for implausible stiffnesses."""
        checks.stiffness(name, K)

    def __repr__(self) -> str:
        return f"Plant: {self.joint!r}; {self.summary}"

    @property
    def summary(self) -> str:
        """One line with its numbers, without those of the joint."""
        joint = self.joint
        gas_text = text_of(self.gas, (joint.agonist, joint.antagonist), [joint.geometry.rest_length] * 2)
        return (
            f"inertia {self.inertia:g} kg·m², damping {self.damping:g} N·m·s/rad, lag "
            f"{self._lag_text}, gravity {self.gravity}, slew {self.slew / BAR:g} bar/s, "
            + (gas_text if self.gas is None else f"{gas_text}, {self.kind.text}")
        )

    @property
    def _lag_text(self) -> str:
        lags = f"{' and '.join(f'{lag:g}' for lag in dict.fromkeys(self.lags))} s"
        return lags if self.venting == 1 else f"{lags} (venting {self.venting:.3g} times as slow)"

    @property
    def numbers(self) -> dict[str, object]:
        """Numbers of its file except the joint's, by the names of the fields."""
        return {name: getattr(self, name) for name in NUMBERS} | {"gas": self.gas is not None}  # the joint's

    def save(self, path: str | PathLike[str]) -> None:
        """Write the plant, including joint and muscles, as a TOML file. Raises `CannotWrite`."""
        save_plant(path, self.joint, self.numbers)

    @classmethod
    def load(cls, path: str | PathLike[str], *, slew: float | None = None, scale_needed: bool = True) -> "Plant":
        """Read a plant from TOML; a joint's file gives one with the numbers of `Plant()`.

        `slew` [Pa/s] is that of the regulators, which fits do not identify; None takes the file's. Raises
        `InvalidFile`, also if the scale of the joint's forces is unknown, unless `scale_needed` is false, and
        `InvalidInput` for the slew.
        """
        joint, numbers = load_plant(path, NUMBERS, scale_needed=scale_needed)
        try:
            plant = Plant(joint, **numbers)
            for lag in plant.lags:
                checks.delay("lag", lag, "regulator", checks.SLOWEST)
        except (InvalidInput, TypeError, OverflowError) as error:
            raise InvalidFile(path, f"[plant]: {error}") from None
        return plant if slew is None else replace(plant, slew=slew)

    # --- in discrete time, and for other tools ----------------------------------------------------------------------

    @property
    def fastest_rate(self) -> float:
        """Upper estimate of the fastest eigenvalue [1/s], which determines integration steps."""
        P = self.joint.pressure_limits[1]
        angles = np.linspace(*self.joint.angle_range, 9)
        K = float(np.max(sum(side.stiffness(P + 0 * angles) for side in self.joint.sides(angles))))
        if self.gas is not None:
            sides = self.joint.sides(angles, _ALL)
            K += float(np.max(sum(trapped(side, P + 0 * angles) for side in sides)))
        swing = sqrt((max(K, 0.0) + abs(self.gravity_torque)) / self.inertia)
        return max(swing, self.damping / self.inertia, *(1 / tau for way in self.lags_each_way for tau in way))

    def substeps(self, dt: float, resolution: float) -> int:
        """Return the number of equal steps h over `dt` [s] with h · `fastest_rate` ≤ `resolution`.

        Raises `InvalidInput` for more than 10 000, which suggests a mistake in the plant.
        """
        check = f", over {MOST_SUBSTEPS}; check {self.summary}"
        return substeps("this plant", dt, self.fastest_rate, resolution, MOST_SUBSTEPS, check)

    def discrete(self, dt: float, resolution: float = RESOLUTION) -> "Function":
        """Return the CasADi function (x, u, d) ↦ x after `dt` [s] of constant u and d: classical Runge–Kutta.

        The substeps h are equal, with h · `fastest_rate` ≤ `resolution`. The error is about resolution⁴/120 of the
        change: 5e-4 at 0.5, 1e-9 at 0.02.
        """
        import casadi as ca

        x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
        rate = ca.Function("rate", [x, u, d], [ca.vertcat(*self.rate(x, u, d))])  # built once, not for every stage
        later = integrated(lambda x, t: rate(x, u, d), x, dt, self.substeps(dt, resolution))
        return ca.Function("discrete", [x, u, d], [later], ["x", "u", "d"], ["x_next"])


NUMBERS = tuple(f.name for f in fields(Plant) if f.name != "joint")
_CHECKS = (
    ("inertia", checks.positive, "kg·m²"),
    ("damping", checks.not_negative, "N·m·s/rad"),
    ("venting", checks.positive, "-"),
    ("gravity_torque", checks.number, "N·m"),
    ("slew", checks.positive, "Pa/s"),
)
_ALL = 1.0, 1.0  # shares of the gas that is trapped
_HEAVIEST = 100.0  # inertia [kg·m²]
MOST_SUBSTEPS = 10_000  # per sample
