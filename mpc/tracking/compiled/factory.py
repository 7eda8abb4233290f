"""Factory of a controller's parts: compiled if possible, otherwise readable."""

import warnings
from collections.abc import Callable
from functools import partial
from math import inf
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allocator.compilation import beside
from allocator.errors import notice
from allocator.presentation.progress import waiting
from allocator.units import BAR
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.feedforward import FeedForwardOf, InverseDynamics
from mpc.tracking.linearise import Predictor
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.step import ACCURACY, CompilingBeside, QPStep, ReadableQPStep, SlowStep

if TYPE_CHECKING:
    from mpc.tracking.compiled.records import Setting
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP


class Parts(NamedTuple):
    """Parts of a `TrackingMPC`."""

    qp_step: QPStep
    feed_forward: FeedForwardOf


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
    """Return the compiled parts; if compilation fails, warn with `SlowStep` and return the readable parts.

    If `wait` is false and nothing is compiled yet, return the readable parts, warn with `CompilingBeside`, and compile
    in another process. A joint without a kernel always waits. If `compiled` is false, return the readable parts without
    a warning.
    """
    structured, readable = None, ReadableQPStep(problem, predictor)
    given = dt, problem, feed_forward
    if not compiled:
        return Parts(readable, feed_forward)
    if isinstance(plant, Arm) and plant.unformulated:
        notice(f"the controller's step is not compiled and takes longer: {plant.unformulated}", SlowStep)
        return Parts(readable, feed_forward.ready())
    try:
        step, patient, build = _of_arm(plant, *given) if isinstance(plant, Arm) else _of_joint(plant, *given)
        with waiting("compiling the controller's step") if wait or patient else beside.only_kept():
            return build()
    except beside.NotKept:
        if not beside.begin(step.__name__, Path(str(step.__file__)).parent, compile_step, plant, dt):
            return factory(plant, dt, problem, predictor, feed_forward)
        notice(_BESIDE.format(*_FOR_ARMS if isinstance(plant, Arm) else _FOR_JOINTS), CompilingBeside)
        return Parts(readable, feed_forward)
    except Exception as failure:  # see `_tell`
        _tell("takes about forty times as long", failure)
        structured = None if isinstance(plant, Arm) else _structured(problem)
    return Parts(ReadableQPStep(problem, predictor, structured), feed_forward.ready())


class Compiling(NamedTuple):
    """Compiled module of a machine, whether to always wait for it, and a function that loads or compiles the parts."""

    step: ModuleType
    patient: bool
    build: Callable[[], Parts]


def _of_joint(plant: Plant, dt: float, problem: TrackingProblem, feed_forward: InverseDynamics) -> Compiling:
    from mpc.tracking.compiled.module import compiled_plant

    made = compiled_plant(plant, dt)

    def build() -> Parts:
        inverse = CompiledFeedForward(made, feed_forward) if made.p.size else feed_forward.ready()
        return Parts(CompiledQPStep(made, problem), inverse)

    return Compiling(made.step, not made.p.size, build)


def _of_arm(arm: Arm, dt: float, problem: TrackingProblem, feed_forward: InverseDynamics) -> Compiling:
    from mpc.tracking.compiled.arm.inverse_dynamics import feed_forward_of
    from mpc.tracking.compiled.arm.module import SizedQP, compiled_arm

    made = compiled_arm(arm, dt)

    def build() -> Parts:
        step = CompiledQPStep(made, problem, partial(SizedQP, arm, dt))
        return Parts(step, feed_forward_of(arm, made, feed_forward))

    return Compiling(made.step, False, build)


def _tell(longer: str, failure: Exception) -> None:
    """Warn of a missing compiler, a cache that is not writable, a formula too long, or a fault of the compiler."""
    reason = (str(failure).strip() or type(failure).__name__).splitlines()[0]
    notice(f"the controller's step is not compiled and {longer}: {reason}", SlowStep)


_BESIDE = (
    "another process compiles the controller's step for the next run, {}; this run takes the one "
    "that is not compiled, about {} times slower (--wait, or wait=True, waits)"
)
_FOR_ARMS, _FOR_JOINTS = ("a minute or two", "thirty"), ("about 30 seconds", "forty")


def compile_step(plant: Machine, dt: float) -> None:
    """Compile and cache the code for controllers of `plant` at the sample time `dt` [s]. Raises `SlowStep`."""
    from mpc.tracking.controller import TrackingMPC

    with warnings.catch_warnings():
        warnings.simplefilter("error", SlowStep)
        TrackingMPC(plant, dt)


def _structured(problem: TrackingProblem) -> "StructuredQP | None":
    """Return the structured QP, or None if nothing can be compiled (`SlowStep` has warned)."""
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP

    try:
        return StructuredQP(problem)
    except Exception:
        return None


def setting(problem: TrackingProblem, in_bar: bool = False) -> "Setting":
    """Return the constants of `problem` for the compiled functions; `in_bar` counts the states' pressures in bar."""
    from mpc.tracking.compiled.records import Cost, Setting, bounds_of

    rows, limits, L = problem.rows, problem.limits, problem.L
    states = rows.x.size
    units = np.ones(states + rows.e.size)
    units[states - rows.e.size if in_bar else states :] = BAR
    end = (L.T @ L) * np.outer(units, units)
    cost = Cost(rows.x * units[:states] ** 2, rows.y, rows.e * BAR**2, rows.rate * BAR**2 / problem.dt**2, end)
    w = problem.weights
    slack = np.array([w.slack, w.slack_square, w.slack_force, w.slack_force_square])
    return Setting(cost, bounds_of(limits), problem.curvature, inf, ACCURACY, slack, problem.starts.astype(np.int64))
