"""Whole compiled step of a baseline of a joint, for `mpc.trials.many`: `mpc.tracking.compiled.step` without a QP."""

import numpy as np

from allocator.calculus import Array
from mpc.model.plant import NU, NX, Plant
from mpc.tracking.compiled.qp_step import CompiledFeedForward
from mpc.tracking.compiled.records import bounds_of
from mpc.tracking.compiled.sample.arrays import Beyond, Closed, StepArrays
from mpc.tracking.compiled.sample.layout import Gains
from mpc.tracking.compiled.sample.whole import Parts, beyond_of, take
from mpc.yardsticks.baselines import (
    Baseline,
    FeedForwardControl,
    LQRControl,
    PIControl,
    PIDControl,
    PredictivePIDControl,
)

_KINDS = FeedForwardControl, PIDControl, PIControl, PredictivePIDControl, LQRControl


class ClosedStep:
    """Compiled step of one baseline, its arrays and its memory."""

    def __init__(self, controller: Baseline, feed_forward: CompiledFeedForward, parts: Parts, beyond: Beyond) -> None:
        self._controller, self._parts, self.module = controller, parts, feed_forward.plant.step
        beyond = beyond._replace(closed=Closed(bounds_of(controller.limits), _gains(controller)))
        N = parts.ladder.predictor.N
        self._arrays = StepArrays(feed_forward.plant, N, feeding=feed_forward.feeding, beyond=beyond)

    def arrays(self) -> StepArrays:
        """Return the arrays of the step."""
        return self._arrays

    def remembered(self) -> Array:
        """Return the result and the state of the last step, taken from the controller."""
        out = self._arrays.nothing.copy()
        state = self._arrays.state(out)
        take(state, self._parts)
        for array, value in zip(state.fed, self._controller.remembered, strict=True):
            array[...] = value
        return out


def closed_step(controller: Baseline) -> ClosedStep | None:
    """Return the compiled step of a baseline; None for an arm, a joint without a kernel, unknown friction, and other
    kinds.
    """
    if type(controller) not in _KINDS or not isinstance(controller.plant, Plant):
        return None
    parts = Parts(controller._preview, controller.ladder, controller.rest_mode, False, controller.plant)
    feed_forward, beyond = controller.compile()._feed_forward, beyond_of(parts)
    if not isinstance(feed_forward, CompiledFeedForward) or beyond is None:
        return None
    return ClosedStep(controller, feed_forward, parts, beyond)


def _gains(controller: Baseline) -> Gains:
    """Return the gains of a baseline."""
    dt, none = controller.dt, np.zeros((NU, NX + NU))
    if isinstance(controller, PIDControl):
        k, predicts = controller.gains, isinstance(controller, PredictivePIDControl)
        return Gains(k.proportional, k.integral, k.derivative, dt / (dt + k.filter_time), predicts, dt, none)
    return Gains(0.0, 0.0, 0.0, 0.0, False, dt, controller.gain if isinstance(controller, LQRControl) else none)
