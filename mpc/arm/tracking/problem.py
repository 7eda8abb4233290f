"""The tracking problem of an arm is that of a joint, with the sizes and weights of n joints and m muscles."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from mpc.arm.model import Arm
from mpc.arm.tracking.limits import ArmLimits
from mpc.arm.tracking.terminal import arm_terminal_factor
from mpc.tracking.cost import Rows, diagonal, residuals
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.weights import Weights


@dataclass(frozen=True)
class ArmProblem(TrackingProblem):
    """An arm's problem is a `TrackingProblem`: for (4) read 2n + m, for (6) 2n + 2m, for 2 commands m."""

    joints: int = 1  # n
    stiffnesses: int = 1  # entries of svec K

    @classmethod
    def of(cls, arm: Arm, dt: float, weights: Weights, limits: ArmLimits, blocks: Sequence[int]) -> "ArmProblem":
        """Return the problem of `arm` at the sample time `dt` [s]."""
        L = arm_terminal_factor(arm, dt, weights, _rows(weights, arm.n, arm.m, arm.stiffnesses))
        return cls(weights, limits, L, tuple(blocks), dt, arm.m, arm.n, arm.stiffnesses)

    @cached_property
    def rows(self) -> Rows:
        """The rows are the weights of the stage cost by kinds of rows."""
        return _rows(self.weights, self.joints, self.muscles, self.stiffnesses)


def _rows(weights: Weights, n: int, m: int, stiffnesses: int) -> Rows:
    return diagonal(weights, residuals(n, m, stiffnesses), Rows(2 * n + m, stiffnesses + m, m, m))
