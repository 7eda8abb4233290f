"""Test set: a mix of targets that are feasible, infeasible, at slack limits and beyond the joint range."""

from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator import AntagonistJoint, report_joint
from allocator.units import BAR

Array = NDArray[np.float64]


class Answers(NamedTuple):
    """Arrays (n,) to be filled."""

    P1: Array  # [Pa]
    P2: Array
    T: Array  # achieved [N·m]
    K: Array  # achieved [N·m/rad]
    status: NDArray[np.int8]
    limits: NDArray[np.int32]

    @classmethod
    def empty(cls, n: int) -> Self:
        """Return empty arrays."""
        return cls(*(np.empty(n) for _ in range(4)), np.empty(n, np.int8), np.empty(n, np.int32))


class Targets:
    """n targets of one joint."""

    def __init__(self, n: int, seed: int = 0, joint: AntagonistJoint | None = None) -> None:
        rng, self.n = np.random.default_rng(seed), n
        self.joint = report_joint() if joint is None else joint
        left, right = self.joint.angle_range
        self.theta = rng.uniform(1.1 * left, 1.1 * right, n)  # [rad], a tenth beyond the range
        at = np.clip(self.theta, left, right)
        P1, P2 = rng.uniform(0, 5.6 * BAR, (2, n))  # slack, allowed, and above the supply
        self.K, self.T = np.maximum(self.joint.stiffness(at, P1, P2), 0.1), self.joint.torque(at, P1, P2)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """θ [rad], K [N·m/rad], T [N·m]."""
        return self.theta, self.K, self.T

    @cached_property
    def rows(self) -> list[tuple[float, float, float]]:
        """The same, target by target."""
        return list(zip(*(x.tolist() for x in self.arrays), strict=True))
