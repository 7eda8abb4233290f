"""Tasks of arms that learn: an arm with the sensors of a test rig, and the goals and costs of its episodes.

Observations are the encoders now and one sample before, the pressure sensors, the last commands and the task's targets:
(q, q before, P, u, targets) (blocks of n, m or a numbers), angles in rad, pressures in bar. Velocities and parameters
of the arm are not observed. Rewards are minus the costs of the task and of the pressures.

Domain randomisation: arms that differ from the nominal one within its uncertainty.

The parameters of every fitted muscle are drawn from the normal distribution with the covariance of its fit, equal for
all muscles of a kind, because they were fitted once. Parameters without a fit are drawn with the widths of `Variation`.

Reaching: an arm has to hold a posture under unknown torques. Wiping: a hand has to slide along a wall and to press on
it with a force, both of which it does not sense.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.gas import Gas
from allocator.muscles import Muscle
from allocator.muscles.uncertainty import covariance_root
from allocator.units import BAR, DEG
from mpc.arm.learning.actions import KINDS
from mpc.arm.learning.plant import Touch, VariedArm, Wall
from mpc.model.arm.model import Arm
from mpc.model.arm.ranges import OutOfReach, followed

_LOOKED_AT, _MOST_REFUSED = 1000, 0.05  # draws of a covariance, and the greatest share of useless ones


@dataclass(frozen=True)
class Variation:
    """Variation between arms; by default there is none."""

    fit: bool = False  # whether the muscles' parameters are drawn from the covariances of their fits
    gains: float = 0.0  # standard deviation of each muscle's strength [-]
    lags: float = 0.0  # of the logarithm of each regulator's time constant [-]
    mass: float = 0.0  # of the logarithm of the factor of all masses [-]
    damping: float = 0.0  # of the logarithm of the damping's factor [-]
    wall_offset: float = 0.0  # of the wall's offset [m]
    wall_stiffness: float = 0.0  # of the logarithm of the wall's stiffness [-]

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput`."""
        for entry in fields(self)[1:]:
            unit = "m" if entry.name == "wall_offset" else "-"
            width = checks.number(f"Variation: {entry.name}", getattr(self, entry.name), unit)
            if not 0 <= width <= 1:
                raise InvalidInput(f"Variation: {entry.name} = {width:g} has to lie between 0 and 1, such as 0.05")
            object.__setattr__(self, entry.name, width)

    def check(self, varied: VariedArm) -> None:
        """Raise `InvalidInput` unless `fit` has covariances that can be drawn from, and a varied wall exists."""
        if varied.wall is None and (self.wall_offset or self.wall_stiffness):
            raise InvalidInput("Variation: wall_offset and wall_stiffness need a wall, and this arm meets none")
        if self.fit and all(kind.covariance is None for kind in varied.kinds):
            raise InvalidInput("Variation: fit=True, but none of the muscles was fitted: none has a covariance")
        for k, kind in enumerate(varied.kinds):
            if self.fit and kind.covariance is not None:
                drawn = _normal(kind, _LOOKED_AT, np.random.default_rng(0))
                if (without := 1 - float(_pulls(varied, k, drawn).mean())) > _MOST_REFUSED:
                    raise InvalidInput(
                        f"Variation: in {without:.0%} of draws from its covariance this {type(kind).__name__} does not "
                        "pull at full pressure: fit it to more, or other, measurements"
                    )

    def draw(self, varied: VariedArm, size: int, rng: np.random.Generator) -> Array:
        """Return rows of values (size, p) for `size` arms, see `VariedArm`."""
        v, at, m = np.tile(varied.nominal, (size, 1)), varied.places, varied.arm.m
        for k, kind in enumerate(varied.kinds):
            if self.fit and kind.covariance is not None:
                v[:, at[f"kind {k}"]] = _parameters(varied, k, size, rng)
        v[:, at["gains"]] *= np.maximum(1 + self.gains * rng.standard_normal((size, m)), 0.0)
        v[:, at["lags"]] *= np.exp(self.lags * rng.standard_normal((size, m)))
        v[:, at["mass"]] *= np.exp(self.mass * rng.standard_normal((size, 1)))
        v[:, at["damping"]] *= np.exp(self.damping * rng.standard_normal((size, 1)))
        if varied.wall is not None:
            offset, stiffness, _ = v[:, at["wall"]].T  # views
            offset += self.wall_offset * rng.standard_normal(size)
            stiffness *= np.exp(self.wall_stiffness * rng.standard_normal(size))
        return v


