"""Measurement of a joint on a device: soft start, tones, safe stop, for one rest after the other.

`driven` measures simulated joints: any process with `begin`, sample by sample, without a clock.

Experiment that shakes a joint about a rest by noise in both pressures, for the weak-form regression.

Each muscle has its own noise between 0.3 and 4 Hz. Its amplitude grows until the joint moves by the wanted amplitude,
and is halved at once if the joint moves by more. Tones need a search for their amplitude and regulators that follow
above the resonance; noise needs neither.
"""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Protocol

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.units import BAR
from mpc.bench.cycle import CommandSource, Cycle, Decision, Phase, Settings, Tick
from mpc.bench.device import Clock, Device, Reading
from mpc.bench.loop import about
from mpc.bench.measuring.driving import resting, room
from mpc.bench.measuring.experiment import Experiment, Tones
from mpc.bench.measuring.log import LEAST_ROWS, Samples, from_log
from mpc.bench.measuring.result import MeasuredStiffness
from mpc.bench.measuring.strengths import Known, Weight
from mpc.bench.rows import Pressures, Row
from mpc.bench.safety import Ending, Guard, Reason, Watchdog
from mpc.model import experiment
from mpc.model.compensation import Compensation
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


@dataclass(frozen=True)
class Told:
    """Known properties of a joint to be measured."""

    plant: Plant  # with the known inertia
    known: Compensation  # friction, dead time and dead band, flow, age of the readings
    inertia_error: float = 0.0  # relative standard deviation of the inertia [-]

    def __post_init__(self) -> None:
        checks.not_negative("inertia_error", self.inertia_error, "-")


def measure(
    device: Device,
    told: Told,
    theta: float,
    K: float,
    *,
    dt: float = 0.01,
    tones: Tones | None = None,
    settings: Settings | None = None,
    clock: Clock | None = None,
    watch: Callable[[Row], None] | None = None,
    log: str | Path | None = None,
    replace: bool = False,
    weight: Weight | None = None,
) -> tuple[MeasuredStiffness, Cycle]:
    """Measure the stiffness of a joint on a device about the angle `theta` [rad], as stiff as `K` [N·m/rad].

    `K` is the isobaric stiffness by the model. A `weight` is requested at the end, for the scale. Returns the
    measurement, with the reason of a refusal, and the cycle with its ending. Arguments and exceptions are those of
    `mpc.bench.loop.RealTimeLoop`.
    """
    tones = Tones() if tones is None else tones
    source = Experiment(told.plant, told.known, theta, K, dt, tones, weight)
    cycle = Cycle(
        device, source, told.plant, settings or Settings(), log=log, replace=replace, about=about(dt, told.plant),
        clock=clock, watch=watch,
    )  # fmt: skip
    ending = cycle.run()
    return result_of(source, told, ending, cycle.recorder.columns["theta"]), cycle


def shake(
    device: Device,
    told: Told,
    theta: float,
    K: float,
    amplitude: float,
    *,
    dt: float = 0.01,
    duration: float = 45.0,
    settings: Settings | None = None,
    clock: Clock | None = None,
    watch: Callable[[Row], None] | None = None,
) -> tuple[MeasuredStiffness, Cycle]:
    """Measure the stiffness by noise that moves the joint by ±`amplitude` [rad] for a `duration` [s], see `Shaking`.

    Other arguments, results and exceptions are those of `measure`.
    """
    source = Shaking(told.plant, theta, K, dt, amplitude, duration)
    cycle = Cycle(
        device, source, told.plant, settings or Settings(), about=about(dt, told.plant), clock=clock, watch=watch
    )
    ending = cycle.run()
    known = Known(told.plant.inertia, told.inertia_error, told.known.reading_age)
    if ending.reason is not Reason.FINISHED:
        refusal = f"the loop ended: {ending}"
    elif source.log is None:
        refusal = "the device gave too few readings of angle and pressures"
    else:
        m = from_log(told.plant, told.known.friction.loop, source.log, known)
        return dataclasses.replace(m, furthest=source.furthest), cycle
    P1, P2 = source.first
    return MeasuredStiffness(theta, (P1, P2), duration=duration, refusal=refusal), cycle


def result_of(source: Experiment, told: Told, ending: Ending, theta: np.ndarray) -> MeasuredStiffness:
    """Return the result of a finished experiment; `theta` (n,) [rad] are all readings of the angle."""
    if ending.reason is not Reason.FINISHED:
        source.findings.refusal = f"the loop ended: {ending}"
    known = Known(told.plant.inertia, told.inertia_error, told.known.reading_age)
    return MeasuredStiffness.of(
        told.plant,
        told.known.friction.loop,
        source.findings,
        source.tones,
        known,
        encoder_step(theta),
        0.0 if source.weight is None else source.weight.torque,
    )


def encoder_step(theta: np.ndarray) -> float:
    """Return the step [rad] of an encoder, the least difference of two readings; 0 if hardly any repeat."""
    values = np.unique(theta[np.isfinite(theta)])
    if values.size < 2 or values.size > 0.5 * theta.size:
        return 0.0
    return float(np.diff(values).min())


class Process(Protocol):
    """Simulated joint."""

    def begin(self, dt: float, x0: Array, seed: int) -> experiment.Experiment:
        """Begin an experiment from the state `x0` (4,) with commands every `dt` [s]."""


def driven(process: Process, source: CommandSource, plant: Plant, theta: float, seed: int = 0) -> Array:
    """Drive a process by a source from rest at its first pressures; return the rows (t, θ, P1, P2, u1, u2).

    Commands are limited to the supply and the slew of `plant`. Raises `Stopped` if a reading violates a limit, like a
    loop on a device.
    """
    dt, watchdog = source.dt, Watchdog()
    guard = Guard(plant, dt, watchdog, watchdog.angle_margin)
    trial = process.begin(dt, np.array([theta, 0.0, *source.first]), seed)
    sent: Pressures = source.first
    rows: list[tuple[float, ...]] = []
    k = 0
    while True:
        y = trial.measure()
        reading = Reading(k * dt, float(y[0]), (float(y[2]), float(y[3])))
        if wrong := guard.broken(reading):
            raise wrong
        decision = source.decide(Tick(k, 0, reading, sent, k * dt))
        if decision is None:
            return np.array(rows)
        sent = guard.command(decision.u, sent)
        rows.append((reading.t, reading.theta, *reading.P, *sent))
        trial.advance(np.array(sent))
        k += 1
