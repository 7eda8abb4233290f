"""Runs, and the diagnoses of the joint's health."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from benchmarks.closed_loop.cases import SETTINGS
from benchmarks.faults.cases import (
    FAULTS,
    FAULTY,
    IDENTIFIED,
    LOADS,
    MOVED,
    ONSETS,
    SOUND,
    K,
    stranger,
    with_fault,
    with_load,
)  # fmt: skip
from benchmarks.strangers.identified import identified
from benchmarks.strangers.plants import Stranger
from mpc import KalmanObserver, Run, simulate
from mpc.model.faults import DriftingSensor, Fault
from mpc.model.real import RealPlant
from mpc.observer.health import Health, Suspect
from mpc.trials.loops import Settings, loop, robust
from mpc.trials.motions.reference import Reference
from mpc.trials.motions.trajectories import TRAJECTORIES
from mpc.trials.simulation import Controller

AFTERWARDS = 5.0  # [s] of a run with its fault
NAMED_AFTER = 1.0  # [s] after the alarm at which the name counts
MATTERS = 0.2 * BAR  # [Pa] least error of a pressure or its reading by which a fault counts as effective
SEED = 701


class Listener:
    """Observer, and its diagnoses of the joint's health."""

    def __init__(self, observer: KalmanObserver) -> None:
        self.observer = observer
        self.said: list[Health] = []

    def reset(self) -> None:
        """Reset the observer."""
        self.observer.reset()
        self.said = []

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """Return the observer's estimate."""
        answer = self.observer.estimate(y, u)
        self.said.append(self.observer.health)
        return answer


@cache
def driver(plant: str) -> tuple[Controller, Listener]:
    """Return controller and observer of all runs of a process on our own plants (""), or on a stranger."""
    controller, observer = loop("mpc", settings(plant))
    assert isinstance(observer, KalmanObserver)
    return controller, Listener(observer)


@cache
def settings(plant: str) -> Settings:
    """Return the settings for our own plants (""), or for a stranger: of its data sheet, or of the fit to its logs."""
    if not plant:
        return SETTINGS
    real = stranger(plant)
    if plant in IDENTIFIED:
        model = identified(real)
        return robust("mpc", Settings(model.plant, SETTINGS.dt, compensation=model.told))
    told = replace(real.told, reading_age=real.sensors.late * SETTINGS.dt)
    return robust("mpc", Settings(real.nominal, SETTINGS.dt, compensation=told))


def driven(real: RealPlant | Stranger, job: "Job", reference: Reference) -> tuple[Run, list[Health]]:
    """Return a run, and the diagnosis in each of its samples."""
    controller, listener = driver(job.model)
    return simulate(real, controller, reference, observer=listener, seed=job.seed), listener.said


class Job(NamedTuple):
    """Planned run: with a fault from `onset` [s] on, or without one and under a load [N·m]."""

    plant: str
    trajectory: str
    seed: int
    fault: str = ""
    onset: float = 0.0
    load: float = 0.0

    @property
    def model(self) -> str:
        """Name of the plant that the observer models, "" for all of our own."""
        return "" if self.plant in SOUND else self.plant


class Row(NamedTuple):
    """Outcome of a run; times in s, NaN without a suspicion."""

    job: Job
    seconds: float  # of sound motion
    false_alarms: int  # numbers of suspicions begun in it
    first_false: str  # the first of them, in words
    delay: float  # of the first alarm, from the onset
    late: float  # of the same, from the first effect of the fault; 0 at least
    at_once: str  # "right", "group" or "wrong", and "" without an alarm
    after_all: str  # the same later
    said: str  # the suspects then


def fault_jobs(seeds: range, plants: Iterable[str] = tuple(FAULTY)) -> Iterator[Job]:
    """Return every fault on every plant and trajectory, at every onset."""
    for plant in plants:
        for trajectory in MOVED:
            for fault in FAULTS:
                yield from (Job(plant, trajectory, seed, fault, onset) for onset in ONSETS for seed in seeds)


def sound_jobs(seeds: range, plants: Iterable[str] = tuple(SOUND), loads: tuple[float, ...] = LOADS) -> Iterator[Job]:
    """Return every trajectory on every plant under every load, without a fault."""
    for plant in plants:
        for trajectory in TRAJECTORIES:
            yield from (Job(plant, trajectory, seed, load=load) for load in loads for seed in seeds)


def row(job: Job) -> Row:
    """Return the judged run of a job."""
    reference = TRAJECTORIES[job.trajectory].about(K)
    if not job.fault:
        run, said = driven(with_load(job.plant, job.load), job, reference)
        return Row(job, len(said) * run.dt, *_false_alarms(said), np.nan, np.nan, "", "", "")
    real = with_fault(job.plant, job.fault, job.onset)
    return judged(job, real.faults[0], *driven(real, job, _until(reference, job.onset + AFTERWARDS)))


def judged(job: Job, fault: Fault, run: Run, said: list[Health]) -> Row:
    """Return the judgement of the diagnoses `said` in a `run` with a `fault`."""
    onset = round(job.onset / run.dt)
    before = onset * run.dt, *_false_alarms(said[:onset])
    alarm = next((k for k in range(onset, len(said)) if not said[k].well), None)
    if alarm is None:
        return Row(job, *before, np.nan, np.nan, "", "", "")
    last = min(alarm + round(NAMED_AFTER / run.dt), len(said) - 1)
    later = next(k for k in range(last, -1, -1) if not said[k].well)  # it may be over by then
    late = max(alarm - _matters(fault, run, onset, settings(job.model).compensation.delay(run.dt)), 0) * run.dt
    verdicts = (_verdict(FAULTS[job.fault].named, said[k]) for k in (alarm, later))
    return Row(job, *before, (alarm - onset) * run.dt, late, *verdicts, str(said[later]))


def _until(reference: Reference, end: float) -> Reference:
    kept = reference.t <= end + 1e-9
    return Reference(reference.t[kept], reference.theta[kept], reference.K[kept])


def _false_alarms(said: list[Health]) -> tuple[int, str]:
    began = [now for before, now in zip([Health(), *said], said, strict=False) if before.well and not now.well]
    return len(began), str(began[0]) if began else ""


def _verdict(named: Suspect, health: Health) -> str:
    if named not in health.suspects:
        return "wrong"
    return "right" if len(health.suspects) == 1 else "group"


def _matters(fault: Fault, run: Run, onset: int, delay: int) -> int:
    """Return the first sample at which the fault has an effect, if commands act after `delay` samples."""
    for k in range(onset, len(run.u)):
        command, P = run.u[max(k - delay, 0)], run.P[k]
        if isinstance(fault, DriftingSensor):
            off = np.abs(fault.offset(k * run.dt)[2:]).max() if fault.sensor else np.inf
        else:
            changed = np.abs(fault.effective(command, P) - command).max()
            off = changed if type(fault).effective is not Fault.effective else np.inf
        if off > MATTERS:
            return k
    return len(run.u) - 1
