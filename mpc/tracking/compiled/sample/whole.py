"""The whole step is one compiled call; it has the state of a controller's preview and ladder in flat arrays besides.

What it does not answer, because it is not ordinary, the stages of `mpc.tracking.base` do; the flat state is then taken
from theirs anew.
"""

from math import inf
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.plant import NX
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.compiled.sample.arrays import Beyond, StepArrays
from mpc.tracking.compiled.sample.layout import made_of
from mpc.tracking.fallback import Ladder
from mpc.tracking.linearise import Motion
from mpc.tracking.plan import Moved, Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Preview
from mpc.tracking.rest import RestMode


class Parts(NamedTuple):
    """The parts are those of a controller that remember."""

    preview: Preview
    ladder: Ladder
    rest_mode: RestMode
    rest: bool  # whether the commands may come to rest


class WholeStep:
    """The whole step works for one controller and its parts; of the friction it has the `numbers`."""

    def __init__(
        self, qp_step: CompiledQPStep, feed_forward: CompiledFeedForward, parts: Parts, numbers: Array
    ) -> None:
        self.qp_step, self.feed_forward, self._parts = qp_step, feed_forward, parts
        preview, ladder, rest_mode, self.rest = parts
        N, self._delay = ladder.predictor.N, preview.delay
        rests = parts.rest and rest_mode.worthwhile
        beyond = Beyond(numbers, preview.delay, preview.compensation.dead_band, rests)
        gate = preview.lower, preview.upper
        self._arrays = StepArrays(qp_step.plant, N, qp_step.structured, feed_forward.readable, gate, beyond)
        self._state = self._arrays.memory
        ask, shapes = self._arrays.ask, ((), self._arrays.ask.theta.shape)
        self._ask = (ask.x, ask.theta, ask.K, ask.d), (((NX,),), shapes, shapes, ((),))  # what may have which shapes
        self.behind = True  # whether the flat state is not that of the parts

    def plan(self, x: Any, theta_ref: Any, K_ref: Any, d: Any, began: float, deadline: float) -> Plan | None:
        """Return the plan of an ordinary step by the `deadline`; None, and nothing has changed, if there is none."""
        if self._parts.rest_mode.ringing or not self._asked(x, theta_ref, K_ref, d):
            return None
        if self.behind:
            self._take()
        self.behind = True  # until what was made is used
        guess = None if deadline == inf else self.qp_step.active_set
        done, out = self._arrays.whole()
        now = perf_counter()
        if not done or now > deadline:
            self.qp_step.active_set = guess
            return None
        record = _Record(out, now - began)
        self.qp_step.structured.iterations = int(out[-1])
        self._give(record)
        return Plan.later(record.fields)

    def _asked(self, x: Any, theta_ref: Any, K_ref: Any, d: Any) -> bool:
        """Return whether what is asked has shapes and kinds that can be copied; the readable stages say what is wrong
        with others.
        """
        try:
            for array, shapes, given in zip(*self._ask, (x, theta_ref, K_ref, d), strict=True):
                value = _numbers(given)
                if getattr(value, "shape", ()) not in shapes:
                    return False
                array[...] = value
        except (InvalidInput, ValueError, TypeError):
            return False
        return True

    def _take(self) -> None:
        """Take the state from the parts."""
        state, (preview, ladder, rest_mode, _) = self._state, self._parts
        u = None if ladder.motion is None else ladder.motion.u
        friction, waiting = preview.friction, preview.waiting or None
        for array, value in (
            (state.u, u), (state.u_star, ladder.u_star), (state.sent, preview.last_sent), (state.waiting, waiting),
            (state.expected, preview.expected), (state.angle, friction.theta), (state.memory, friction.memory),
            (state.rest, rest_mode.reference),
        ):  # fmt: skip
            array[...] = np.nan if value is None else value

    def _give(self, record: "_Record") -> None:
        """Give the state to the parts, which have to go on from it where a sample is not ordinary."""
        state, (preview, ladder, rest_mode, _) = self._state, self._parts
        ladder.remember_later(record.motion, state.u_star.copy())
        preview.go_on(state.sent.copy(), state.expected.copy(), list(state.waiting.copy()) if self._delay else [])
        if not preview.frictionless:
            preview.friction.go_on(float(state.angle[0]), state.memory)
        if rest_mode.worthwhile and self.rest:
            rest_mode.go_on(state.rest)
        self.behind = False


class _Record:
    """A record is what a whole step has made, of which a plan is made when somebody looks at it."""

    __slots__ = ("_out", "_took")

    def __init__(self, out: Array, took: float) -> None:
        self._out, self._took = out, took

    def motion(self) -> Motion:
        """Return the motion under the plan's commands as they act."""
        made = made_of(self._out)
        return Motion(made.u, made.x, made.K, made.F)

    def fields(self) -> dict[str, Any]:
        """Return the fields of the plan."""
        made = made_of(self._out)
        slack, slack_force, theta, K, T, feed_forward, linearise, solve, _ = made.tail.tolist()
        times = Times(feed_forward, linearise, 0.0, solve, self._took)
        return {
            "u": made.sent, "x": made.x, "K": made.K, "status": PlanStatus.OPTIMAL, "rung": Rung.QP, "slack": slack,
            "times": times, "slack_force": slack_force, "moved": Moved(theta, K, T),
        }  # fmt: skip


def _numbers(given: Any) -> Any:
    """Return what is `given` as something that can be copied into an array, or raise."""
    if given.__class__ is float or (given.__class__ is np.ndarray and given.dtype == np.float64):
        return given
    return checks.floats("a number", given, "SI unit")


__all__ = ["WholeStep"]
