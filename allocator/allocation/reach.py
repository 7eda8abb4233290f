"""What a box of pressures can give at an angle is found here: stiffnesses at a torque, torques at a stiffness.

At a torque the stiffnesses are one interval, as the torque level is connected. At a stiffness the torques are a union
of intervals, of up to three in all that was tried: the stiffness may turn, and its level fall apart.
"""

import numpy as np
from numpy.typing import NDArray

from allocator import search
from allocator.allocation import exact
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.joint.torque_levels import Pair, stiffness, torque_interval, torque_level

_FAR = 1e3  # times all that there is: what is nearest to that is the extreme


def stiffness_ends(problem: Problem, T: Array, signs: Array | None = None) -> tuple[Pair, Pair]:
    """Return the pressures of the least and of the greatest stiffness at the torques T (n,) [N·m]; NaN out of reach.

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
        part = problem.take(where)
        far = _FAR * part.scales[1]
        for pair, K in zip((low, high), (-far, far), strict=True):
            pair[0][where], pair[1][where], _ = search.optima(part.curves, T[where], K, "torque")
    return _inside(problem, low), _inside(problem, high)


def _inside(problem: Problem, pair: Pair) -> Pair:
    """Return the pressures, within the box: where it is empty a muscle may have none for the torque (infinity)."""
    P1, P2 = (np.clip(P, side.lo, side.hi) for P, side in zip(pair, problem.box, strict=True))
    return P1, P2


def stiffness_range(problem: Problem) -> tuple[Pair, Pair]:
    """Return the pressures of the least and of the greatest stiffness at any torque."""
    far = _FAR * problem.scales[1]
    (low1, low2, _), (high1, high2, _) = (search.optima(problem.curves, problem.T, K, "stiffness") for K in (-far, far))
    return (low1, low2), (high1, high2)


def torque_ends(problem: Problem, K: Array) -> tuple[Pair, Pair]:
    """Return the pressures of the least and of the greatest torque at the stiffnesses K (n,), brought within reach."""
    far = _FAR * problem.scales[0]
    (low1, low2, _), (high1, high2, _) = (search.optima(problem.curves, T, K, "stiffness") for T in (-far, far))
    return (low1, low2), (high1, high2)


def stiffness_interval(problem: Problem, T: Array) -> Pair:
    """Return [K_min, K_max] [N·m/rad] at the torques T (n,), which are brought within reach; NaN for NaN."""
    T_min, T_max = torque_interval(problem.sides, problem.box)
    low, high = stiffness_ends(problem, np.clip(T, T_min, T_max))
    return stiffness(problem.sides, low), stiffness(problem.sides, high)


def torque_intervals(problem: Problem, K: Array) -> Array:
    """Return the intervals of torques at the stiffnesses K (n,), brought within reach: (n, m, 2) [N·m] or NaN."""
    return search.torque_intervals(problem.curves, K)[1]


def pairs(problem: Problem, T: Array, K: Array) -> NDArray[np.intp]:
    """Return how many pairs of pressures within the limits give these torques and stiffnesses (n,)."""
    count = np.ones(T.shape, np.intp)
    several = exact.determinant_signs(problem) == 0
    if several.any():
        count[several], _ = search.all_pairs(problem.take(several).curves, T[several], K[several])
    return np.maximum(count, 1)
