"""How far an answer is from the proved bound of the exact method, whichever method gave it."""

import numpy as np

from allocator.allocation import exact
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput

_MET = 1e-9  # of the scale: a first goal that is missed by no more than it has to be


def gap(problem: Problem, P1: Array, P2: Array) -> Array:
    """`Allocation.gap` of the pressures (n,); NaN where the exact method has no answer or no proof."""
    try:
        best = exact.solve(problem)
    except InvalidInput:  # a pull without a closed form
        return np.full(P1.shape, np.nan)
    worse = [costs - least for costs, least in zip(_costs(problem, P1, P2), _costs(problem, *best[:2]), strict=True)]
    units = _units(problem)
    first, second = (excess / unit for excess, unit in zip(worse, units, strict=True))
    return np.asarray(np.maximum(np.where(first > _MET, first, second), 0.0) + best.gap)


def _costs(problem: Problem, P1: Array, P2: Array) -> tuple[Array, Array]:
    """The first and the second goal missed; the weighted cost twice."""
    e_T, e_K = problem.errors(P1, P2)
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        cost = w_T * e_T**2 + w_K * e_K**2 + problem.pull_cost(P1, P2)
        return cost, cost
    return (np.abs(e_T), np.abs(e_K)) if problem.priority == "torque" else (np.abs(e_K), np.abs(e_T))


def _units(problem: Problem) -> tuple[Array, Array]:
    T_scale, K_scale = problem.scales
    second = exact.gap_unit(problem)
    return {"torque": T_scale, "stiffness": K_scale, "weighted": second}[problem.priority], second


__all__ = ["gap"]
