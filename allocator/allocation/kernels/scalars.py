"""The ordinary question to `allocate`, as it was asked: what the compiled kernels answer."""

from math import nan
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.arguments import problem_from
from allocator.allocation.problem import Problem
from allocator.joint.antagonist import AntagonistJoint

REAL = frozenset((int, float, *(np.dtype(code).type for code in np.typecodes["AllInteger"] + np.typecodes["Float"])))
"""The types of real numbers: Python's and NumPy's, truth values not among them."""
_SEQUENCES = frozenset((tuple, list, np.ndarray))


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


def number(x: Any) -> float:
    """`x` as a float where it is one real number of Python's or NumPy's, a 0-d array included; else NaN.

    No range includes NaN, so that whoever looks whether a number lies in its range need not look at its type as well.
    """
    if type(x) is float:
        return x
    kind = type(x)
    if kind in REAL or (kind is np.ndarray and not x.ndim and x.dtype.type in REAL):
        try:
            return float(x)
        except OverflowError:  # an integer of more than 308 digits
            return nan
    return nan


def pair(x: Any) -> tuple[Any, Any]:
    """Both pressures in a tuple, list or array of two; NaN for what is none."""
    if type(x) not in _SEQUENCES:
        return nan, nan
    try:
        P1, P2 = x
    except (TypeError, ValueError):  # of no length, of another length
        return nan, nan
    return P1, P2


__all__ = ["REAL", "Question", "number", "pair"]
