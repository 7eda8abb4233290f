"""Projection of readings to the due time of a sample.

An observer assumes evenly spaced readings, and at 1 rad/s a millisecond is 0.06°: late readings are therefore projected
to their due time. So is an angle that its device dates up to a sample earlier, by the estimated velocity; the observer
compensates a constant age (`Compensation.reading_age`). Both move an angle by whole steps of its encoder: from changes
that are no steps an observer learns a fine encoder, and amplifies the steps of the coarse one.

Dates may be wrong themselves: a driver that dates readings when a bus delivers them adds ω times the error to smooth
angles. The beginning of a sample is known by the clock of its loop; differences of the ages then from their mean are
believed only as far as they smooth the angles. Of the angles r and the shifts f by these differences, the share

    λ = -Σ Δ²r Δ²f / Σ (Δ²f)²                               within 0 … 1, over the last second

leaves the least second differences Δ²(r + λ f): 1 for true dates, 0 for evenly spaced readings with wrong ones.
"""

from collections import deque
from functools import partial
from math import exp, isfinite

import numpy as np

from allocator.calculus import Array, Value
from mpc.bench.cycle import Tick
from mpc.observer.gating import ROUNDING

_FURTHEST = 0.8  # samples: with more, the estimated velocity amplifies its own error through the angle
_COARSEST = 1e3  # [rad] step of an encoder that is not known yet
_MEMORY = 1.0  # [s] of the mean age and of λ
_DOUBT = 3.0  # [steps of the encoder] second difference that counts as much as the trust in dates at the beginning


class Projection:
    """Projection of the readings of n angles and m pressures every `dt` [s]; it learns steps and wrong dates."""

    def __init__(self, n: int, dt: float) -> None:
        self._n, self._dt, self._forgets = n, dt, exp(-dt / _MEMORY)
        self._steps = np.full(n, _COARSEST)  # of the encoders [rad]
        self._given = np.full(n, np.nan)  # last angles (n,) [rad] returned
        self._before: tuple[float, Array] | None = None  # believed time [s] and values (2n + m,) of the last reading
        self._mean: float | None = None  # age at the beginning of a sample [s]
        self._last: deque[tuple[Array, Array]] = deque(maxlen=2)  # r and f (n,) [rad] of the two samples before
        self._common, self._square = 0.0, 0.0  # sums of -Δ²r Δ²f and of (Δ²f)² [rad²]
        self._share = 1.0  # λ

    def at_due(self, tick: Tick, omega: Value) -> Array:
        """Return the readings (2n + m,) of a sample projected to its due time, with the velocities `omega` (n,)
        [rad/s].
        """
        t, theta, P = tick.reading
        said = np.concatenate([np.atleast_1d(theta), np.full(self._n, np.nan), P])
        if tick.missed:
            self._last.clear()
        if self._before is not None:
            self._learn_steps(np.abs(said - self._before[1])[: self._n])
        full, usual = tick.due - t, self._mean_with(tick.due + tick.late - t) - tick.late
        date = t + (1 - self._share) * (full - usual)
        shift = partial(self._shift, date, said, omega)
        by_mean, by_date = shift(usual), shift(full)
        self._weigh(said[: self._n], (by_date - by_mean)[: self._n])
        self._before = date, said
        moved = by_mean + self._share * (by_date - by_mean)
        moved[: self._n] = np.round(moved[: self._n] / self._steps) * self._steps
        return self._on_grid(said + np.where(np.isfinite(moved), moved, 0.0))

    def _shift(self, date: float, said: Array, omega: Value, age: float) -> Array:
        """Return the shift (2n + m,) of readings that are `age` [s] old, or late if it is negative.

        Late readings, of the believed `date` [s], are interpolated linearly from the ones before, older angles
        extrapolated with `omega`.
        """
        moved = np.zeros(said.size)
        if age > 0:  # fading out without a jump: two samples later the velocity may be another one
            moved[: self._n] = omega * max(min(age, _FURTHEST * self._dt, 2 * self._dt - age), 0.0)
        elif self._before is not None and date > self._before[0]:
            moved = min(-age / (date - self._before[0]), 1.0) * (self._before[1] - said)
        return moved

    def _mean_with(self, age: float) -> float:
        """Return the mean age [s] at the beginning of samples so far, with this one."""
        if isfinite(age):
            mean = age if self._mean is None else self._mean
            self._mean = mean + (1 - self._forgets) * (age - mean)
        return 0.0 if self._mean is None else self._mean

    def _weigh(self, r: Array, f: Array) -> None:
        """Update λ with the angles `r` (n,) and their shifts `f` (n,) [rad] by the difference of the age."""
        if not isfinite(r @ f):
            self._last.clear()
        else:
            if len(self._last) == 2:
                (r2, f2), (r1, f1) = self._last
                bend, shift = r - 2 * r1 + r2, f - 2 * f1 + f2
                self._common = self._forgets * self._common - float(bend @ shift)
                self._square = self._forgets * self._square + float(shift @ shift)
            self._last.append((r, f))
        prior = (_DOUBT * float(self._steps.min())) ** 2
        self._share = min(max((prior + self._common) / (prior + self._square), 0.0), 1.0)

    def _learn_steps(self, changes: Array) -> None:
        """Update the steps of the encoders (n,) [rad], the least changes of readings so far."""
        self._steps = np.where((changes > ROUNDING) & (changes < self._steps), changes, self._steps)

    def _on_grid(self, said: Array) -> Array:
        """Return readings whose angles differ from the last ones by more than rounding, or not at all."""
        angles = said[: self._n]
        angles[:] = self._given = np.where(np.abs(angles - self._given) <= ROUNDING, self._given, angles)
        return said
