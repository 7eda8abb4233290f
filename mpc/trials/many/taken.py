"""The flat values of a compiled closed loop are taken from the readable parts here, after their first samples."""

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.rest import RestMode
from mpc.trials.many import rest
from mpc.trials.many.records import Known, Memory, Step


def ordinary(controller: TrackingMPC) -> bool:
    """Return whether what the readable parts remember has its place in the flat values."""
    preview, ladder = controller._preview, controller.ladder
    return (
        (preview.friction.theta is not None or preview.frictionless)
        and ladder.motion is not None
        and ladder.u_star is not None
        and preview._blind == 0
    )


def known_of(controller: TrackingMPC, c: Array) -> Known:
    """Return what is known of the controller; `c` are the numbers of the formulas."""
    preview, mode, limits = controller._preview, controller.rest_mode, controller.limits
    assert isinstance(mode, RestMode)  # `driving` has looked
    resting = [0.0] * 8
    resting[rest.INERTIA], resting[rest.DT] = mode.plant.inertia, mode.dt
    resting[rest.SETTLING], resting[rest.DWELL] = mode.settling, mode.dwell
    resting[rest.SHORTEST], resting[rest.LONGEST] = mode.quarter_range
    resting[rest.DEAD_BAND], resting[rest.HIGHEST] = mode.compensation.dead_band, mode.limits.pressure[1]
    return Known(
        c, preview.lower, preview.upper, preview.delay, preview.frictionless, controller.rest and mode.worthwhile,
        float(controller.compensation.dead_band), (*limits.pressure, limits.step, *limits.theta, limits.min_force),
        _floats(resting),
    )  # fmt: skip


def step_of(controller: TrackingMPC) -> Step:
    """Return what the compiled step takes; its buffers are the controller's own."""
    qp_step, feed_forward = controller._qp_step, controller._feed_forward
    assert isinstance(qp_step, CompiledQPStep)  # `driving` has looked
    assert isinstance(feed_forward, CompiledFeedForward)
    structured = qp_step.structured
    c, p, known, slopes = feed_forward.arrays.fixed
    numbers, starts, given, buffer = structured.arrays
    return Step(
        structured.address, c, qp_step.plant.h, qp_step.plant.substeps, numbers, starts, given, buffer,
        structured.guess, structured._shifted, structured.z, p, known, slopes, np.empty(feed_forward.arrays.size),
    )  # fmt: skip


def memory_of(controller: TrackingMPC) -> Memory:
    """Return what the controller remembers; copies."""
    preview, ladder, mode = controller._preview, controller.ladder, controller.rest_mode
    assert isinstance(mode, RestMode)  # `driving` has looked
    assert ladder.motion is not None  # `ordinary` has looked
    mode.catch_up()
    expected = np.nan if preview.expected is None else preview.expected[0]
    followed = np.nan if preview.friction.theta is None else preview.friction.theta
    memory = _floats(np.atleast_1d(preview.friction.memory))
    waiting = _floats(preview.waiting).reshape(-1, 2)
    return Memory(
        waiting, _floats(preview.last_sent), _floats([expected]), memory, _floats([followed]), _floats(ladder.motion.u),
        _floats(ladder.u_star), _rest(mode), mode.reference.copy(), _floats(mode._p), mode._quarters.copy(),
        mode._sum.copy(),
    )  # fmt: skip


def _rest(mode: RestMode) -> Array:
    s = np.zeros(14)
    s[rest.SINCE], s[rest.TORQUE], s[rest.ERROR], s[rest.FREE] = mode._since, mode._torque, mode._error, mode._free
    s[rest.SIDE], s[rest.RINGS], s[rest.QUARTER], s[rest.RESTS] = mode.side, mode.ringing, mode._quarter, mode.resting
    s[rest.SAMPLES], s[rest.COUNTED], s[rest.SWUNG] = mode._samples, mode._counted, mode._swings
    s[rest.IN_SUM], s[rest.LEAST], s[rest.MOST] = mode._in_sum, mode._low, mode._high
    return s


def _floats(given: ArrayLike | None) -> Array:
    return np.array(given, float)
