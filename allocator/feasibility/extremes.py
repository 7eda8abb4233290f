"""`lowest` finds the least value of a function on an interval, among pieces."""

from collections.abc import Callable

import numpy as np

from allocator.calculus import Array

_PIECES = 64  # a fall and its way back within one of them are missed


def lowest(f: Callable[..., Array], start: Array, end: Array, *args: Array, pieces: int = _PIECES) -> Array:
    """Return the x (n,) in [start, end] with the least f(x, *args), found among `pieces` and then refined."""
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
