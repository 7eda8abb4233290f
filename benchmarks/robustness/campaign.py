"""Storm of wrong readings on a real plant, the same for Python's loop and for the exported C."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR, DEG
from mpc import KalmanObserver, RealPlant, TrackingMPC, Weights, sine
from mpc.model.experiment import Experiment
from mpc.observer.gating import TURN

SENSORS = (0, 2, 3)  # of (θ, ω, P1, P2)
KINDS = ("NaN", "inf", "huge", "spike", "offset", "wrap", "freeze", "drop", "noise", "delay", "flicker")
RATE, LONGEST = 0.01, 30  # faults begun per sample; samples of the longest
DT, HORIZON = 0.01, 10
_RANGE = {0: 60 * DEG, 2: 1.5 * BAR, 3: 1.5 * BAR}  # of wrong readings


class Hit(NamedTuple):
    """Fault of some sensors."""

    kind: str
    begin: int  # sample
    end: int
    sensors: tuple[int, ...]
    size: float  # of the error, from -1 to 1


def hits(samples: int, seed: int) -> list[Hit]:
    """Return random faults, one after the other; the first second is quiet."""
    rng, found, k = np.random.default_rng(seed), [], round(1 / DT)
    while (k := k + 1 + int(rng.geometric(RATE))) < samples:
        length = int(rng.integers(1, LONGEST + 1)) if rng.random() < 0.5 else int(rng.integers(1, 4))
        sensors = SENSORS if rng.random() < 0.2 else (int(rng.choice(SENSORS)),)
        found.append(Hit(str(rng.choice(KINDS)), k, k + length, sensors, float(rng.uniform(-1, 1))))
        k += length
    return found


@dataclass
class StormyExperiment:
    """Experiment with failing sensors."""

    inner: Experiment
    hits: list[Hit]
    rng: np.random.Generator
    _k: int = 0
    _past: list[Array] = field(default_factory=list)

    @property
    def x(self) -> Array:
        """True state (4,)."""
        return self.inner.x

    def advance(self, u: Array) -> None:
        """Advance by one sample with the commands `u` (2,) [Pa]."""
        self.inner.advance(u)

    def measure(self) -> Array:
        """Return the sensors' readings (4,), wrong while a fault lasts."""
        y = self.inner.measure()
        self._past = [*self._past[-10:], y.copy()]
        for hit in self.hits:
            if hit.begin <= self._k < hit.end:
                y = self._wrong(y, hit)
        self._k += 1
        return y

    def _wrong(self, y: Array, hit: Hit) -> Array:
        y, first = y.copy(), self._k == hit.begin
        for i in hit.sensors:
            span = hit.size * _RANGE[i]
            match hit.kind:
                case "NaN":
                    y[i] = np.nan
                case "inf":
                    y[i] = np.copysign(np.inf, hit.size)
                case "huge":
                    y[i] = 1e300 * hit.size
                case "spike":
                    y[i] += span if first else 0.0
                case "offset":
                    y[i] += span
                case "wrap":
                    y[i] = y[i] + np.copysign(TURN, hit.size) if i == 0 else 0.0
                case "freeze":
                    y[i] = self._past[-min(len(self._past), self._k - hit.begin + 2)][i]
                case "drop":
                    y[i] = 0.0
                case "noise":
                    y[i] += abs(span) / 4 * self.rng.standard_normal()
                case "delay":
                    y[i] = self._past[-min(len(self._past), 6)][i]
                case "flicker":
                    y[i] += span * (self._k % 2)
        return y


@dataclass(frozen=True)
class StormyPlant:
    """Real plant with such sensors; the rest of `mpc.trials.simulation.Process` is the plant's."""

    real: RealPlant
    hits: tuple[Hit, ...]

    @property
    def nominal(self) -> object:
        """Plant without unmodelled effects."""
        return self.real.nominal

    def at_rest(self, theta: float, K: float) -> Array:
        """Return the initial state (4,)."""
        return self.real.at_rest(theta, K)

    def begin(self, dt: float, x0: Array, seed: int) -> StormyExperiment:
        """Return an experiment from `x0` (4,)."""
        return StormyExperiment(self.real.begin(dt, x0, seed), list(self.hits), np.random.default_rng(seed))

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the true isobaric stiffness [N·m/rad] and muscle forces [N]."""
        return self.real.along(x)


def loop(real: RealPlant) -> tuple[TrackingMPC, KalmanObserver]:
    """Return controller and observer of the campaign."""
    known = real.known()
    controller = TrackingMPC(real.nominal, DT, HORIZON, weights=Weights.calm(), compensation=known)
    return controller, KalmanObserver(real.nominal, DT, compensation=known)


def storms(samples: int, parts: int, seed: int) -> Iterator[tuple[StormyPlant, int]]:
    """Return parts of a campaign: plants with failing sensors, and the seeds of the sensors' noise."""
    for part in range(parts):
        yield StormyPlant(RealPlant.standard(), tuple(hits(samples // parts, seed + part))), seed + part


def reference(samples: int) -> object:
    """Return the reference."""
    return sine(amplitude=30 * DEG, K=5.5, frequency=0.25, duration=samples * DT, ramp=1.0, dt=DT)
