"""Intervals of feasible torques, stiffnesses and angles.

At an angle the torques are an interval, [T(lo1, hi2), T(hi1, lo2)]; at an angle and a torque the stiffnesses are one,
whose ends lie where the torque level leaves the box of pressures (`allocator.joint.torque_levels`) unless the stiffness
turns on the way. At an angle and a stiffness the torques may be several intervals. The feasible angles of a stiffness
lie between the zeros of its margin within the interval.

`limits` and `stiffness` are those of `allocate`, without a slew limit and a tolerance: a stiffness is inside its
interval if and only if `allocate` reaches it. With free valves an interval of stiffnesses extends from the least to the
greatest over all states of the valves, and may have gaps.

If the fit of a joint could not identify the pressures at which its cables go slack (`AntagonistJoint.slack_assumed`),
ends set by a slack limit are assumptions, and `AssumedSlack` warns once. If a muscle was fitted to forces and the
pressures at an angle leave the region in which it was measured, `Extrapolated` warns once.
"""

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.allocation.status import CLOSED_FORM
from allocator.allocation.two_muscles import reach
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array, Mask
from allocator.errors import notice_once
from allocator.feasibility.setting import Setting, spans
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.assumption import AssumedSlack, Extrapolated, assumption, visits
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.joint.torque_levels import Pair
from allocator.joint.torque_levels import torque_interval as torque_interval_in
from allocator.muscles.measured import extrapolation


def torque_interval(
    theta: ArrayLike,
    *,
    joint: AntagonistJoint | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
) -> Pair:
    """Return the feasible torques (T_min, T_max) [N·m] at the angles `theta` [rad].

    Two arrays of the shape of `theta`; NaN beyond the joint range and where the limits contradict each other (no
    pressure keeps a cable taut). Closed form, or one root search per muscle without one. The limits are those of
    `allocator.allocate`. Raises InvalidInput for invalid arguments.
    """
    setting = _setting(joint, limits, stiffness)
    problem, asked = setting.problem(theta)
    none = problem.box.empty | (problem.theta != asked.ravel())
    _tell_extrapolation(problem, *_corners(problem))
    return _shaped(asked.shape, none, *torque_interval_in(problem.sides, problem.box))


def stiffness_interval(
    theta: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    joint: AntagonistJoint | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
) -> Pair:
    """Return the feasible stiffnesses (K_min, K_max) [N·m/rad] at the angles `theta` [rad] and the torques `T` [N·m].

    Broadcasts; every stiffness in between is feasible as well. NaN where the torque is out of reach, beyond the joint
    range and where the limits contradict each other. Closed form, or root search for muscles without one. The limits
    are those of `allocator.allocate`. Raises InvalidInput for invalid arguments.
    """
    setting = _setting(joint, limits, stiffness)
    asked, T = checks.broadcast(theta=checks.angle("theta", theta), T=checks.real("T", T, "N·m"))
    found = setting.columns(asked, T)
    none = ~found.exists | (found.problem.theta != asked.ravel())
    _tell_extrapolation(found.problem, found.low, found.high)
    return _shaped(asked.shape, none, found.K_min, found.K_max)


def torque_intervals(
    theta: ArrayLike,
    K: ArrayLike,
    *,
    joint: AntagonistJoint | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
) -> Pair:
    """Return all intervals of feasible torques [N·m] at the angles `theta` [rad] with the stiffness `K`.

    Returns
    -------
    low, high
        Ends of the intervals, (m, …), rising: m the greatest number of intervals that one of the broadcast targets
        has, NaN where a target has fewer; m = 0 where none has any. One for affine muscles on a pulley; on a lever
        the stiffness [N·m/rad] may turn with the pressure, and the torques fall into up to three.
    """
    setting = _setting(joint, limits, stiffness)
    asked, K = checks.broadcast(theta=checks.angle("theta", theta), K=checks.stiffness("K", K))
    states = [_torque_intervals(state, asked, K) for state in setting.states]
    found = states[0] if len(states) == 1 else _merged(np.concatenate(states, axis=1))
    found = found[:, ~np.isnan(found[..., 0]).all(axis=0)]
    low, high = (found[..., end].T.reshape(-1, *asked.shape) for end in (0, 1))
    return low, high


def _torque_intervals(setting: Setting, asked: Array, K: Array) -> Array:
    """Return the intervals (n, m, 2) [N·m] for one state of the valves, NaN where a target has fewer."""
    problem, _ = setting.problem(asked, 0.0, K)
    K_min, K_max = (problem.stiffness(*pair) for pair in reach.stiffness_range(problem))
    beyond = np.maximum(K_min - problem.K, problem.K - K_max) > CLOSED_FORM.met * problem.scales[1]
    found = reach.torque_intervals(problem, problem.K)  # (n, m, 2)
    _tell_extrapolation(problem, *_corners(problem))
    found[beyond | problem.box.empty | (problem.theta != asked.ravel())] = np.nan
    return found


