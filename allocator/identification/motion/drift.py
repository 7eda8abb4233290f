"""Change of a joint's strength over the stretches of its logs.

In each piece of the log the measured angle is regressed on the predicted one; the gains are regressed on time,

    θ_k = z_i + g_i θ̂_k,   g_i ≈ g (1 + r (t_i - t̄))        pieces i weighted by their rows

A muscle that tires or warms up changes g. The doubt of r is the spread of the gains about the line, so it includes the
model's error, which differs from piece to piece. Pieces are the stretches, or eight parts of a log with less than four.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.least_squares import rms
from allocator.identification.motion.samples import MotionLog

_LEAST_STRETCHES, _PIECES = 4, 8
_LEAST_ROWS = 50
_HOUR = 3600.0


class Drift(NamedTuple):
    """Change of the gain of the angle per hour, with the errors of the pieces that it was found from."""

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
        X = np.stack([np.ones(t.size), t], axis=1)
        information = X.T @ (weights[:, None] * X)
        g, slope = np.linalg.solve(information, X.T @ (weights * gains))
        rest = gains - X @ [g, slope]
        variance = float(np.sum(weights * rest**2)) / (t.size - 2) * np.linalg.inv(information)[1, 1]
        return cls(float(slope / g), float(np.sqrt(variance) / abs(g)), times, gains / g, errors)


class _Piece(NamedTuple):
    time: float
    gain: float
    error: float
    rows: float

    @classmethod
    def of(cls, log: MotionLog, predicted: Array, rows: Mask) -> "_Piece | None":
        """Return the gain of some rows (n,), or None where nothing moves in them."""
        measured, expected = log.theta[rows], predicted[rows]
        if measured.size < _LEAST_ROWS or not np.ptp(expected):
            return None
        gain = float(np.polyfit(expected, measured, 1)[0])
        return cls(float(log.t[rows].mean()), gain, rms(measured - expected), float(measured.size))


def _pieces(log: MotionLog) -> list[Mask]:
    """Return the settled rows (n,) of each piece."""
    row = np.arange(log.n)
    if len(log.parts) >= _LEAST_STRETCHES:
        return [log.settled & (row >= part.start) & (row < part.stop) for part in log.parts]
    return [log.settled & (row * _PIECES // log.n == i) for i in range(_PIECES)]