def _parameters(varied: VariedArm, k: int, size: int, rng: np.random.Generator) -> Array:
    """Draw the parameters (size, …) of a kind of muscle; those that do not pull at full pressure are drawn again."""
    drawn = _normal(varied.kinds[k], size, rng)
    while (lame := ~_pulls(varied, k, drawn)).any():  # rare, as ensured by `check`
        drawn[lame] = _normal(varied.kinds[k], int(lame.sum()), rng)
    return drawn


def _normal(kind: Muscle, size: int, rng: np.random.Generator) -> Array:
    mean = np.array(list(kind.parameters.values()))
    assert kind.covariance is not None
    return np.asarray(mean + rng.standard_normal((size, mean.size)) @ covariance_root(kind.covariance).T)


def _pulls(varied: VariedArm, k: int, drawn: Array) -> Mask:
    """Return which of the `drawn` parameters (size, …) pull at full pressure in the middle posture (size,)."""
    kind, mechanism = varied.kinds[k], varied.arm.mechanism
    eps = mechanism.contractions(np.zeros(mechanism.n))[[muscle == kind for muscle in mechanism.muscles]]
    muscle = kind.unchecked([column[:, None] for column in drawn.T])
    with np.errstate(all="ignore"):
        forces = np.asarray(muscle.law(mechanism.pressure_limits[1], eps))
    return np.asarray((np.isfinite(forces) & (forces > 0)).all(axis=1))


Samples: TypeAlias = NDArray[np.int64]

DYNAMICS = ("compiled", "mujoco")
_BEYOND = 0.5  # [-] of the span: observations beyond the ranges


class Batch(Protocol):
    """N simulated arms: states, values and their views."""

    varied: VariedArm
    x: Array  # (N, 2n + m)
    v: Array  # (N, p)
    q: Array  # (N, n)
    omega: Array  # (N, n)
    P: Array  # (N, m)

    def renew(self, which: Mask) -> None:
        """Apply changed states and values of the arms `which` (N,)."""

    def advance(self, u: Array, d: Array) -> None:
        """Advance all arms by a sample under the commands `u` (N, m) [Pa] and the torques `d` (N, n) [N·m]."""


Judge: TypeAlias = Callable[[Batch, Array], tuple[Array, dict[str, Array]]]
"""Function (batch, targets (N, a)) ↦ costs (N,) of the present sample, and the numbers (N,) of `info`."""


