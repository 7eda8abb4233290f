"""Bands about predicted angles, from errors on rows that the prediction was not fitted to.

The log is cut into contiguous blocks and each is predicted from the others. The half width of the band is the 95 %
quantile of these errors, one for taut rows and one for the others, whose errors are greater. The coverage is measured
in the same way: the errors of each block against the widths that the other blocks give.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array, Mask

SHARE = 0.95  # of the errors within the band
_LEAST = 100  # rows of a kind, below which it has the width of all rows


class AngleBand(NamedTuple):
    """Predicted angles with the band in which 95 % of the measured ones are expected; arrays (m,)."""

    theta: Array  # [rad]
    low: Array  # [rad]
    high: Array  # [rad]


@dataclass(frozen=True)
class Bands:
    """Half widths of the band of 95 %, and how much of unseen blocks lay within."""

    taut: float  # of rows with both pressures at 1.5 bar or more [rad]
    other: float  # of the other rows [rad]
    coverage: float  # share of the rows of blocks that neither the prediction nor the widths had seen [-]

    @classmethod
    def of(cls, errors: Array, blocks: Array, taut: Mask) -> Self:
        """Return the bands of the `errors` (n,) [rad], each of a row predicted from other blocks than its own.

        `blocks` (n,) are the numbers of the blocks; rows whose error is NaN do not count.
        """
        known = np.isfinite(errors)
        inside = np.zeros(errors.size, bool)
        for block in np.unique(blocks[known]):
            judged = known & (blocks == block)
            inside[judged] = np.abs(errors[judged]) <= _half(errors, known & ~judged, taut)[judged]
        half = _half(errors, known, taut)
        widest = float(_quantile(errors[known]))
        taut_width = float(half[taut][0]) if taut.any() else widest
        return cls(taut_width, float(half[~taut][0]) if (~taut).any() else widest, float(inside[known].mean()))

    def about(self, theta: Array, taut: Mask) -> AngleBand:
        """Return the band about the angles (m,) [rad], of which some are `taut` (m,)."""
        half = np.where(taut, self.taut, self.other)
        return AngleBand(theta, theta - half, theta + half)


def _half(errors: Array, used: Mask, taut: Mask) -> Array:
    """Return the half widths (n,) [rad] by the errors of the rows `used` (n,)."""
    half = np.full(errors.size, _quantile(errors[used]))
    for kind in (taut, ~taut):
        if (rows := used & kind).sum() >= _LEAST:
            half[kind] = _quantile(errors[rows])
    return half


def _quantile(errors: Array) -> float:
    return float(np.quantile(np.abs(errors), SHARE)) if errors.size else float("nan")
