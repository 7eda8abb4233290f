"""A joint together with what is asked of its muscle forces and pressures, held at angles and torques.

At one angle and one torque the pairs of pressures that exist form a piece of a torque level
(`allocator.joint.torque_levels`), and their stiffnesses an interval. This is a *column* of the feasible set; everything
in this package is made of columns.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator.allocation import exact, reach
from allocator.allocation.arguments import problem_from
from allocator.allocation.problem import Problem
from allocator.calculus import Array, Mask, Value
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.torque_levels import Pair, stiffness, torque_interval

_NO_TARGET = 1.0  # [N·m/rad] stands for the stiffness where none is asked for
_REACHED = 1e-9  # of the torque scale: a torque missed by less is reached, as in `allocate`


class Columns(NamedTuple):
    """The feasible stiffnesses at n angles and torques, each array (n,)."""

    problem: Problem
    low: Pair  # pressures of the least stiffness [Pa]
    high: Pair  # and of the greatest
    K_min: Array  # [N·m/rad]
    K_max: Array
    reach: Array  # how far the torque is inside its interval, as a fraction of the torque scale; negative outside
    signs: Array  # of the determinant, see `exact.determinant_signs`: where not 0 one pair gives each stiffness

    @property
    def exists(self) -> Mask:
        """Where there are allowed pressures that give the torque."""
        return np.asarray((self.reach >= -_REACHED) & ~self.problem.box.empty)


@dataclass(frozen=True)
class Setting:
    """A joint and the limits beyond its supply and its angles, as the arguments of `allocate` of these names."""

    joint: AntagonistJoint
    min_force: float | None = 0.0  # [N]
    max_force: float | None = None  # [N]
    min_cocontraction: float | None = None  # [Pa]

    @classmethod
    def of(cls, joint: AntagonistJoint | None, *limits: float | None) -> Self:
        """With the report's joint where none is given."""
        return cls(report_joint() if joint is None else joint, *limits)

    def problem(self, theta: Value, T: Value = 0.0, K: Value = _NO_TARGET) -> tuple[Problem, Array]:
        """The checked, flat allocation problems (angles moved into the joint range), and the angles asked for."""
        return problem_from(
            self.joint,
            theta,
            K,
            T,
            priority="torque",
            weights=None,
            min_force=self.min_force,
            max_force=self.max_force,
            min_cocontraction=self.min_cocontraction,
            stiffness_tolerance=0.0,
            pull=0.0,
            reference=None,
            previous=None,
            max_step=None,
        )

    def columns(self, theta: Value, T: Value) -> Columns:
        """The columns at angles in the joint range; where a torque is out of reach, at the nearest one in reach."""
        problem, _ = self.problem(theta, T)
        return columns(problem)


def columns(problem: Problem, signs: Array | None = None) -> Columns:
    """The ends of the stiffnesses, with what they mean; the determinant's signs if known (they depend on the angle)."""
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
    """The pressures, within the box: where it is empty a muscle may have none for the torque (infinity)."""
    P1, P2 = (np.clip(P, side.lo, side.hi) for P, side in zip(pair, problem.box, strict=True))
    return P1, P2


def outside_range(joint: AntagonistJoint, theta: Array) -> NDArray[np.int32]:
    """The Limit flag that ends the joint range where `theta` lies beyond it, else 0."""
    left, right = joint.angle_range
    below, above = (np.int32(joint.angle_limit(upper)) for upper in (False, True))
    return np.where(theta < left, below, np.where(theta > right, above, np.int32(0)))


__all__ = ["Columns", "Setting", "columns", "outside_range"]
