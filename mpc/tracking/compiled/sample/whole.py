"""Whole step in one compiled call, which has its own flat copy of the state of a controller's parts.

The stages of `mpc.tracking.base` make steps that are not ordinary; the flat state is then copied from the parts. The
parts get the flat state when one of their attributes is accessed.
"""

from math import inf
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.compensation import FrictionState
from mpc.model.plant import NX
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.compiled.sample.arrays import Beyond, StepArrays
from mpc.tracking.compiled.sample.layout import Made, State, made_of, state_of
from mpc.tracking.compiled.sample.stages import WHOLE
from mpc.tracking.fallback import Ladder
from mpc.tracking.linearise import Motion
from mpc.tracking.plan import Moved, Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Preview
from mpc.tracking.rest import RestMode

_FLOAT, _STATE = np.dtype(float), (NX,)


class Parts(NamedTuple):
    """Parts of a controller that have a memory."""

    preview: Preview
    ladder: Ladder
    rest_mode: RestMode
    rest: bool  # whether the commands may come to rest


class Newest:
    """Result of the last whole step (`mpc.tracking.compiled.sample.layout`), including the state."""

    def __init__(self, nothing: Array, plan: int, memory: int, delay: int) -> None:
        self.out, self._counts = nothing, (plan, memory, delay)
        self.known = False  # whether a part was accessed and has this state now

    @property
    def made(self) -> Made:
        """Views into the plan."""
        return made_of(self.out[: self._counts[0]])

    @property
    def state(self) -> State:
        """Views into the state."""
        return state_of(self.out, *self._counts)

    def defer(self, parts: Parts) -> None:
        """Defer the update of the parts with the newest state until they are accessed."""
        preview, ladder, rest_mode, rest = parts
        preview.defer(_fill_preview, self, preview.frictions)
        ladder.defer(_fill_ladder, self)
        if rest_mode.worthwhile and rest:
            rest_mode.defer(_fill_rest_mode, self)
        self.known = False


def _fill_preview(preview: Preview, newest: Newest, frictions: tuple[FrictionState, ...]) -> None:
    """Update `preview` with the newest sample."""
    state, newest.known = newest.state, True
    if not preview.frictionless:
        frictions[0].go_on(float(state.angle[0]), state.memory)
    preview.go_on(state.sent.copy(), state.expected.copy(), list(state.waiting.copy()), frictions)


def _fill_ladder(ladder: Ladder, newest: Newest) -> None:
    """Update `ladder` with the newest sample."""
    made, newest.known = newest.made, True
    ladder.go_on(Motion(made.u, made.x, made.K, made.F), newest.state.u_star.copy())


def _fill_rest_mode(rest_mode: RestMode, newest: Newest) -> None:
    """Update `rest_mode` with the newest sample."""
    newest.known = True
    rest_mode.go_on(newest.state.rest)


