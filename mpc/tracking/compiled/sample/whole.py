"""Whole step in one compiled call, which has its own flat copy of the state of a controller's parts.

The stages of `mpc.tracking.base` make steps that are not ordinary; the flat state is then copied from the parts. The
parts get the flat state when one of their attributes is accessed.
"""

from collections.abc import Callable
from functools import partial
from math import inf
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.compensation import FrictionState
from mpc.model.compiled_friction import numbers_of_joints
from mpc.model.machine import Machine
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.compiled.sample.arrays import Beyond, StepArrays
from mpc.tracking.compiled.sample.layout import State
from mpc.tracking.compiled.sample.stages import WHOLE
from mpc.tracking.fallback import Ladder
from mpc.tracking.linearise import Motion
from mpc.tracking.plan import Moved, Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Preview
from mpc.tracking.rest import RestMode

_FLOAT = np.dtype(float)


class Parts(NamedTuple):
    """Parts of a controller that have a memory."""

    preview: Preview
    ladder: Ladder
    rest_mode: RestMode
    rest: bool  # whether the commands may come to rest
    plant: Machine


class Newest:
    """Result of the last whole step (`mpc.tracking.compiled.sample.layout`), including the state."""

    def __init__(self, arrays: StepArrays, stiffness: Callable[[Array], Array]) -> None:
        self.out, self._arrays, self._stiffness = arrays.nothing, arrays, stiffness
        self.known = False  # whether a part was accessed and has this state now

    @property
    def motion(self) -> Motion:
        """Motion of the plan."""
        made = self._arrays.made(self.out)
        return Motion(made.u, made.x, self._stiffness(made.K), made.F)

    @property
    def state(self) -> State:
        """Views into the state."""
        return self._arrays.state(self.out)

    def defer(self, parts: Parts) -> None:
        """Defer the update of the parts with the newest state until they are accessed."""
        preview, ladder, rest_mode, rest, _ = parts
        preview.defer(_fill_preview, self, preview.frictions)
        ladder.defer(_fill_ladder, self)
        if rest_mode.worthwhile and rest:
            rest_mode.defer(_fill_rest_mode, self)
        self.known = False


def _fill_preview(preview: Preview, newest: Newest, frictions: tuple[FrictionState, ...]) -> None:
    """Update `preview` with the newest sample."""
    state, newest.known = newest.state, True
    if not preview.frictionless:
        for friction, angle, memory in zip(frictions, state.angle.tolist(), state.memory, strict=True):
            friction.go_on(angle, memory[: friction.friction.size])
    preview.go_on(state.sent.copy(), state.expected.copy(), list(state.waiting.copy()), frictions)


def _fill_ladder(ladder: Ladder, newest: Newest) -> None:
    """Update `ladder` with the newest sample."""
    newest.known = True
    ladder.go_on(newest.motion, newest.state.u_star.copy())


def _fill_rest_mode(rest_mode: RestMode, newest: Newest) -> None:
    """Update `rest_mode` with the newest sample."""
    newest.known = True
    rest_mode.go_on(newest.state.rest)


def joined(qp_step: CompiledQPStep, feed_forward: CompiledFeedForward, parts: Parts) -> "WholeStep | None":
    """Return the whole step of these parts, or None if a part of it is not compiled."""
    beyond = beyond_of(parts)
    return WholeStep(qp_step, feed_forward, parts, beyond) if beyond and feed_forward.whole else None


def beyond_of(parts: Parts) -> Beyond | None:
    """Return what the parts know beyond the model, or None for friction that is not compiled."""
    preview, rest_mode = parts.preview, parts.rest_mode
    frictions = numbers_of_joints([state.friction for state in preview.frictions])
    if frictions is None:
        return None
    rests, gate = parts.rest and rest_mode.worthwhile, (preview.lower, preview.upper)
    return Beyond(gate, frictions, preview.delay, preview.compensation.dead_band, rests, rest_mode.rules)


def take(state: State, parts: Parts) -> None:
    """Copy the memory of the parts into a flat `state`."""
    preview, ladder, rest_mode, *_ = parts
    u = None if ladder.motion is None else ladder.motion.u
    state.memory[...] = 0.0
    for friction, memory, angle in zip(preview.frictions, state.memory, range(state.angle.size), strict=True):
        memory[: friction.friction.size] = friction.memory
        state.angle[angle] = np.nan if friction.theta is None else friction.theta
    for array, value in (
        (state.u, u), (state.u_star, ladder.u_star), (state.sent, preview.last_sent),
        (state.waiting, preview.waiting or None), (state.expected, preview.expected),
        (state.rest, rest_mode.numbers),
    ):  # fmt: skip
        array[...] = np.nan if value is None else value


