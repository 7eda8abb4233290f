"""Experiment that shakes a joint about a rest by noise in both pressures, for the weak-form regression.

Each muscle has its own noise between 0.3 and 4 Hz. Its amplitude grows until the joint moves by the wanted amplitude,
and is halved at once if the joint moves by more. Tones need a search for their amplitude and regulators that follow
above the resonance; noise needs neither.
"""

from collections.abc import Iterator
from math import isfinite

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.units import BAR
from mpc.bench.cycle import Decision, Phase, Tick
from mpc.bench.measuring.driving import resting, room
from mpc.bench.measuring.log import LEAST_ROWS, Samples
from mpc.bench.rows import Pressures
from mpc.model.plant import Plant

_BAND = 0.3, 4.0  # [Hz]
_BEGIN, _LEAST = 0.05 * BAR, 0.01 * BAR  # root mean square of the noise
_WINDOW = 1.5  # [s] over which excursions are judged
_AIM, _TOO_FAR = 0.7, 1.1  # [-] of the wanted amplitude: aim in each window, and limit beyond which the noise is halved
_MIDDLE = 5.0  # [s] over which the middle of the motion is taken
_GROWTH = 1.25  # of the noise from window to window, at most
_SETTLE, _END = 1.5, 0.5  # [s] at rest
_TAIL = 2.5  # greatest noise in its root mean square


class Shaking:
    """`CommandSource` of noise about the rest of a model."""

    def __init__(
        self, plant: Plant, theta: float, K: float, dt: float, amplitude: float, duration: float = 60.0, seed: int = 0
    ) -> None:
        self.dt = dt
        self.amplitude = checks.positive("amplitude", amplitude, "rad")
        self.duration = checks.positive("duration", duration, "s")
        self.first: Pressures = resting(plant, theta, K)
        self.furthest = 0.0  # greatest excursion over the wanted amplitude [-]
        self._room = room(plant, theta, self.first)
        self._noise = noise(round(self.duration / dt), dt, seed)
        self._rows: list[tuple[float, ...]] = []
        self._centre = float("nan")  # [rad]
        self._decisions = self._all()

    def decide(self, tick: Tick) -> Decision | None:
        """Return the commands of this sample, None at the end."""
        reading = tick.reading
        self._rows.append((reading.t, reading.theta, *reading.P))
        return next(self._decisions, None)

    @property
    def log(self) -> Samples | None:
        """Rows with complete readings; None if there are too few."""
        rows = np.array(self._rows).reshape(-1, 4)
        rows = rows[np.isfinite(rows).all(axis=1)]
        return Samples.of(*rows.T) if len(rows) >= LEAST_ROWS else None

    def _all(self) -> Iterator[Decision]:
        yield from self._hold(_SETTLE)
        size, far, cut = _BEGIN, 0.0, False
        n = max(round(_WINDOW / self.dt), 1)
        for k, z in enumerate(self._noise):
            now = self._excursion()
            far = max(far, now)
            if now > _TOO_FAR and not cut:
                size, cut = size / 2, True
            if k % n == n - 1:
                size *= 1.0 if cut else float(np.clip((_AIM / max(far, 0.1)) ** 0.5, 1 / _GROWTH, _GROWTH))
                far, cut = 0.0, False
            size = max(min(size, *self._room), _LEAST)
            u = [
                p + float(np.clip(size * e, -most, most)) for p, e, most in zip(self.first, z, self._room, strict=True)
            ]
            yield Decision((u[0], u[1]), Phase.RUN)
        yield from self._hold(_END)

    def _excursion(self) -> float:
        """Return the distance of the joint from the middle of its motion, over the wanted amplitude."""
        theta = self._rows[-1][1]
        if not isfinite(theta):
            return 0.0
        if not isfinite(self._centre):
            self._centre = theta
        self._centre += (theta - self._centre) * self.dt / _MIDDLE
        far = abs(theta - self._centre) / self.amplitude
        self.furthest = max(self.furthest, far)
        return far

    def _hold(self, duration: float) -> Iterator[Decision]:
        for _ in range(round(duration / self.dt)):
            yield Decision(self.first, Phase.RUN)


def noise(n: int, dt: float, seed: int) -> Array:
    """Return band-limited noise (n, 2) of root mean square 1, cut at 2.5."""
    from scipy.signal import butter, sosfilt

    sos = butter(2, np.array(_BAND) * 2 * dt, "band", output="sos")
    z = sosfilt(sos, np.random.default_rng(seed).standard_normal((n + 500, 2)), axis=0)[500:]
    return np.asarray(np.clip(z / z.std(axis=0), -_TAIL, _TAIL))
