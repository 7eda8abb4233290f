"""Runs and their figures."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from allocator.units import DEG
from benchmarks.closed_loop.cases import ALONE, CASES, EVERY, LOAD, PLACED, PLANTS, SETTINGS, VARIANTS, Case
from mpc import Run, Rung, simulate
from mpc.model.real import RealPlant
from mpc.observer.base import Differentiator, Observer
from mpc.trials.loops import Settings, loop
from mpc.trials.metrics import metrics
from mpc.trials.motions.trajectories import LEAD
from mpc.trials.simulation import Controller
from mpc.yardsticks.baselines import PIDControl

UNSTABLE = 45.0  # [°] of error: more than that of a motionless joint, as no trajectory exceeds 40°
STEADY = 1.0  # [s] at the end of a run, where the reference rests
CONTROLLERS = ("mpc", "pid", "predictive-pid", "lqr", "feedforward")
RUNGS = tuple(rung.name for rung in Rung)
FEW = ("mpc", "pid", "predictive-pid")  # on plants with few runs


@dataclass(frozen=True)
class Figures:
    """Figures of a run."""

    rms: float  # [°]
    worst: float  # [°]
    rms_with_load: float  # [°]
    worst_with_load: float  # [°]
    K_rms: float  # [N·m/rad], of the true stiffness, without the first rest
    steady_mean: float  # [°] size of the mean error in the last second
    steady_swing: float  # [°] peak to peak there
    limits_exceeded: int  # number of broken limits in `Metrics.violations`, without slack
    slack: float  # [N] greatest slack of a muscle
    air: float  # [bar] filled into both muscles after the first rest, see `benchmarks.closed_loop`
    step_median: float  # [ms]
    step_p99: float  # [ms]
    rungs: tuple[int, ...]  # number of steps by each of RUNGS

    @property
    def unstable(self) -> bool:
        """Whether the loop was unstable, which makes the other figures meaningless."""
        return not self.worst_with_load <= UNSTABLE


def run_case(plant: RealPlant, case: Case, controller: Controller, observer: Observer, seed: int) -> Run:
    """Return a run with the case's load."""
    loaded = replace(plant, torque_profile=((case.load_from, LOAD),))
    return simulate(loaded, controller, case.reference, observer=observer, seed=seed)


def figures(name: str, run: Run) -> Figures:
    """Return the figures of a run of the case called `name`."""
    case, m = CASES[name], metrics(run)
    begin = round(LEAD / run.dt)
    end = round(case.load_from / run.dt) if case.before_load else run.t.size
    error = (run.theta - run.theta_ref) / DEG
    last = error[-round(STEADY / run.dt) :]
    broken = [limit for limit, (excess, _) in m.violations.items() if excess and limit != "slack muscle"]
    return Figures(
        *_rms_and_worst(error[begin:end]),
        *_rms_and_worst(error[begin:]),
        _rms_and_worst((run.K - run.K_ref)[begin:])[0],
        abs(float(last.mean())),
        float(np.ptp(last)),
        len(broken),
        m.violations["slack muscle"][0],
        filled(run.P[begin:]),
        m.step_median,
        m.step_p99,
        tuple(m.rungs[name] for name in RUNGS),
    )


def filled(P: np.ndarray) -> float:
    """Return the sum of the rises of the pressures `P` (n, 2) [Pa], in bar."""
    return float(np.maximum(np.diff(P, axis=0), 0.0).sum()) / 1e5


def _rms_and_worst(error: np.ndarray) -> tuple[float, float]:
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


class Row(NamedTuple):
    """One run."""

    plant: str
    case: str
    controller: str
    seed: int
    figures: Figures


class Job(NamedTuple):
    """Runs of one controller on one plant."""

    plant: str
    controller: str
    cases: tuple[str, ...]
    seeds: range


class Effort(NamedTuple):
    """Numbers of seeds."""

    standard: int = 20  # the standard plant
    gains: int = 6  # the same with other errors of the muscles' strength
    others: int = 2  # variants and single effects, on two trajectories


QUICK = Effort(1, 1, 1)


def jobs(effort: Effort, first: int) -> Iterator[Job]:
    """Return all runs, with seeds from `first`."""
    for name in PLANTS:
        count = effort.standard if name == "standard" else effort.gains
        yield from (Job(name, c, tuple(CASES), range(first, first + count)) for c in CONTROLLERS)
    few = range(first, first + effort.others)
    for name in VARIANTS | ALONE:
        yield from (Job(name, c, ("sine", "min-jerk"), few) for c in FEW)
    yield from (Job("standard", c, tuple(CASES), few) for c in PLACED)


def rows(job: Job) -> list[Row]:
    """Return the runs of a job; the controller is built once."""
    tested = EVERY[job.plant]
    driver = _driver(job.controller, SETTINGS._replace(N=tested.N, compensation=tested.told))
    return [
        Row(job.plant, case, job.controller, seed, figures(case, run_case(tested.real, CASES[case], *driver, seed)))
        for case in job.cases
        for seed in job.seeds
    ]


def _driver(name: str, settings: Settings) -> tuple[Controller, Observer]:
    if name not in PLACED:
        return loop(name, settings)
    return PIDControl(settings.plant, settings.dt, settings.compensation, PLACED[name]), Differentiator(settings.dt)
