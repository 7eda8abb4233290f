"""The factory makes what a controller works with: compiled where that can be had, and else readable."""

import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from allocator.compilation import beside
from allocator.notices import notice
from allocator.units import BAR
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.tracking.compiled.arm.factory import arm_parts
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.linearise import Predictor
from mpc.tracking.qp.certified import ACCURACY, LAZY_TOLERANCE
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.step import CompilingBeside, QPStep, ReadableQPStep, SlowStep

if TYPE_CHECKING:
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP


class Parts(NamedTuple):
    """The parts are what a `TrackingMPC` works with."""

    qp_step: QPStep
    feed_forward: Any  # `mpc.tracking.base._FeedForwardOf`


def factory(
    plant: Machine,
    dt: float,
    problem: TrackingProblem,
    predictor: Predictor,
    feed_forward: InverseDynamics,
    *,
    wait: bool = True,
    compiled: bool = True,
) -> Parts:
    """Return the compiled parts, ready; the readable ones, with a `SlowStep` warning, where compiling fails.

    Who does not `wait` gets the readable ones, too, with a `CompilingBeside` warning, where nothing is compiled yet and
    another process can do it. Where the joint has no kernel all wait: the search of its optimum has to be compiled;
    and so do arms.
    Unless `compiled` is wanted the readable ones are returned without a word.
    """
    if not compiled:
        return Parts(ReadableQPStep(problem, predictor), feed_forward)
    if isinstance(plant, Arm):
        return Parts(*arm_parts(plant, dt, problem, predictor, feed_forward))
    assert isinstance(plant, Plant)
    try:
        from mpc.tracking.compiled.module import compiled_plant

        made = compiled_plant(plant, dt)
        with nullcontext() if wait or not made.p.size else beside.only_kept():
            inverse = CompiledFeedForward(made, feed_forward) if made.p.size else feed_forward.ready()
            return Parts(CompiledQPStep(made, problem), inverse)
    except beside.NotKept:
        if not beside.begin(made.step.__name__, Path(str(made.step.__file__)).parent, compile_step, plant, dt):
            return factory(plant, dt, problem, predictor, feed_forward)
        notice(_BESIDE, CompilingBeside)
        return Parts(ReadableQPStep(problem, predictor), feed_forward)
    except (
        Exception
    ) as failure:  # no compiler, no place for its work, a formula too long, or a fault of the compiler's own
        reason = (str(failure).strip() or type(failure).__name__).splitlines()[0]
    said = f"the controller's step is not compiled and takes about ten times as long: {reason}"
    notice(said, SlowStep)
    return Parts(ReadableQPStep(problem, predictor, _structured(problem)), feed_forward.ready())


_BESIDE = (
    "another process compiles the controller's step for the next run, some 30 seconds; this run takes the readable "
    "one, about ten times as slow (--wait, or wait=True, waits)"
)


def compile_step(plant: Plant, dt: float) -> None:
    """Compile what controllers of `plant` at the sample time `dt` [s] need, to be kept. Raises `SlowStep`."""
    from mpc.tracking.controller import TrackingMPC

    with warnings.catch_warnings():
        warnings.simplefilter("error", SlowStep)
        TrackingMPC(plant, dt)


def _structured(problem: TrackingProblem) -> "StructuredQP | None":
    """Return the structured QP, None where nothing at all can be compiled: of that `SlowStep` has told."""
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP

    try:
        return StructuredQP(problem)
    except Exception:
        return None


def setting(problem: TrackingProblem) -> Any:
    """Return what the compiled functions have to know of `problem`, a `records.Setting`."""
    from mpc.tracking.compiled.records import Bounds, Cost, Setting

    rows, limits, L = problem.rows, problem.limits, problem.L
    units = np.array([1, 1, 1, 1, BAR, BAR])
    end = (L.T @ L) * np.outer(units, units)
    cost = Cost(rows.x, rows.y, rows.e * BAR**2, rows.rate * BAR**2 / problem.dt**2, end)
    low, high = limits.pressure
    bounds = Bounds(low / BAR, high / BAR, limits.step / BAR, *limits.theta, limits.min_force)
    w = problem.weights
    slack = np.array([w.slack, w.slack_square, w.slack_force, w.slack_force_square])
    return Setting(cost, bounds, problem.curvature, LAZY_TOLERANCE, ACCURACY, slack, problem.starts.astype(np.int64))
