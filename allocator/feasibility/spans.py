"""Least values of functions of the joint angle, and the intervals on which such functions are not negative."""

from collections.abc import Callable

import numpy as np

from allocator.calculus import Array, Mask, increasing_root

PIECES = 128


def lowest(f: Callable[..., Array], start: Array, end: Array, *args: Array, pieces: int) -> Array:
    """Return the x (n,) in [start, end] with the least f(x, *args), found among `pieces` and then refined.

    A fall and its way back within one piece are missed.
    """
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


def spans(
    margin: Callable[..., Array], left: float, right: float, *args: Array, pieces: int = PIECES
) -> tuple[Array, Array]:
    """Return starts and ends (m, n) of the intervals in [left, right] with margin(x, *args (n,)) ≥ 0, NaN where fewer.

    Exact where the intervals and the gaps between them are wider than one of the `pieces`. A single interval is found
    however narrow, if the margin rises towards it over more than a piece.
    """
    x = np.repeat(np.linspace(left, right, pieces + 1)[:, None], args[0].size, axis=1)
    inside = _refined(margin, x, args) >= 0
    outside = np.zeros((1, args[0].size), bool)
    entered = inside & ~np.vstack([outside, inside[:-1]])
    left_behind = inside & ~np.vstack([inside[1:], outside])
    starts = np.sort(_crossings(margin, x, entered, -1, args), axis=0)  # NaN goes last
    ends = np.sort(_crossings(margin, x, left_behind, +1, args), axis=0)
    most = int(entered.sum(axis=0).max(initial=0))
    return starts[:most], ends[:most]


def _refined(margin: Callable[..., Array], x: Array, args: tuple[Array, ...]) -> Array:
    """Return the margin at the nodes x (pieces+1, n); where all are negative the best is moved to the margin's top."""
    values = margin(x, *args)
    missed = np.nonzero((values < 0).all(axis=0))[0]
    if missed.size:
        here = tuple(a[missed] for a in args)
        ends = x[0, missed], x[-1, missed]
        top = lowest(lambda x, *a: -margin(x, *a), *ends, *here, pieces=len(x) - 1)
        i = values[:, missed].argmax(axis=0)
        x[i, missed], values[i, missed] = top, margin(top, *here)
    return values


def _crossings(margin: Callable[..., Array], x: Array, flags: Mask, step: int, args: tuple[Array, ...]) -> Array:
    """Return where the margin is zero between the flagged nodes of x (pieces+1, n) and their neighbours, else NaN.

    At the border of x, where there is no neighbour, the node itself.
    """
    found = np.full(x.shape, np.nan)
    i, column = np.nonzero(flags)
    inner, outer = x[i, column], x[np.clip(i + step, 0, len(x) - 1), column]
    root = increasing_root(
        lambda x, *a: -step * margin(x, *a),
        np.minimum(inner, outer),
        np.maximum(inner, outer),
        *(a[column] for a in args),
    )
    found[i, column] = np.where(inner == outer, inner, root)
    return found