@dataclass(frozen=True)
class Task(ABC):
    """Arm, sensors and variation of a task; immutable. SI units."""

    arm: Arm = field(default_factory=lambda: Arm.machine("arm26"))
    actions: str = "pressures"  # or "posture-stiffness"
    dt: float = 0.01  # sample time [s]
    samples: int = 200  # per episode
    variation: Variation = field(default_factory=Variation)
    gas: Gas | None = None
    encoder: float = 0.02 * DEG  # step [rad]
    pressure_noise: float = 0.01 * BAR  # standard deviation [Pa]
    delay: int = 1  # [samples] from a command to the valve
    push: float = 0.5  # standard deviation of the unknown torque on every joint [N·m]
    effort: float = 0.02  # cost of all pressures at their upper limit, in the unit of the task's costs
    dynamics: str = "compiled"  # or "mujoco"

    unit: ClassVar[str]  # of the costs

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput` and `MissingBackend`."""
        checks.instance("arm", self.arm, Arm, "an Arm, such as Arm.machine('arm26')")
        for name, value, known in (("actions", self.actions, KINDS), ("dynamics", self.dynamics, DYNAMICS)):
            if value not in known:
                raise MissingBackend(name, value, known)
        checks.count("samples", self.samples, 1)
        checks.count("delay", self.delay, 0, 100)
        for name, unit in (("encoder", "rad"), ("pressure_noise", "Pa"), ("push", "N·m"), ("effort", self.unit)):
            checks.not_negative(name, getattr(self, name), unit)
        if self.arm.mechanism.angle_limits is None:
            raise InvalidInput("the mechanism has no angle_limits, which define the ranges of observations and targets")

    @property
    def varied(self) -> VariedArm:
        """Arm with variable numbers."""
        return VariedArm(self.arm, self.gas)

    @property
    def angle_range(self) -> Array:
        """Least and greatest observed angles (2, n) [rad]."""
        low, high = self.arm.angle_limits
        over = _BEYOND * (high - low)
        return np.stack([low - over, high + over])

    @property
    def seen_range(self) -> Array:
        """Least and greatest observations (2, 2n + 2m + a)."""
        low, high = np.array(self.arm.mechanism.pressure_limits) / BAR
        above = _BEYOND * (high - low)
        P = np.repeat(np.array([[low - above], [high + above]]), self.arm.m, axis=1)
        return np.concatenate([self.angle_range, self.angle_range, P, P, self.asked_range], axis=1)

    @property
    @abstractmethod
    def asked_range(self) -> Array:
        """Least and greatest targets (2, a)."""

    @abstractmethod
    def draw(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return initial postures (count, n) [rad] and goals (count, g) of new episodes."""

    @abstractmethod
    def asked(self, goal: Array, sample: Samples) -> Array:
        """Return the observed targets (N, a) at the samples (N,) of episodes with the goals (N, g)."""

    @abstractmethod
    def judge(self, size: int) -> Judge:
        """Return the costs of `size` arms. Raises `InvalidInput` if the arm cannot do the task."""


@dataclass(frozen=True)
class Reaching(Task):
    """Task, arm and sensors of reaching; immutable. SI units.

    Asked for is a posture q* (n,) [rad]. The cost of a sample is the squared error of the posture [rad²]; `info` has
    the error "error_rad".
    """

    reach: float = 0.8  # share of the angle range for targets [-]

    unit: ClassVar[str] = "rad²"

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput` and `MissingBackend`."""
        super().__post_init__()
        if not 0 < checks.number("reach", self.reach, "-") <= 1:
            raise InvalidInput(f"reach = {self.reach:g} has to be a share of the angle range, such as 0.8")

    @property
    def asked_range(self) -> Array:
        """Least and greatest observed target (2, n) [rad], those of an angle."""
        return self.angle_range

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return random postures (count, n) [rad] to begin at, and others as targets."""
        low, high = self.arm.angle_limits
        ends = (low + high) / 2 + self.reach * np.array([[-1.0], [1.0]]) * (high - low) / 2
        start, goal = (rng.uniform(ends[0], ends[1], (count, self.arm.n)) for _ in range(2))
        return start, goal

    def asked(self, goal: Array, sample: Samples) -> Array:
        """Return the target postures (N, n) [rad]."""
        return goal

    def judge(self, size: int) -> Judge:
        """Return the squared error of `size` postures [rad²] as a cost."""
        return _judged


def _judged(batch: Batch, asked: Array) -> tuple[Array, dict[str, Array]]:
    error = batch.q - asked
    square = np.add.reduce(error**2, axis=1)
    return square, {"error_rad": np.sqrt(square)}


_POINTS = 21  # of the table of postures along the wall


