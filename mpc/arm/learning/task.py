"""Tasks of arms that learn: an arm with the sensors of a test rig, and the goals and costs of its episodes.

Observations are the encoders now and one sample before, the pressure sensors, the last commands and the task's targets:
(q, q before, P, u, targets) (blocks of n, m or a numbers), angles in rad, pressures in bar. Velocities and parameters
of the arm are not observed. Rewards are minus the costs of the task and of the pressures.

`Reaching`: an arm has to hold a posture under unknown torques.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.gas import Gas
from allocator.units import BAR, DEG
from mpc.arm.learning.actions import KINDS
from mpc.arm.learning.plant import VariedArm
from mpc.arm.learning.variation import Variation
from mpc.model.arm.model import Arm

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
