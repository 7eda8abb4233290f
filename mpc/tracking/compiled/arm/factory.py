"""The factory makes what an arm's controller works with: compiled where that can be had, and else readable."""

from math import inf
from typing import Any

import numpy as np

from allocator.notices import notice
from mpc.model.arm.model import Arm
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.linearise import Predictor
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.solvers import DAQP
from mpc.tracking.qp.step import PreviousSample, QPStep, ReadableQPStep, SlowStep


def arm_parts(
    arm: Arm, dt: float, problem: TrackingProblem, predictor: Predictor, feed_forward: InverseDynamics
) -> tuple[QPStep, Any]:
    """Return the compiled step and feed-forward, ready; the readable ones, with a `SlowStep` warning, where compiling
    fails.
    """
    ready = feed_forward.ready()
    if arm.unformulated or arm.gas is not None:
        why = arm.unformulated or "with gas the motion moves the pressures"
        notice(f"the controller's step is not compiled and takes longer: {why}", SlowStep)
        return ReadableQPStep(problem, predictor), ready
    try:
        from mpc.tracking.compiled.arm.module import compiled_arm
        from mpc.tracking.compiled.arm.qp_step import CompiledArmFeedForward, CompiledArmQPStep

        made = compiled_arm(arm, dt)
        redundant = arm.tracked < arm.n  # K_x is not linear in the pressures then
        feed: Any = ready if redundant else CompiledArmFeedForward(arm, made, ready)
        step = CompiledArmQPStep(arm, dt, made, problem)
        _compile(arm, problem, step, feed)
        return step, feed
    except (
        Exception
    ) as failure:  # no compiler, no place for its work, a formula too long, or a fault of the compiler's own
        reason = (str(failure).strip() or type(failure).__name__).splitlines()[0]
    notice(f"the controller's step is not compiled and takes some ten times as long: {reason}", SlowStep)
    return ReadableQPStep(problem, predictor), ready


def _compile(arm: Arm, problem: TrackingProblem, step: Any, feed_forward: Any) -> None:
    """Compile now, and not when the arm is waiting for its first command."""
    N = sum(problem.blocks)
    P = np.full(arm.m, np.mean(problem.limits.pressure))
    x = np.concatenate([arm.middle, np.zeros(arm.n), P])
    K, d = np.diag(np.diag(arm.tracked_stiffness(x))), np.zeros((N + 1, arm.n))
    feed = feed_forward(np.tile(x[: arm.n], (N + 1, 1)), np.tile(K, (N + 1, 1, 1)), d)
    step(x, np.tile(P, (N, 1)), d[:-1], feed, PreviousSample(P, P), DAQP(), inf)
    step.whole_qp()
