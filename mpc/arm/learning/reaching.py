"""Reaching task: an arm has to hold a posture under unknown torques."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.arm.learning.task import Batch, Judge, Samples, Task


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
