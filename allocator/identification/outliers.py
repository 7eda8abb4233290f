"""Outliers among neighbouring samples, such as drop-outs of a sensor and readings in a wrong row.

Measurements over the plane of the set quantities lie on a smooth surface. A polynomial of low degree removes most of
it, and the median over the nearest neighbours the rest, so no law is needed, and errors of a law cause no outliers. A
sample is left out if it differs from its neighbours by both

    8 times the usual difference (1.4826 · its median magnitude: the standard deviation if errors are normal),
    10 % of the range of the measured quantity,

and if a plane through its inlying neighbours misses it by that and by three times their residuals: at a corner of the
table a median does not predict.

That is a trimmed fit with one round: normal samples are never that far off, so the covariance of a fit to the others
needs no correction.
"""

from collections.abc import Sequence

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.least_squares import polynomials

_DEGREES = ((4, 4), (3, 3), (2, 2))  # of the polynomial along both axes
_SAMPLES_PER_TERM = 8  # with fewer it follows a single sample
_NEAR = 9  # neighbours, including the sample itself
_AROUND = 3.0  # times the greatest error of a plane through the neighbours
_FAR = 8.0  # usual differences
_LEAST = 0.1  # of the range
_RARE = 0.05  # greatest share of outliers
_PASSES = 3
_SHOWN = 8
_KIND = 10.0  # distance of two kinds, in ranges of the plane


def outlying(places: Array, values: Array, kinds: Array | None = None) -> Mask:
    """Return the mask (n,) of values that are outliers among those at neighbouring `places` (n, 2).

    Samples are neighbours within their row of `kinds` (n, k), such as direction, torque and group. With too few
    samples, or too many outliers, none is marked.
    """
    found = np.zeros(values.size, bool)
    plane = (places - places.min(axis=0)) / np.maximum(np.ptp(places, axis=0), 1e-300)
    rows = np.zeros((values.size, 0)) if kinds is None else kinds
    smooth = polynomials(places, _DEGREES, values.size / _SAMPLES_PER_TERM)
    if smooth is None:
        return found
    terms = np.concatenate([smooth, rows], axis=1)
    low, high = np.quantile(values, (0.02, 0.98))
    at = np.concatenate([plane, _KIND * rows / np.maximum(np.ptp(rows, axis=0), 1e-300)], axis=1)
    for _ in range(_PASSES):
        apart = _apart(at, values, terms, ~found)
        limit = max(_FAR * 1.4826 * float(np.median(apart[~found])), _LEAST * float(high - low))
        if (apart > limit).sum() == found.sum():
            break
        found = apart > limit
    found[found] = _missed(at, values - terms @ _surface(values, terms, ~found), found) > limit
    return found if found.mean() < _RARE else np.zeros(values.size, bool)


def some(shown: Sequence[str]) -> str:
    """Return the first of these words, and the number of the others."""
    more = f" and {len(shown) - _SHOWN} more" if len(shown) > _SHOWN else ""
    return ", ".join(shown[:_SHOWN]) + more


def _apart(at: Array, values: Array, terms: Array, kept: Mask) -> Array:
    """Return the magnitude (n,) of the difference from the median of the `kept` neighbours."""
    from scipy.spatial import cKDTree

    left = values - terms @ _surface(values, terms, kept)
    _, near = cKDTree(at[kept]).query(at, _NEAR)
    return np.asarray(np.abs(left - np.median(left[kept][near], axis=1)))


def _surface(values: Array, terms: Array, kept: Mask) -> Array:
    return np.asarray(np.linalg.lstsq(terms[kept], values[kept], rcond=1e-10)[0])


def _missed(at: Array, left: Array, found: Mask) -> Array:
    """Return the excess error of planes through the nearest other samples at each sample `found`."""
    from scipy.spatial import cKDTree

    others = np.flatnonzero(~found)
    _, near = cKDTree(at[others]).query(at[found], _NEAR + 1)
    missed = []
    for here, rows in zip(np.flatnonzero(found), others[near], strict=True):
        plane = np.column_stack([np.ones(rows.size), at[rows, :2] - at[here, :2]])
        p = np.linalg.lstsq(plane, left[rows], rcond=1e-6)[0]
        missed.append(abs(left[here] - p[0]) - _AROUND * np.abs(plane @ p - left[rows]).max())
    return np.array(missed)
