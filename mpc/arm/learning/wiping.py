"""Wiping task: a hand has to slide along a wall and to press on it with a force, both of which it does not sense."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.arm.learning.plant import Touch, VariedArm, Wall
from mpc.arm.learning.task import Batch, Judge, Samples, Task
from mpc.model.arm.ranges import OutOfReach, followed

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
