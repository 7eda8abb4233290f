"""Measurement of a joint on a device: soft start, tones, safe stop, for one rest after the other."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allocator import checks
from mpc.bench.cycle import Cycle, Settings
from mpc.bench.device import Clock, Device
from mpc.bench.measuring.experiment import Experiment, Tones
from mpc.bench.measuring.log import from_log
from mpc.bench.measuring.result import MeasuredStiffness
from mpc.bench.measuring.shaking import Shaking
from mpc.bench.measuring.strengths import Known
from mpc.bench.measuring.weighing import Weight
from mpc.bench.rows import Row
from mpc.bench.safety import Ending, Reason
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.observer.gating import ROUNDING


@dataclass(frozen=True)
class Told:
    """Known properties of a joint to be measured."""

    plant: Plant  # with the known inertia
    known: Compensation  # friction, dead time and dead band, flow, age of the readings
    inertia_error: float = 0.0  # relative standard deviation of the inertia [-]

    def __post_init__(self) -> None:
        checks.not_negative("inertia_error", self.inertia_error, "-")

    @property
    def prior(self) -> Known:
        """Prior knowledge in the equations of the strengths."""
        return Known(self.plant.inertia, self.inertia_error, self.known.reading_age)


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
        device, source, told.plant, settings or Settings(), log=log, replace=replace, clock=clock, watch=watch
    )
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
    cycle = Cycle(device, source, told.plant, settings or Settings(), clock=clock, watch=watch)
    ending = cycle.run()
    if ending.reason is not Reason.FINISHED:
        refusal = f"the loop ended: {ending}"
    elif source.log is None:
        refusal = "the device gave too few readings of angle and pressures"
    else:
        m = from_log(told.plant, told.known.friction.loop, source.log, told.prior)
        return dataclasses.replace(m, furthest=source.furthest), cycle
    P1, P2 = source.first
    return MeasuredStiffness(theta, (P1, P2), duration=duration, refusal=refusal), cycle


def result_of(source: Experiment, told: Told, ending: Ending, theta: np.ndarray) -> MeasuredStiffness:
    """Return the result of a finished experiment; `theta` (n,) [rad] are all readings of the angle."""
    if ending.reason is not Reason.FINISHED:
        source.findings.refusal = f"the loop ended: {ending}"
    weight = 0.0 if source.weight is None else source.weight.torque
    return MeasuredStiffness.of(
        told.plant, told.known.friction.loop, source.findings, told.prior, encoder_step(theta), weight
    )


def encoder_step(theta: np.ndarray) -> float:
    """Return the step [rad] of an encoder, the least difference of two readings; 0 if hardly any repeat."""
    gaps = np.diff(np.unique(theta[np.isfinite(theta)]))
    steps = gaps[gaps > ROUNDING]
    return 0.0 if not steps.size or steps.size >= 0.5 * theta.size else float(steps.min())
