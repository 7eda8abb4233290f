"""Bands about predicted angles, the effect of unexplained errors on the parameters, and drift of the joint's strength.

The log is cut into contiguous blocks and each is predicted from the others. The half width of the band is the 95 %
quantile of these errors, one for taut rows and one for the others, which have greater errors. The coverage is measured
likewise: the errors of each block against the widths of the other blocks.

Noise in the residual averages out, and the jackknife includes it. A structured residual is the effect of something
absent from the model, partly attributed by the fit to its own parameters:

    δp = s √(gᵀ (JᵀJ/n + s² D⁻²)⁻¹ g)      s: 0.7 of the structured residual [rad],  J = ∂θ̂/∂x,  g = ∂p/∂x

The amount is unknown: δp is the greatest change of a parameter p that moves the prediction by at most a share of the
structured residual, with no unknown moved beyond D. The share makes δp a standard deviation on joints of other laws,
with gas and without (`python -m benchmarks.identification.motion_truth --strangers`).

For the drift, the measured angle is regressed on the predicted one in each piece of the log, and these gains on time:

    θ_k = z_i + g_i θ̂_k,   g_i ≈ g (1 + r (t_i - t̄))        pieces i weighted by their rows

A muscle that tires or warms up changes g. The standard deviation of r follows from the spread of the gains about the
line, so it includes the model error, which differs between pieces. Pieces are the stretches of the log, or eight parts
of it if fewer than four stretches have 50 rows to judge.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.least_squares import rms
from allocator.identification.motion.problem import MotionProblem
from allocator.identification.motion.samples import MotionLog

SHARE = 0.95  # of the errors within the band
_LEAST = 100  # rows of a kind: with fewer it has the width of all rows
_FINE, _COARSE = 1e-3, 1e-2  # of the usual size of a change: differences of predictions, and of parameters
_SHARE = 0.7  # of the structured residual
_MOST = 1.0  # usual sizes of a change: D


class AngleBand(NamedTuple):
    """Predicted angles with the band in which 95 % of the measured ones are expected; arrays (m,)."""

    theta: Array  # [rad]
    low: Array  # [rad]
    high: Array  # [rad]


@dataclass(frozen=True)
class Bands:
    """Half widths of the 95 % band, and its coverage of unseen blocks."""

    taut: float  # of rows with both pressures at 1.5 bar or more [rad]
    other: float  # of the other rows [rad]
    coverage: float  # share of rows within it, in blocks unseen by the prediction and the widths [-]

    @classmethod
    def of(cls, errors: Array, blocks: Array, taut: Mask) -> Self:
        """Return the bands of the `errors` (n,) [rad], each of a row predicted from other blocks.

        `blocks` (n,) are the numbers of the blocks; rows with NaN errors do not count.
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
        """Return the band about the angles (m,) [rad]; `taut` (m,) marks taut rows."""
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


def structured(error: Array) -> float:
    """Return the RMS [rad] of the part of `error` (n,) that is not white noise."""
    return float(np.sqrt(max(float(np.mean(error[1:] * error[:-1])), 0.0)))


def possible_changes(
    problem: MotionProblem, x: Array, used: Mask, named: Callable[[Array], Mapping[str, float]]
) -> dict[str, float]:
    """Return the possible error of each of the parameters `named`, by the residual over the rows `used` (n,)."""
    sizes, high = problem.sizes(), problem.bounds()[1]
    here, base = problem.run(x, used).theta[used], named(x)
    J = np.empty((here.size, x.size))
    g = {name: np.zeros(x.size) for name in base}
    for i, size in enumerate(sizes):
        way = 1.0 if x[i] + _COARSE * size <= high[i] else -1.0
        J[:, i] = (problem.run(_moved(x, i, way * _FINE * size), used).theta[used] - here) / (way * _FINE)
        for name, value in named(_moved(x, i, way * _COARSE * size)).items():
            if name in g:
                g[name][i] = (value - base[name]) / (way * _COARSE)
    s = _SHARE * structured(problem.log.theta[used] - here)
    bounded = np.vstack([J / np.sqrt(here.size), np.diag(s * sizes / np.maximum(_MOST * sizes, np.abs(x)))])
    _, values, rows = np.linalg.svd(bounded, full_matrices=False)
    return {name: float(s * np.linalg.norm((rows @ slope) / np.maximum(values, 1e-12))) for name, slope in g.items()}


def _moved(x: Array, i: int, by: float) -> Array:
    moved = x.copy()
    moved[i] += by
    return moved


# --- drift ------------------------------------------------------------------------------------------------------------


_LEAST_STRETCHES, _PIECES = 4, 8
_LEAST_ROWS = 50
_HOUR = 3600.0


class Drift(NamedTuple):
    """Change of the gain of the angle per hour, with the errors of its pieces."""

    per_hour: float  # r [1/h]
    std: float  # [1/h]
    times: Array  # middle of each piece (pieces,) [s]
    gains: Array  # g_i/g (pieces,) [-]
    errors: Array  # RMS of each piece (pieces,) [rad]

    @property
    def shows(self) -> bool:
        """Whether the change is more than twice its standard deviation."""
        return abs(self.per_hour) > 2 * self.std

    @classmethod
    def of(cls, log: MotionLog, predicted: Array) -> "Drift":
        """Return the drift of a log's angles over the predicted ones (n,) [rad]; NaN with less than three pieces."""
        found = [piece for rows in _pieces(log) if (piece := _Piece.of(log, predicted, rows)) is not None]
        times, gains, errors, weights = (np.array([piece[i] for piece in found]) for i in range(4))
        if len(found) < 3 or not np.ptp(times):
            return cls(np.nan, np.nan, times, gains, errors)
        t = (times - np.average(times, weights=weights)) / _HOUR
        (slope, g), covariance = np.polyfit(t, gains, 1, w=np.sqrt(weights), cov=True)
        return cls(float(slope / g), float(np.sqrt(covariance[0, 0]) / abs(g)), times, gains / g, errors)


class _Piece(NamedTuple):
    time: float
    gain: float
    error: float
    rows: float

    @classmethod
    def of(cls, log: MotionLog, predicted: Array, rows: Mask) -> "_Piece | None":
        """Return the gain of some rows (n,), or None if nothing moves in them."""
        measured, expected = log.theta[rows], predicted[rows]
        if measured.size < _LEAST_ROWS or not np.ptp(expected):
            return None
        gain = float(np.polyfit(expected, measured, 1)[0])
        return cls(float(log.t[rows].mean()), gain, rms(measured - expected), float(measured.size))


def _pieces(log: MotionLog) -> list[Mask]:
    """Return the settled rows (n,) of each piece."""
    row = np.arange(log.n)
    stretches = [log.settled & (row >= part.start) & (row < part.stop) for part in log.parts]
    if sum(int(rows.sum()) >= _LEAST_ROWS for rows in stretches) >= _LEAST_STRETCHES:
        return stretches
    return [log.settled & (row * _PIECES // log.n == i) for i in range(_PIECES)]
