"""A `Setting` is a joint with what is asked of its forces and pressures, which is held at angles and torques.

At one angle and one torque the pairs of pressures that exist form a piece of a torque level
(`allocator.joint.torque_levels`), and their stiffnesses an interval. This is a *column* of the feasible set; everything
in this package is made of columns.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from allocator.allocation import exact, reach
from allocator.allocation.arguments import problem_from
from allocator.allocation.problem import Problem
from allocator.allocation.tolerances import CLOSED_FORM
from allocator.calculus import Array, Mask, Value
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.limits import TAUT, Limits
from allocator.joint.torque_levels import Pair, stiffness, torque_interval

_NO_TARGET = 1.0  # [N·m/rad] stands for the stiffness where none is asked for


class Columns(NamedTuple):
    """`Columns` are the feasible stiffnesses at n angles and torques, each array (n,)."""

    problem: Problem
    low: Pair  # pressures of the least stiffness [Pa]
    high: Pair  # and of the greatest
    K_min: Array  # [N·m/rad]
    K_max: Array
    reach: Array  # how far the torque is inside its interval, as a fraction of the torque scale; negative outside
    signs: Array  # of the determinant, see `exact.determinant_signs`: where not 0 one pair gives each stiffness

    @property
    def exists(self) -> Mask:
        """Return where there are allowed pressures that give the torque."""
        return np.asarray((self.reach >= -CLOSED_FORM.met) & ~self.problem.box.empty)


@dataclass(frozen=True)
class Setting:
    """A `Setting` is a joint and the limits asked for beyond its supply and its angles, without a slew limit."""

    joint: AntagonistJoint
    limits: Limits = TAUT

    @classmethod
    def of(
        cls,
        joint: AntagonistJoint | None,
        min_force: float | None = 0.0,
        max_force: float | None = None,
        min_cocontraction: float | None = None,
    ) -> Self:
        """Take the arguments of `allocate` of these names, and the report's joint where none is given."""
        return cls(report_joint() if joint is None else joint, Limits(min_force, max_force, min_cocontraction))

    def problem(self, theta: Value, T: Value = 0.0, K: Value = _NO_TARGET) -> tuple[Problem, Array]:
        """Return the checked, flat problems (angles moved into the joint range), and the angles asked for."""
        return problem_from(self.joint, theta, K, T, limits=self.limits)

    def columns(self, theta: Value, T: Value) -> Columns:
        """Return the columns at angles in the joint range, and at torques brought within reach."""
        problem, _ = self.problem(theta, T)
        return columns(problem)


def columns(problem: Problem, signs: Array | None = None) -> Columns:
    """Return the ends of the stiffnesses with what they mean, by the determinant's `signs` if these are known."""
    T_min, T_max = torque_interval(problem.sides, problem.box)
    scale = problem.scales[0]
    T = np.clip(problem.T, T_min, T_max)
    signs = exact.determinant_signs(problem) if signs is None else signs
    low, high = (_inside(problem, pair) for pair in reach.stiffness_ends(problem, T, signs))
    return Columns(
        problem,
        low,
        high,
        stiffness(problem.sides, low),
        stiffness(problem.sides, high),
        np.minimum(problem.T - T_min, T_max - problem.T) / scale,
        signs,
    )


def _inside(problem: Problem, pair: Pair) -> Pair:
    """Return the pressures, within the box: where it is empty a muscle may have none for the torque (infinity)."""
    P1, P2 = (np.clip(P, side.lo, side.hi) for P, side in zip(pair, problem.box, strict=True))
    return P1, P2


__all__ = ["Columns", "Setting", "columns"]