class WholeStep:
    """Whole step of one controller and its parts, with the `numbers` of the friction."""

    def __init__(
        self, qp_step: CompiledQPStep, feed_forward: CompiledFeedForward, parts: Parts, numbers: Array
    ) -> None:
        self.qp_step, self.feed_forward, self._parts, self.rest = qp_step, feed_forward, parts, parts.rest
        preview, N = parts.preview, parts.ladder.predictor.N
        rests = parts.rest and parts.rest_mode.worthwhile
        beyond = Beyond(numbers, preview.delay, preview.compensation.dead_band, rests, parts.rest_mode.rules)
        gate = preview.lower, preview.upper
        self._arrays = arrays = StepArrays(qp_step.plant, N, qp_step.structured, feed_forward.readable, gate, beyond)
        self._step, self._table, self._size = arrays.step, arrays.address, arrays.nothing.size
        self._shape = arrays.ask.theta.shape
        self._newest = Newest(arrays.nothing, arrays.size, beyond.memory, beyond.delay)
        self.behind = True  # whether the flat state is older than that of the parts

    def plan(self, x: Any, theta_ref: Any, K_ref: Any, d: Any, began: float, deadline: float) -> Plan | None:
        """Return the plan of an ordinary step by the `deadline`; if there is none, change nothing and return None."""
        newest = self._newest
        if self.behind:
            self._take()
        if not (
            d.__class__ is float and x.__class__ is theta_ref.__class__ is K_ref.__class__ is np.ndarray
            and x.dtype is theta_ref.dtype is K_ref.dtype is _FLOAT
            and x.shape == _STATE and theta_ref.shape == K_ref.shape == self._shape
        ):  # fmt: skip
            try:
                x, theta_ref, K_ref, d = self._numbers(x, theta_ref, K_ref, d)
            except (InvalidInput, ValueError, TypeError):
                return None  # the readable stages report the error
        guess = None if deadline == inf else self.qp_step.active_set
        out = np.empty(self._size)
        if not self._step(WHOLE, self._table, newest.out, out, x, theta_ref, K_ref, d):
            return None
        now = perf_counter()
        if now > deadline:
            self.qp_step.active_set = guess
            return None
        newest.out = out
        if newest.known:
            newest.defer(self._parts)
        self.behind = False
        return Plan.later(_fields, self._arrays.size, out, now - began)

    def remembered(self) -> Array:
        """Return the result and the state of the last step, taken from the parts: see `layout`."""
        self.give()
        self._take()
        return self._newest.out

    def give(self) -> None:
        """Give the state to the parts, which continue from it."""
        self.behind = True
        self._parts.preview.catch_up()
        self._parts.ladder.catch_up()
        self._parts.rest_mode.catch_up()

    def _numbers(self, *given: object) -> tuple[Array, Array, Array, float]:
        """Return the state (4,), previews (ahead + 1,) and torque as arrays of floats, from any kind of numbers.

        Raises `InvalidInput`, `ValueError` or `TypeError`.
        """
        ask, constant = self._arrays.ask, ()
        x, theta, K, d = (
            value if value.__class__ is float else checks.floats("a number", value, "") for value in given
        )
        for array, value, other in ((ask.x, x, _STATE), (ask.theta, theta, constant), (ask.K, K, constant)):
            if getattr(value, "shape", constant) not in (array.shape, other):
                raise InvalidInput("a shape is wrong")
            array[...] = value
        return ask.x, ask.theta, ask.K, float(d)

    def _take(self) -> None:
        """Take the state from the parts."""
        newest, (preview, ladder, rest_mode, _) = self._newest, self._parts
        newest.out, newest.known = self._arrays.nothing.copy(), True
        state, (friction,), u = newest.state, preview.frictions, None if ladder.motion is None else ladder.motion.u
        for array, value in (
            (state.u, u), (state.u_star, ladder.u_star), (state.sent, preview.last_sent),
            (state.waiting, preview.waiting or None), (state.expected, preview.expected), (state.angle, friction.theta),
            (state.memory, friction.memory), (state.rest, rest_mode.numbers),
        ):  # fmt: skip
            array[...] = np.nan if value is None else value


def _fields(size: int, out: Array, took: float) -> dict[str, object]:
    """Return the fields of the plan that was made."""
    made = made_of(out[:size])
    (slack, slack_force), (theta, K, T), (feed_forward, linearise, solve), (rests,) = map(np.ndarray.tolist, made[5:])
    status, rung = (PlanStatus.RESTING, Rung.ALLOCATION) if rests else (PlanStatus.OPTIMAL, Rung.QP)
    return {
        "u": made.sent, "x": made.x, "K": made.K, "status": status, "rung": rung, "slack": slack,
        "times": Times(feed_forward, linearise, 0.0, solve, took), "slack_force": slack_force,
        "moved": Moved(theta, K, T), "gap": 0.0,
    }  # fmt: skip
