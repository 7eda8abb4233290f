"""Reach of a box of pressures at an angle: stiffnesses at a torque, torques at a stiffness.

At a torque the stiffnesses are one interval, as the torque level is connected. At a stiffness the torques are a union
of intervals (at most three in all cases tried), since the stiffness may turn and its level be disconnected.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator import search
from allocator.allocation.two_muscles import exact, felt
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array, Mask
from allocator.joint.torque_levels import Pair, torque, torque_interval, torque_level

_SAME = 1e-9  # of the supply range, or of the scale of torque: closer pairs or intervals are one
_FAR = 1e3  # times the capacity: the nearest value to it is the extreme


def stiffness_ends(problem: Problem, T: Array) -> tuple[Pair, Pair]:
    """Return the pressures of the least and of the greatest stiffness at the torques T (n,) [N·m]; NaN out of reach.

    These are the ends of the torque level if the determinant keeps its sign.
    """
    if problem.felt is not None:
        return _extremes(replace(problem, priority="torque", T=T), "K", _FAR * problem.scales[1])
    signs = exact.determinant_signs(problem)
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


def _extremes(asked: Problem, second: str, far: Array) -> tuple[Pair, Pair]:
    """Return the pressures of both extremes of the `second` goal, "K" or "T", for a felt stiffness."""
    targets: list[dict[str, Any]] = [{second: -far}, {second: far}]
    low, high = (exact.solve(replace(asked, stiffness_tolerance=0.0, **target)) for target in targets)
    return (low.P1, low.P2), (high.P1, high.P2)


def _inside(problem: Problem, pair: Pair) -> Pair:
    """Return the pressures clipped to the box: if it is empty, a muscle may have none for the torque (infinity)."""
    P1, P2 = (np.clip(P, side.lo, side.hi) for P, side in zip(pair, problem.box, strict=True))
    return P1, P2


def stiffness_range(problem: Problem) -> tuple[Pair, Pair]:
    """Return the pressures of the least and of the greatest stiffness at any torque."""
    if problem.felt is not None:
        return _extremes(replace(problem, priority="stiffness"), "K", _FAR * problem.scales[1])
    far = _FAR * problem.scales[1]
    (low1, low2, _), (high1, high2, _) = (search.optima(problem.curves, problem.T, K, "stiffness") for K in (-far, far))
    return (low1, low2), (high1, high2)


def torque_ends(problem: Problem, K: Array) -> tuple[Pair, Pair]:
    """Return the pressures of the least and of the greatest torque at the stiffnesses K (n,), brought within reach."""
    if problem.felt is not None:
        return _extremes(replace(problem, priority="stiffness", K=K), "T", _FAR * problem.scales[0])
    far, K = _FAR * problem.scales[0], problem.of_muscles(K)
    (low1, low2, _), (high1, high2, _) = (search.optima(problem.curves, T, K, "stiffness") for T in (-far, far))
    return (low1, low2), (high1, high2)


def stiffness_interval(problem: Problem, T: Array) -> Pair:
    """Return [K_min, K_max] [N·m/rad] at the torques T (n,), which are brought within reach; NaN for NaN."""
    T_min, T_max = torque_interval(problem.sides, problem.box)
    low, high = stiffness_ends(problem, np.clip(T, T_min, T_max))
    return problem.stiffness(*low), problem.stiffness(*high)


def torque_intervals(problem: Problem, K: Array) -> Array:
    """Return the intervals of torques at the stiffnesses K (n,), clipped to their range: (n, m, 2) [N·m] or NaN."""
    if problem.felt is not None:
        return _felt_torque_intervals(problem, K)
    return search.torque_intervals(problem.curves, problem.of_muscles(K))[1]


def _felt_torque_intervals(problem: Problem, K: Array) -> Array:
    """Return the same for a felt stiffness: between neighbouring turns either all torques have pairs or none."""
    ends = torque_ends(problem, K)
    K = np.clip(K, *(problem.stiffness(*pair) for pair in stiffness_range(problem)))
    turns = np.sort(
        np.vstack([felt.turning_torques(problem, K), [torque(problem.sides, pair) for pair in ends]]), axis=0
    )
    between = [~np.isnan(felt.levels(problem, (a + b) / 2, K)[..., 0]).all(axis=0)
               for a, b in pairwise(turns)]  # fmt: skip
    found = [_joined(row, there, _SAME * scale)
             for row, there, scale in zip(turns.T, np.array(between).T, problem.scales[0], strict=True)]  # fmt: skip
    out = np.full((len(found), max(map(len, found), default=0), 2), np.nan)
    for i, intervals in enumerate(found):
        out[i, : len(intervals)] = intervals
    return out


def _joined(turns: Array, there: Mask, near: float) -> list[tuple[float, float]]:
    """Return the intervals between turns that have pairs, and isolated torques."""
    joined: list[tuple[float, float]] = []
    for k, a in enumerate(turns[~np.isnan(turns)].tolist()):
        b = float(turns[k + 1]) if k < there.size and there[k] else a
        if joined and a <= joined[-1][1] + near:
            joined[-1] = (joined[-1][0], max(joined[-1][1], b))
        else:
            joined.append((a, b))
    return joined


def pairs(problem: Problem, T: Array, K: Array) -> NDArray[np.intp]:
    """Return the number of pairs of pressures within the limits with these torques and stiffnesses (n,)."""
    if problem.felt is not None:
        return _distinct(felt.levels(problem, T, K) / problem.joint.pressure_span)
    count = np.ones(T.shape, np.intp)
    several = exact.determinant_signs(problem) == 0
    if several.any():
        count[several], _ = search.all_pairs(problem.take(several).curves, T[several], problem.of_muscles(K[several]))
    return np.maximum(count, 1)


def _distinct(found: Array) -> NDArray[np.intp]:
    """Return the number of distinct pairs (m, n, 2), at least 1."""
    order = np.sort(found[..., 0], axis=0)  # along a torque level both pressures rise; NaN last
    new = np.diff(order, axis=0) > _SAME
    return np.asarray(1 + new.sum(axis=0), np.intp)
