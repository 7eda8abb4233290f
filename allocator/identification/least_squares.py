"""Linear least squares whose unknowns differ by many orders of magnitude, and sums of squares."""

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array


def unit_columns(A: Array) -> tuple[Array, Array]:
    """Return A (n, m) with columns of unit length, and their lengths (m,), 1 for a column of zeros."""
    length = np.linalg.norm(A, axis=0)
    length[length == 0] = 1.0
    return A / length, length


def solve(A: Array, b: Array, rcond: float) -> Array:
    """Return argmin |A p - b| (m, …) with the columns of A scaled to unit length, the shortest if it is not unique."""
    scaled, length = unit_columns(A)
    return np.asarray((np.linalg.lstsq(scaled, b, rcond=rcond)[0].T / length).T)


def rms(error: ArrayLike) -> float:
    """Return the root of the mean square, NaN of nothing."""
    error = np.asarray(error)
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")