class WholeStep:
    """Whole step of one controller and its parts, with what is known `beyond` the model."""

    def __init__(
        self, qp_step: CompiledQPStep, feed_forward: CompiledFeedForward, parts: Parts, beyond: Beyond
    ) -> None:
        self.qp_step, self.feed_forward, self.beyond = qp_step, feed_forward, beyond
        self.module = qp_step.plant.step
        self._parts, self.rest, plant = parts, parts.rest, parts.plant
        self._arrays = arrays = self.arrays()
        self._step, self._table, self._size, self._d = arrays.step, arrays.address, arrays.nothing.size, arrays.ask.d
        samples = (arrays.ask.theta.size // plant.n,)
        self._single, constant = plant.angle_shape == (), (plant.angle_shape, plant.stiffness_shape)
        self._shapes = (plant.size,), *((*samples, *shape) for shape in constant)
        self._values = (plant.size,), *constant  # shapes without previews
        self._newest = Newest(arrays, qp_step.plant.stiffness)
        self._fields = partial(_fields, arrays, plant)
        self.behind = True  # whether the flat state is older than that of the parts

    def arrays(self) -> StepArrays:
        """Return new arrays of the step."""
        N = self._parts.ladder.predictor.N
        return StepArrays(self.qp_step.plant, N, self.qp_step.structured, self.feed_forward.feeding, self.beyond)

    def plan(self, x: Any, theta_ref: Any, K_ref: Any, d: Any, began: float, deadline: float) -> Plan | None:
        """Return the plan of an ordinary step by the `deadline`; if there is none, change nothing and return None."""
        newest, (state, angles, stiffnesses) = self._newest, self._shapes
        if self.behind:
            self._take()
        try:
            if not (
                x.__class__ is theta_ref.__class__ is K_ref.__class__ is np.ndarray
                and x.dtype is theta_ref.dtype is K_ref.dtype is _FLOAT
                and x.shape == state
                and theta_ref.shape == angles
                and K_ref.shape == stiffnesses
            ):
                x, theta_ref, K_ref = self._numbers(x, theta_ref, K_ref)
            if d.__class__ is float:
                self._d.fill(d)
            else:
                self._d[:] = self._torque(d)
        except (InvalidInput, ValueError, TypeError):
            return None  # the readable stages report the error
        if not self._single:
            theta_ref, K_ref = theta_ref.ravel(), K_ref.ravel()
        guess = None if deadline == inf else self.qp_step.active_set
        out = np.empty(self._size)
        if not self._step(WHOLE, self._table, newest.out, out, x, theta_ref, K_ref):
            return None
        now = perf_counter()
        if now > deadline:
            self.qp_step.active_set = guess
            return None
        newest.out = out
        if newest.known:
            newest.defer(self._parts)
        self.behind = False
        return Plan.later(self._fields, out, now - began)

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

    def _numbers(self, *given: object) -> tuple[Array, ...]:
        """Return the state (2n + m,) and the previews (ahead + 1, …) as arrays of floats, from any kind of numbers.

        Raises `InvalidInput`, `ValueError` or `TypeError`.
        """
        ask, found = self._arrays.ask, []
        places = zip((ask.x, ask.theta, ask.K), given, self._shapes, self._values, strict=True)
        for array, numbers, shape, value in places:
            known = checks.floats("a number", numbers, "")
            if known.shape not in (shape, value):
                raise InvalidInput("a shape is wrong")
            array = array.reshape(shape)
            array[...] = known
            found.append(array)
        return tuple(found)

    def _torque(self, d: object) -> Array:
        """Return the torque (n,) or (). Raises `InvalidInput`, `ValueError` or `TypeError`."""
        known = checks.floats("d", d, "N·m")
        if known.shape not in ((), self._values[1]):
            raise InvalidInput("a shape is wrong")
        return known

    def _take(self) -> None:
        """Take the state from the parts."""
        newest = self._newest
        newest.out, newest.known = self._arrays.nothing.copy(), True
        take(newest.state, self._parts)


def _fields(arrays: StepArrays, plant: Machine, out: Array, took: float) -> dict[str, object]:
    """Return the fields of the plan that was made."""
    made = arrays.made(out)
    (slack, slack_force), (theta, K, T), (feed_forward, linearise, solve), (rests,) = map(np.ndarray.tolist, made[5:])
    status, rung = (PlanStatus.RESTING, Rung.ALLOCATION) if rests else (PlanStatus.OPTIMAL, Rung.QP)
    stiffness = plant.matrix(made.K[:, 0] if plant.angle_shape == () else made.K)
    return {
        "u": made.sent, "x": made.x, "K": stiffness, "status": status, "rung": rung, "slack": slack,
        "times": Times(feed_forward, linearise, 0.0, solve, took), "slack_force": slack_force,
        "moved": Moved(theta, K, T), "gap": 0.0,
    }  # fmt: skip
