"""How far an answer is from the proved bound of the exact method, whichever method gave it."""

import numpy as np

from allocator.allocation import exact
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput

_MET = 1e-9  # of the scale: a first goal that is missed by no more than it has to be


def gap(problem: Problem, P1: Array, P2: Array) -> Array:
    """`Allocation.gap` of the pressures (n,); NaN where the exact method has no answer."""
    try:
        best = exact.solve(problem)
    except InvalidInput:  # a pull without a closed form
        return np.full(P1.shape, np.nan)
    costs = [exact.ranking(problem, *pair)[:2] for pair in ((P1, P2), (best.P1, best.P2))]
    if problem.priority != "weighted":  # the second cost is a square
        costs = [(first, np.sqrt(second)) for first, second in costs]
    (first, second), (least_first, least_second) = costs
    first_worse = (first - least_first) / exact.gap_units(problem)[0]
    second_worse = (second - least_second) / exact.gap_units(problem)[1]
    return np.asarray(np.maximum(np.where(first_worse > _MET, first_worse, second_worse), 0.0) + best.gap)


__all__ = ["gap"]
