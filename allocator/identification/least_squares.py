"""Linear least squares with unknowns of very different magnitude, and the subspace determined by the data.

With the columns of the weighted Jacobian J scaled to unit length, a direction whose singular value is zero (to 1e-9 of
the greatest) changes no datum. Such parameters are collinear: only a combination of them is known. The covariance is
that of the determined directions, σ² (JᵀJ)⁺, σ² = Σ w r²/(n - rank), so that every quantity that depends on the data
alone has its proper variance.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from allocator.calculus import Array, Mask

_RANK_TOLERANCE = 1e-9


def unit_columns(A: Array) -> tuple[Array, Array]:
    """Return A (n, m) with columns of unit length, and their lengths (m,), 1 for a column of zeros."""
    length = np.linalg.norm(A, axis=0)
    length[length == 0] = 1.0
    return A / length, length


def solve(A: Array, b: Array, rcond: float) -> Array:
    """Return argmin |A p - b| (m, …) with the columns of A scaled to unit length, the shortest if it is not unique."""
    scaled, length = unit_columns(A)
    return np.asarray((np.linalg.lstsq(scaled, b, rcond=rcond)[0].T / length).T)


def polynomials(places: Array, degrees: Iterable[tuple[int, int]], most: float) -> Array | None:
    """Return the Chebyshev polynomials (n, terms) over `places` (n, 2), of the first of the `degrees` along both axes
    with `most` terms or fewer; None if there are none.
    """
    x, y = (2 * (q - q.min()) / max(np.ptp(q), 1e-300) - 1 for q in places.T)
    return next((chebyshev.chebvander2d(x, y, (i, j)) for i, j in degrees if (i + 1) * (j + 1) <= most), None)


def rms(error: ArrayLike) -> float:
    """Return the root mean square, NaN if empty."""
    error = np.asarray(error)
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def at_bound(x: Array, lower: Array, upper: Array, near: float, of_width: float) -> Mask:
    """Return which of x (m,) are at a bound: within the share `near` of x or of the part `of_width` of the interval."""
    width = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    margin = near * np.maximum(np.abs(x), of_width * width)
    return np.asarray((x - lower < margin) | (upper - x < margin))


class Determination(NamedTuple):
    """Rank, covariance and collinear directions of a Jacobian."""

    rank: int
    covariance: Array  # (m, m)
    collinear: tuple[str, ...]  # the directions that change no force, in words


def determine(jacobian: Array, cost: float, names: tuple[str, ...], values: Array) -> Determination:
    """Rank, covariance and collinear directions from J (n, m) at the solution and its cost Σ w r²."""
    m = len(names)
    if m == 0:
        return Determination(0, np.zeros((0, 0)), ())
    scaled, length = unit_columns(jacobian)
    R = np.linalg.qr(scaled, mode="r")  # (m, m): has J's singular values, and no n x n matrix is made
    _, singular, Vt = np.linalg.svd(R, full_matrices=True)
    singular = np.append(singular, np.zeros(m - singular.size))
    known = singular > _RANK_TOLERANCE * max(singular[0], 1e-300)
    rank = int(known.sum())
    rows = (jacobian != 0).any(axis=1).sum()
    variance = cost / max(rows - rank, 1)
    half = (Vt[known].T / singular[known]) / length[:, None]  # (m, rank)
    directions = tuple(_in_words(v / length, names, values) for v in Vt[~known])
    return Determination(rank, variance * half @ half.T, directions)


def _in_words(direction: Array, names: tuple[str, ...], values: Array) -> str:
    """Return 'r0 +1.00 %, q -2.00 %': a change of the parameters that changes no force."""
    relative = direction / np.where(values == 0, 1.0, np.abs(values))
    relative = relative / relative[np.argmax(np.abs(relative))]
    parts = (f"{name} {r:+.2f} %" for name, r in zip(names, relative, strict=True) if abs(r) > 1e-3)
    return ", ".join(parts)
