"""Runs, and the diagnoses of the joint's health."""

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from benchmarks.closed_loop.cases import SETTINGS
from benchmarks.faults.cases import FAULTS, FAULTY, LOADS, MOVED, ONSETS, SOUND, K, with_fault, with_load
from mpc import KalmanObserver, Run, simulate
from mpc.model.faults import DriftingSensor, Fault
from mpc.model.real_plant import RealPlant
from mpc.observer.health import Health, Suspect
from mpc.trials.loops import loop
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
def driver() -> tuple[Controller, Listener]:
    """Return controller and observer of all runs of a process."""
    controller, observer = loop("mpc", SETTINGS)
    assert isinstance(observer, KalmanObserver)
    return controller, Listener(observer)


def driven(real: RealPlant, reference: Reference, seed: int) -> tuple[Run, list[Health]]:
    """Return a run, and the diagnosis in each of its samples."""
    controller, listener = driver()
    return simulate(real, controller, reference, observer=listener, seed=seed), listener.said


class Job(NamedTuple):
    """Planned run: with a fault from `onset` [s] on, or without one and under a load [N·m]."""

    plant: str
    trajectory: str
    seed: int
    fault: str = ""
    onset: float = 0.0
    load: float = 0.0


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


def fault_jobs(seeds: range) -> Iterator[Job]:
    """Return every fault on every plant and trajectory, at every onset."""
    for plant in FAULTY:
        for trajectory in MOVED:
            for fault in FAULTS:
                yield from (Job(plant, trajectory, seed, fault, onset) for onset in ONSETS for seed in seeds)


def sound_jobs(seeds: range) -> Iterator[Job]:
    """Return every trajectory on every plant under every load, without a fault."""
    for plant in SOUND:
        for trajectory in TRAJECTORIES:
            yield from (Job(plant, trajectory, seed, load=load) for load in LOADS for seed in seeds)


def row(job: Job) -> Row:
    """Return the judged run of a job."""
    reference = TRAJECTORIES[job.trajectory].about(K)
    if not job.fault:
        run, said = driven(with_load(job.plant, job.load), reference, job.seed)
        return Row(job, len(said) * run.dt, *_false_alarms(said), np.nan, np.nan, "", "", "")
    real = with_fault(job.plant, job.fault, job.onset)
    return judged(job, real.faults[0], *driven(real, _until(reference, job.onset + AFTERWARDS), job.seed))


def judged(job: Job, fault: Fault, run: Run, said: list[Health]) -> Row:
    """Return the judgement of the diagnoses `said` in a `run` with a `fault`."""
    onset = round(job.onset / run.dt)
    before = onset * run.dt, *_false_alarms(said[:onset])
    alarm = next((k for k in range(onset, len(said)) if not said[k].well), None)
    if alarm is None:
        return Row(job, *before, np.nan, np.nan, "", "", "")
    last = min(alarm + round(NAMED_AFTER / run.dt), len(said) - 1)
    later = next(k for k in range(last, -1, -1) if not said[k].well)  # it may be over by then
    late = max(alarm - _matters(fault, run, onset), 0) * run.dt
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


def _matters(fault: Fault, run: Run, onset: int) -> int:
    """Return the first sample at which the fault has an effect."""
    delay = SETTINGS.compensation.delay(run.dt)
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
