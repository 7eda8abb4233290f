"""What can be had in a box of pressures at an angle: stiffnesses at a torque, torques at a stiffness.

At a torque the stiffnesses are one interval, as the torque level is connected. At a stiffness the torques are a union
of intervals, of up to three in all that was tried: the stiffness may turn, and its level fall apart.
"""

import numpy as np
from numpy.typing import NDArray

from allocator import search
from allocator.allocation import curved, exact
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.levels import Pair, stiffness, torque_interval, torque_level


def stiffness_ends(problem: Problem, T: Array, signs: Array | None = None) -> tuple[Pair, Pair]:
    """The pressures of the least and of the greatest stiffness at the torques T (n,) [N·m]; NaN out of reach.

    These are the ends of the torque level where the determinant keeps its sign, which `signs` are if they are known.
    """
    signs = exact.determinant_signs(problem) if signs is None else signs
    level = torque_level(problem.sides, problem.box, T)
    falls = signs < 0
    low, high = (
        (np.where(falls, b[0], a[0]), np.where(falls, b[1], a[1]))
        for a, b in ((level.low, level.high), (level.high, level.low))
    )
    where = (signs == 0) & np.isfinite(level.low[0])
    if where.any() and not problem.joint.affine:
        for pair, found in zip((low, high), curved.stiffness_extremes(problem.take(where), T[where]), strict=True):
            pair[0][where], pair[1][where] = found
    return low, high


def stiffness_interval(problem: Problem, T: Array) -> Pair:
    """[K_min, K_max] [N·m/rad] at the torques T (n,), which are brought within reach; NaN for NaN."""
    T_min, T_max = torque_interval(problem.sides, problem.box)
    low, high = stiffness_ends(problem, np.clip(T, T_min, T_max))
    return stiffness(problem.sides, low), stiffness(problem.sides, high)


def torque_intervals(problem: Problem, K: Array) -> Array:
    """The intervals of torques at the stiffnesses K (n,), brought within reach: (n, m, 2) [N·m], NaN where fewer."""
    return search.torque_intervals(curved.curves(problem), K)[1]


def pairs(problem: Problem, T: Array, K: Array) -> NDArray[np.intp]:
    """How many pairs of pressures within the limits give these torques and stiffnesses (n,)."""
    count = np.ones(T.shape, np.intp)
    several = exact.determinant_signs(problem) == 0
    if several.any():
        count[several] = curved.all_pairs(problem.take(several), T[several], K[several])[0]
    return np.maximum(count, 1)


__all__ = ["pairs", "stiffness_ends", "stiffness_interval", "torque_intervals"]
