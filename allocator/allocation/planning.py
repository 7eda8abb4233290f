"""Pressures are planned here for a whole trajectory, where several pairs give the same torque and stiffness.

Chosen one sample at a time, as the least or as the nearest to the last, a sheet of pairs may end at a limit, and the
pressures have to jump to another one. Dynamic programming over the pairs of all samples jumps only where it must.
"""

import numpy as np

from allocator import search
from allocator.allocation import exact
from allocator.allocation.problem import Problem
from allocator.calculus import Array, Mask
from allocator.joint.torque_levels import Pair


def planned(problem: Problem, P1: Array, P2: Array, met: Mask, shape: tuple[int, ...], axis: int) -> Pair:
    """Return the pairs that give what (P1, P2) give, with the least sum of squared steps along an axis of `shape`.

    Where the targets are not `met` the pressures stay as they are: what misses as little as possible is one pair.
    """
    found = _candidates(problem, P1, P2, met)  # (n, m, 2)
    if not P1.size:
        return P1, P2
    steps = np.moveaxis(found.reshape(*shape, *found.shape[1:]), axis, 0)
    chosen = _least_steps(steps.reshape(shape[axis], -1, *found.shape[1:]))
    back = np.moveaxis(chosen.reshape(*steps.shape[:-2], 2), 0, axis).reshape(-1, 2)
    return back[:, 0], back[:, 1]


def _candidates(problem: Problem, P1: Array, P2: Array, met: Mask) -> Array:
    """Return all pairs of each sample (n, m, 2) [Pa]: the first is (P1, P2), NaN where there are fewer than m."""
    several = met & (exact.determinant_signs(problem) == 0)
    first = np.stack([P1, P2], 1)[:, None]
    if not several.any():
        return first
    part = problem.take(several)
    _, others = search.all_pairs(part.curves, part.T_aim, part.K_aim)
    listed = np.full((P1.size, others.shape[1], 2), np.nan)
    listed[several] = others
    return np.concatenate([first, listed], axis=1)


def _least_steps(pairs: Array) -> Array:
    """Return the path through one pair a step with the least sum of squared steps, (steps, k, m, 2) → (steps, k, 2)."""
    steps, k, m, _ = pairs.shape
    came_from = np.zeros((steps, k, m), np.intp)
    cost = np.where(np.isnan(pairs[0, :, :, 0]), np.inf, 0.0)  # (k, m)
    for s in range(1, steps):
        jump = ((pairs[s, :, None] - pairs[s - 1, :, :, None]) ** 2).sum(axis=3)  # (k, from, to)
        total = cost[:, :, None] + np.where(np.isnan(jump), np.inf, jump)
        came_from[s] = total.argmin(axis=1)
        cost = total.min(axis=1)
    at, path, each = cost.argmin(axis=1), np.empty((steps, k, 2)), np.arange(k)
    for s in range(steps - 1, -1, -1):
        path[s] = pairs[s, each, at]
        at = came_from[s, each, at]
    return path