def _merged(intervals: Array) -> Array:
    """Return the union of the intervals (n, m, 2) of each target, rising and apart, NaN behind."""
    order = np.argsort(intervals[..., 0], axis=1)  # NaN goes last
    intervals = np.take_along_axis(intervals, order[..., None], 1)
    low, high = intervals[..., 0], np.fmax.accumulate(intervals[..., 1], axis=1)
    start = np.ones(low.shape, bool)
    start[:, 1:] = low[:, 1:] > high[:, :-1]
    start &= ~np.isnan(low)
    merged = np.full(intervals.shape, np.nan)
    for i, starts in enumerate(start):
        at = np.flatnonzero(starts)
        merged[i, : at.size, 0] = low[i, at]
        merged[i, : at.size, 1] = high[i, np.append(at[1:], int((~np.isnan(low[i])).sum())) - 1] if at.size else np.nan
    return merged


def angle_interval(
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    joint: AntagonistJoint | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
) -> Pair:
    """Return the widest interval of angles [rad] throughout which `K` [N·m/rad] and `T` [N·m] are feasible.

    Broadcasts; NaN if there is no such angle. On a pulley with two equal muscles it is the only one; otherwise there
    may be several, see `angle_intervals`, also for the limits of accuracy.
    """
    left, right = angle_intervals(K, T, joint=joint, limits=limits, stiffness=stiffness)
    if not len(left):
        return _shaped(left.shape[1:], True, np.nan, np.nan)
    widest = np.argmax(np.where(np.isnan(left), -np.inf, right - left), axis=0)[None]
    return _shaped(left.shape[1:], False, *(np.take_along_axis(ends, widest, 0) for ends in (left, right)))


def angle_intervals(
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    joint: AntagonistJoint | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
) -> Pair:
    """Return all intervals of angles [rad] throughout which `K` [N·m/rad] and `T` [N·m] are feasible.

    Returns
    -------
    left, right
        Ends of the intervals, (m, …): m the greatest number of intervals that one of the broadcast targets has, NaN
        where a target has fewer; m = 0 where none has any. Their ends are roots, exact to rounding. Intervals, and
        gaps between them, narrower than 1/128 of the joint range may be missed.
    """
    setting = _setting(joint, limits, stiffness)
    K, T = checks.broadcast(K=checks.stiffness("K", K), T=checks.real("T", T, "N·m"))
    found = spans(lambda x, K, T: margin(setting, x, K, T), *setting.joint.angle_range, K.ravel(), T.ravel())
    for ends in found:
        if (there := ends[~np.isnan(ends)]).size:
            problem, _ = setting.problem(there)
            _tell_extrapolation(problem, *_corners(problem))
    return found[0].reshape(-1, *K.shape), found[1].reshape(-1, *K.shape)


def margin(setting: Setting, theta: Array, K: Array, T: Array) -> Array:
    """Return the margin of (K, T) within the feasible set at θ, in fractions of the scales; continuous, < 0 outside.

    With free valves, in the state with the greatest margin.
    """
    return np.asarray(np.max([_margin_of_state(state, theta, K, T) for state in setting.states], axis=0))


def _margin_of_state(setting: Setting, theta: Array, K: Array, T: Array) -> Array:
    theta, K, T = np.broadcast_arrays(theta, K, T)
    found = setting.columns(theta, T)
    scale = found.problem.scales[1]
    inside = np.minimum(K.ravel() - found.K_min, found.K_max - K.ravel()) / scale
    inside = np.minimum(inside, found.reach) + CLOSED_FORM.met
    return np.where(found.empty, -1.0, inside).reshape(theta.shape)


def _setting(joint: AntagonistJoint | None, limits: Limits, stiffness: Stiffness) -> Setting:
    """Return the setting; warn once of assumed slack limits."""
    setting = Setting.of(joint, limits, stiffness)
    if limits.min_force is not None and (assumed := assumption(setting.joint)):
        notice_once(f"{assumed}; so are the ends of intervals that a slack limit sets", AssumedSlack)
    return setting


def _corners(problem: Problem) -> tuple[Pair, Pair]:
    """Return the pressures [Pa] of the least and of the greatest torque."""
    one, two = problem.box.agonist, problem.box.antagonist
    return (one.lo, two.hi), (one.hi, two.lo)


def _tell_extrapolation(problem: Problem, *pairs: Pair) -> None:
    """Warn once if these pairs of pressures (n,) lie beyond a muscle's measured region."""
    at = [visits(problem.joint, problem.theta, P1, P2) for P1, P2 in pairs]
    if said := next(filter(None, (extrapolation(pair, counted=False) for pair in at)), ""):
        notice_once(f"{said}; intervals reach pressures or angles where it is", Extrapolated)


def _shaped(shape: tuple[int, ...], none: Mask | bool, *ends: Array | float) -> Pair:
    """Return the ends in the shape of the arguments, NaN where `none` is set; floats for a scalar call."""
    size = int(np.prod(shape))
    low, high = (np.broadcast_to(np.where(none, np.nan, end).ravel(), size).reshape(shape)[()] for end in ends)
    return low, high
