"""The ordinary question to `allocate`, as it was asked: what the compiled kernels answer."""

from typing import Any, NamedTuple

from allocator.allocation.arguments import problem_from
from allocator.allocation.problem import Problem
from allocator.joint import AntagonistJoint


class Question(NamedTuple):
    """The arguments of `allocate` of these names, unchecked; method "exact", everything else as by default."""

    joint: AntagonistJoint
    theta: Any
    K: Any
    T: Any
    priority: Any
    min_force: Any
    max_force: Any
    previous: Any
    max_step: Any

    def problem(self) -> Problem:
        """The same as a checked, flat problem."""
        problem, _ = problem_from(
            self.joint,
            self.theta,
            self.K,
            self.T,
            priority=self.priority,
            weights=None,
            min_force=self.min_force,
            max_force=self.max_force,
            min_cocontraction=None,
            stiffness_tolerance=0.0,
            pull=0.0,
            reference=None,
            previous=self.previous,
            max_step=self.max_step,
        )
        return problem


__all__ = ["Question"]
