"""Rows, box and memory passed between the functions of the kernel."""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls, and the sizes in `carved` are read for C

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask

Places: TypeAlias = NDArray[np.int64]
Signs: TypeAlias = NDArray[np.int8]


class Levels(NamedTuple):
    """Rows of [L]: p of them for m variables, in K levels."""

    A: Array  # (p, m)
    b: Array  # (p)
    onesided: Mask  # (p) whether A x <= b is required, not A x = b
    ends: Places  # (K) where each level ends


class Box(NamedTuple):
    """Bounds, and the centre of the last level."""

    lo: Array  # (m)
    hi: Array  # (m)
    centre: Array  # (m)


class Work(NamedTuple):
    """Memory of one solution, carved from flat arrays by `carved`."""

    Q: Array  # orthonormal rows
    B: Array  # remainders of the rows in the free variables
    L: Array  # the rows are L Q
    U: Array  # and L = U R
    R: Array  # its diagonal inverted
    H: Array  # matrix of the guess's QP
    C: Array  # its factor, the diagonal inverted
    g: Array  # and its linear term
    weights: Array  # of the rows in it
    z: Array
    step: Array  # from the centre along Q
    rhs: Array  # right-hand sides, then the residuals b - A x
    first: Places  # first row of each level's basis
    free: Places  # the free variables
    right: Signs  # correct side of each variable and row
    largest: Array  # the greatest multiplier of each level
    used: Signs  # whether a row is in Q
    tries: Places  # the fewest violations so far, and the remaining patience
    sizes: Array  # of each level: the greatest row sum, the greatest squared row, the size of a gradient
    scales: Array  # of each level and the centre: scales of residual and gradient


def matrix(flat, rows, columns):
    """Return a matrix at the beginning of `flat`, and the rest of `flat`."""
    return flat[: rows * columns].reshape(rows, columns), flat[rows * columns :]


def vector(flat, size):
    """Return the first numbers of `flat`, and the rest of it."""
    return flat[:size], flat[size:]


def carved(floats, places, signs, p, m, K):
    """Return the memory for p rows, m variables and K levels, and the rest of the flat arrays."""
    Q, floats = matrix(floats, m, m)
    B, floats = matrix(floats, p, m)
    L, floats = matrix(floats, p, m)
    U, floats = matrix(floats, p, m)
    R, floats = matrix(floats, m, m)
    H, floats = matrix(floats, m, m)
    C, floats = matrix(floats, m, m)
    g, floats = vector(floats, m)
    weights, floats = vector(floats, p)
    z, floats = vector(floats, m)
    step, floats = vector(floats, m)
    rhs, floats = vector(floats, p)
    first, places = vector(places, K + 1)
    free, places = vector(places, m)
    right, signs = vector(signs, m + p)
    largest, floats = vector(floats, K + 1)
    used, signs = vector(signs, p)
    tries, places = vector(places, 2)
    sizes, floats = matrix(floats, 3, K)
    scales, floats = matrix(floats, 2, K + 1)
    work = Work(
        *(Q, B, L, U, R, H, C, g, weights, z),
        *(step, rhs, first, free, right, largest, used, tries, sizes, scales),
    )
    return work, floats, places, signs


def flat_arrays(p: int, m: int, K: int) -> tuple[Array, Places, Signs]:
    """Return flat arrays of the sizes that `carved` needs."""
    floats = 4 * m * m + 3 * p * m + 3 * m + 2 * p + 6 * K + 3
    return np.empty(floats), np.empty(K + m + 3, np.int64), np.empty(m + 2 * p, np.int8)


def workspace(p: int, m: int, K: int) -> Work:
    """Return the memory for p rows, m variables and K levels."""
    work: Work = carved(*flat_arrays(p, m, K), p, m, K)[0]
    return work
