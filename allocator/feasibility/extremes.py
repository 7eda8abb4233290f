"""Least and greatest stiffness on a torque level along which it is not known to grow.

Where the determinant of the Jacobian is positive these are the ends of the level. Some poor models on a lever turn:
there the level is searched.
"""

from collections.abc import Callable

import numpy as np

from allocator.allocation.problem import Problem
from allocator.calculus import Array, Mask
from allocator.levels import Pair, stiffness

_PIECES = 64  # of a level; a turn and its way back within one of them are missed


def extremes_on_level(problem: Problem, T: Array, low: Pair, high: Pair, where: Mask) -> tuple[Pair, Pair]:
    """The ends `low` and `high` (n,) of the levels T (n,), replaced `where` a point between them goes further."""
    part = problem.take(where)
    start, end = low[0][where], high[0][where]
    least = _least(part, T[where], start, end, +1)
    greatest = _least(part, T[where], start, end, -1)
    return _merged(low, least, where), _merged(high, greatest, where)


def _least(problem: Problem, T: Array, start: Array, end: Array, sign: int) -> Pair:
    """The pressures between P1 = start and end (n,) on the level with the least sign·K."""
    agonist, antagonist = problem.sides

    def cost(P1: Array, *a: Array) -> Array:
        one, two = agonist.moved(*a[:3]), antagonist.moved(*a[3:6])
        return sign * stiffness((one, two), (P1, two.pressure_for_torque(a[6] - one.torque(P1))))

    varying = np.broadcast_arrays(*agonist.arrays, *antagonist.arrays, T)
    P1 = lowest(cost, start, end, *varying)
    return P1, np.asarray(antagonist.pressure_for_torque(T - agonist.torque(P1)))


def lowest(f: Callable[..., Array], start: Array, end: Array, *args: Array, pieces: int = _PIECES) -> Array:
    """The x (n,) in [start, end] with the least f(x, *args), found among `pieces` and then refined."""
    from scipy.optimize import elementwise

    grid = start + (end - start) * np.linspace(0, 1, pieces + 1)[:, None]
    values = f(grid, *args)
    i = np.argmin(values, axis=0)
    x = np.take_along_axis(grid, i[None], 0)[0]
    between = (i > 0) & (i < pieces) & (end > start)
    if between.any():
        column = np.nonzero(between)[0]
        bracket = tuple(grid[i[between] + shift, column] for shift in (-1, 0, 1))
        found = elementwise.find_minimum(f, bracket, args=tuple(a[between] for a in args))
        x[between] = found.x
    return np.asarray(x)


def _merged(old: Pair, new: Pair, where: Mask) -> Pair:
    merged = old[0].copy(), old[1].copy()
    for target, source in zip(merged, new, strict=True):
        target[where] = source
    return merged


__all__ = ["extremes_on_level", "lowest"]