@dataclass(frozen=True)
class Wiping(Task):
    """Task, arm, sensors and wall of wiping; immutable. SI units.

    Asked for are the place of the hand along the wall, s* = (a + b)/2 + (b - a)/2 sin(2π t/T + φ) [m] between the ends
    a and b of the stroke, its velocity [m/s], and the force N* [N]; φ and N* are drawn for every episode. The arm
    begins at s*(0), at rest, with a clearance from the nominal wall. The cost of a sample is

        ((s - s*)² + gap²)/scale² + ((N - N*)/N_max)² [-]

    with the gap between hand and surface [m] and the greatest N*. `info` has the distance "error_m" of the hand
    from the place asked for [m], and the forces "force_N" N and "asked_N" N* [N]. Force and wall are not observed.
    """

    wall: Wall = field(default_factory=Wall)
    stroke: tuple[float, float] = (-0.05, 0.05)  # ends (a, b) [m] along the normal turned anticlockwise by 90°
    period: float = 2.0  # T of a stroke there and back [s]
    force: tuple[float, float] = (1.0, 4.0)  # least and greatest N* [N]
    clearance: float = 0.01  # [m]
    scale: float = 0.03  # distance that costs as much as the force error N_max [m]
    push: float = 0.1  # standard deviation of the unknown torque on every joint [N·m]

    unit: ClassVar[str] = "-"

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput` and `MissingBackend`."""
        super().__post_init__()
        if self.varied.hand.dim != 2:
            raise InvalidInput(
                f"wiping is along a line in a plane, with two coordinates of the hand, not {self.varied.hand.text}"
            )
        for name, unit in (("stroke", "m"), ("force", "N")):
            low, high = checks.limits(name, getattr(self, name), unit)
            if not low < high or (name == "force" and low <= 0):
                raise InvalidInput(
                    f"{name} = ({low:g}, {high:g}) {unit} has to be a range, such as {getattr(Wiping, name)}"
                )
            object.__setattr__(self, name, (low, high))
        for name, unit in (("period", "s"), ("scale", "m")):
            checks.positive(name, getattr(self, name), unit)
        checks.not_negative("clearance", self.clearance, "m")

    @cached_property
    def varied(self) -> VariedArm:
        """Arm with variable numbers, at the wall."""
        return VariedArm(self.arm, self.gas, self.wall)

    @property
    def axes(self) -> Array:
        """Unit vectors (2, 2) into the wall and along it."""
        x, y = self.wall.normal
        return np.array([[x, y], [-y, x]])

    def postures(self, depth: float, along: Array) -> Array:
        """Return postures (k, n) [rad] with the hand at the places `along` (k,) the wall and `depth` [m] behind it.

        Raises `InvalidInput` if the hand does not reach them.
        """
        places = np.stack([np.full(along.size, self.wall.offset + depth), along], axis=1) @ self.axes
        try:
            return followed(self.arm, self.varied.hand, places)
        except OutOfReach as beyond:
            raise InvalidInput(f"the stroke along the wall: {beyond}") from None

    @cached_property
    def _beginnings(self) -> tuple[Array, Array]:
        """Places along the wall (k,) [m], and postures (k, n) [rad] before it."""
        along = np.linspace(*self.stroke, _POINTS)
        return along, self.postures(-self.clearance, along)

    @property
    def asked_range(self) -> Array:
        """Least and greatest of (s*, s*', N*) (2, 3) [m], [m/s], [N]."""
        (a, b), fastest = self.stroke, np.pi * (self.stroke[1] - self.stroke[0]) / self.period
        return np.array([[a, -fastest, 0.0], [b, fastest, self.force[1]]])

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return postures (count, n) [rad] before the wall, and random goals (φ, N*) (count, 2) [rad], [N]."""
        goal = rng.uniform([-np.pi, self.force[0]], [np.pi, self.force[1]], (count, 2))
        begin, (along, postures) = self.asked(goal, np.zeros(count, np.int64))[:, 0], self._beginnings
        return np.stack([np.interp(begin, along, q) for q in postures.T], axis=1), goal

    def asked(self, goal: Array, sample: Samples) -> Array:
        """Return (s*, s*', N*) (N, 3) [m], [m/s], [N]."""
        (a, b), rate, asked = self.stroke, 2 * np.pi / self.period, np.empty((len(goal), 3))
        phase = rate * self.dt * sample + goal[:, 0]
        asked[:, 0] = (a + b) / 2 + (b - a) / 2 * np.sin(phase)
        asked[:, 1] = (b - a) / 2 * rate * np.cos(phase)
        asked[:, 2] = goal[:, 1]
        return asked

    def judge(self, size: int) -> Judge:
        """Return the costs of `size` arms. Raises `InvalidInput` if the hand does not reach the stroke."""
        _ = self._beginnings
        touch, axes, surface = Touch(self.varied, size), self.axes.T, self.varied.places["wall"].start

        def judged(batch: Batch, asked: Array) -> tuple[Array, dict[str, Array]]:
            x, force, _ = touch(batch.q, batch.omega, batch.v)
            across, along = (x @ axes).T
            gap, wanted = np.maximum(batch.v[:, surface] - across, 0.0), asked[:, 2]
            square = (along - asked[:, 0]) ** 2 + gap**2
            cost = square / self.scale**2 + ((force - wanted) / self.force[1]) ** 2
            return cost, {"error_m": np.sqrt(square), "force_N": force, "asked_N": wanted}

        return judged
