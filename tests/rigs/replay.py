"""Closed loop in Python, recorded and replayed in the exported C: equal readings must give equal commands.

`record` drives a plant by Python's observer and controller and stores their readings and answers; the program made of
`CONTROL` reads such a record from a file and writes its own answers to another, and those of `ALLOCATE` and `STIFFNESS`
do the same with targets of the allocation and with postures. Both files hold rows of doubles.
"""

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.export import export
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Process

from .toolchain import Runner, run

_C = Path(__file__).parent / "c" / "replay"
ALLOCATE, CONTROL, STIFFNESS = (_C / f"{name}.c" for name in ("allocate", "control", "stiffness"))
ALLOCATION_COLUMNS = ("P1", "P2", "T", "K", "status", "limits")
STIFFNESS_COLUMNS = ("K", "hysteresis", "gas_1", "gas_2", "loss")
PLAN_COLUMNS = ("u1", "u2", "status", "rung", "slack", "slack_force", "moved_theta", "moved_K", "moved_T")
CONTROL_COLUMNS = (*PLAN_COLUMNS, "verdict_theta", "verdict_P1", "verdict_P2")


class Record(NamedTuple):
    """M steps of a loop."""

    samples: Array  # (M, …): angles, pressures, whether the QP solver must fail, previews of θ and of K's triangles
    answers: Array  # (M, 2m + n + 7): of a joint CONTROL_COLUMNS
    seconds: Array  # (M,) processor time of Python's observer and controller


def record(
    process: Process,
    controller: TrackingMPC,
    observer: KalmanObserver,
    reference: Reference,
    fails: Callable[[int], bool] = lambda k: False,
    seed: int = 0,
) -> Record:
    """Drive `process` along `reference`; `fails(k)` decides at every step whether the QP solver fails."""
    wanted = reference.resampled(controller.dt)
    n, triangle = controller.plant.n, np.triu_indices(controller.plant.n)
    measured = [*range(n), *range(2 * n, controller.plant.size)]
    experiment = process.begin(controller.dt, process.at_rest(wanted.theta[0], wanted.K[0]), seed)
    controller.reset()
    observer.reset()
    samples, answers, seconds = [], [], []
    u = None
    for k in range(wanted.t.size - 1):
        y, preview, failing = experiment.measure(), wanted.preview(k, controller.ahead), fails(k)
        began = process_time()
        x, d = observer.estimate(y, y[2 * n :] if u is None else u)
        plan = controller.step(x, *preview, d)
        seconds.append(process_time() - began)
        u = plan.u[0]
        moved = (0.0, 0.0, 0.0) if plan.moved is None else plan.moved
        theta, K = preview
        if n > 1:
            theta, K = theta.ravel(), K[:, *triangle].ravel()
        samples.append(np.concatenate([y[measured], [failing], theta, K]))
        answers.append([*u, plan.status, plan.rung, plan.slack, plan.slack_force, *moved, *observer.verdicts])
        experiment.advance(u)
    return Record(np.array(samples), np.array(answers), np.array(seconds))


def answered(controller: TrackingMPC, observer: KalmanObserver, samples: Array) -> Array:
    """Return the commands, status, rung and verdicts (M, 2m + n + 2) of an arm's loop in Python for any `samples`."""
    n, m, ahead, u = controller.plant.n, controller.plant.m, controller.ahead + 1, None
    rows, columns = np.triu_indices(n)
    controller.reset()
    observer.reset()
    answers = []
    for sample in samples:
        q, P, rest = sample[:n], sample[n : n + m], sample[n + m + 1 :]
        theta, entries = rest[: ahead * n].reshape(ahead, n), rest[ahead * n :].reshape(ahead, -1)
        K = np.empty((ahead, n, n))
        K[:, rows, columns] = K[:, columns, rows] = entries
        x, d = observer.estimate(np.concatenate([q, np.full(n, np.nan), P]), P if u is None else u)
        plan = controller.step(x, theta, K, d)
        u = plan.u[0]
        answers.append([*u, plan.status, plan.rung, *observer.verdicts])
    return np.array(answers, float)


def in_both_precisions(controller: TrackingMPC, observer: KalmanObserver, out: Path) -> dict[str, Path]:
    """Export controller and observer in double and in single precision below `out`."""
    return {
        precision: export(out / precision, controller=controller, observer=observer, precision=precision)
        for precision in ("double", "single")
    }


def replayed(
    program: Path, rows: Array, columns: tuple[str, ...] | int = CONTROL_COLUMNS, runner: Runner = run
) -> Array:
    """Return the answers (n, …) of `program` to `rows`, with these `columns` or so many."""
    rows.tofile(program.parent / "in")
    runner(program, "in", "out")
    return np.fromfile(program.parent / "out").reshape(-1, columns if isinstance(columns, int) else len(columns))
