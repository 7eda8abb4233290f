"""Standard trajectories of the closed-loop benchmark, with rests at both ends, in which a loop settles.

Angles in rad, stiffness in N·m/rad, times in s. The first rest of `LEAD` seconds lets a controller identify the error
of its model.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from allocator import allocate, checks
from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from allocator.units import DEG
from mpc.trials.motions.reference import Reference, min_jerk, sine, times

LEAD = 4.0  # [s] first rest
_DT = 0.01  # [s] between samples
_SAFE = 10.0  # [N·m/rad] at which every trajectory is positive
_UNITS = dict.fromkeys(("time", "rest", "duration"), "s") | dict.fromkeys(("low", "high"), "Hz")
_UNITS |= dict.fromkeys(("K", "height"), "N·m/rad") | dict.fromkeys(("angle", "theta", "amplitude"), "rad")
_CHECKS = {"rest": checks.not_negative, "time": checks.positive, "duration": checks.positive}


def _times(duration: float) -> Array:
    return times(duration, _DT)


def _check(**values: float) -> None:
    """Refuse numbers that are not finite, and durations that are not positive; a rest may be 0."""
    for name, value in values.items():
        _CHECKS.get(name, checks.number)(name, value, _UNITS[name])


def rested_sine(K: float = 5.5, duration: float = 10.0) -> Reference:
    """Return ±40° at 0.5 Hz with K ± 0.3 at 0.25 Hz."""
    moving = sine(K=K, duration=duration, dt=_DT)
    rest = _times(LEAD)[:-1]
    still = np.zeros_like(rest)
    return Reference(
        np.concatenate([rest, LEAD + moving.t]),
        np.concatenate([still, moving.theta]),
        np.concatenate([still + K, moving.K]),
    )


def point_to_point(K: float = 5.5, angle: float = 60 * DEG, time: float = 1.0, rest: float = 2.0) -> Reference:
    """Return a path from -angle/2 to angle/2 and back, each with minimum jerk in `time`, and a `rest` after each."""
    _check(K=K, angle=angle, time=time, rest=rest)
    t = _times(LEAD + 2 * (time + rest))
    there, back = min_jerk((t - LEAD) / time), min_jerk((t - LEAD - time - rest) / time)
    return Reference(t, angle * (there - back - 0.5), np.full_like(t, K))


def chirp(
    K: float = 5.5,
    amplitude: float = 28 * DEG,
    frequencies: tuple[float, float] = (0.15, 0.55),
    duration: float = 10.0,
) -> Reference:
    """Return a sine of rising frequency [Hz], fading in and out over one second each."""
    low, high = checks.pair("frequencies", frequencies, "has to be two frequencies [Hz]")
    _check(K=K, amplitude=amplitude, low=low, high=high, duration=duration)
    t = _times(LEAD + duration)
    s = np.clip(t - LEAD, 0, duration)
    phase = 2 * np.pi * (low * s + (high - low) * s**2 / (2 * duration))
    fade = min_jerk(s) * min_jerk(duration - s)
    return Reference(t, amplitude * fade * np.sin(phase), np.full_like(t, K))


def steps(K: float = 5.5, angle: float = 20 * DEG, time: float = 0.4, rest: float = 2.5) -> Reference:
    """Return steps to 20°, 40° and 20°, each with minimum jerk over `time` so that every controller can follow."""
    _check(K=K, angle=angle, time=time, rest=rest)
    t = _times(LEAD + 3 * (time + rest))
    edges = LEAD + (rest + time) * np.arange(3)
    levels = sum(sign * min_jerk((t - edge) / time) for edge, sign in zip(edges, (1, 1, -1), strict=True))
    return Reference(t, angle * np.asarray(levels), np.full_like(t, K))


def stiffness_step(
    K: tuple[float, float] = (5.0, 6.0), theta: float = 20 * DEG, time: float = 0.3, rest: float = 2.5
) -> Reference:
    """Return a stiffness step from K[0] to K[1] and back at constant angle, each with minimum jerk over `time`."""
    one, other = checks.pair("K", K, "has to be two stiffnesses [N·m/rad]")
    for value in (one, other):
        _check(K=value, theta=theta, time=time, rest=rest)
    t = _times(LEAD + 2 * (time + rest))
    there, back = min_jerk((t - LEAD) / time), min_jerk((t - LEAD - time - rest) / time)
    return Reference(t, np.full_like(t, theta), one + (other - one) * (there - back))


def stiffness_ramps(K: float = 5.5, height: float = 0.5, theta: float = 20 * DEG, rest: float = 1.5) -> Reference:
    """Return stiffness ramps at `theta`: up by `height` in 2 s, down by twice as much in 1 s, and back in 0.5 s."""
    _check(K=K, height=height, theta=theta, rest=rest)
    stops = np.cumsum([LEAD, 2.0, rest, 1.0, rest, 0.5, rest])
    levels = K + height * np.array([0.0, 1.0, 1.0, -1.0, -1.0, 0.0, 0.0])
    t = _times(float(stops[-1]))
    return Reference(t, np.full_like(t, theta), np.interp(t, stops, levels))


def together(K: float = 5.5, height: float = 0.3, angle: float = 40 * DEG, time: float = 1.0) -> Reference:
    """Return simultaneous motions of angle and stiffness: to `angle` and K + `height` in `time`, to -`angle` and
    K - `height`, and back.
    """
    rest = 1.5
    _check(K=K, height=height, angle=angle, time=time)
    t = _times(LEAD + 3 * (time + rest))
    edges = LEAD + (rest + time) * np.arange(3)
    moves = [turn * min_jerk((t - edge) / time) for edge, turn in zip(edges, (1, -2, 1), strict=True)]
    shape = np.sum(moves, axis=0)
    return Reference(t, angle * shape, K + height * shape)


def jumps(K: float = 5.5, angle: float = 25 * DEG, rest: float = 1.5) -> Reference:
    """Return steps that no joint can follow, to `angle`, to -`angle` and back to 0: commands stay at the slew limit."""
    _check(K=K, angle=angle)
    checks.positive("rest", rest, "s")
    t = _times(LEAD + 3 * rest)
    sample = np.round((t - LEAD) / _DT)  # whole numbers avoid rounding at the edges
    per = round(rest / _DT)
    levels = np.select([sample < 0, sample < per, sample < 2 * per], [0.0, 1.0, -1.0], 0.0)
    return Reference(t, angle * levels, np.full_like(t, K))


def usual_swing(joint: AntagonistJoint) -> float:
    """Return 40° or nine tenths of the range of `joint` to both sides of 0, the smaller one [rad].

    It is 40° if 0 is outside the joint's range.
    """
    left, right = joint.angle_range
    return min(40 * DEG, 0.9 * min(-left, right)) if left < 0 < right else 40 * DEG


def usual_stiffnesses(joint: AntagonistJoint) -> tuple[float, float]:
    """Return the least and greatest stiffness [N·m/rad] that `joint` can have at rest everywhere within its usual
    swing.
    """
    held = allocate(usual_swing(joint) * np.array([-1, -0.5, 0, 0.5, 1]), 1.0, 0.0, joint=joint)
    low, high = held.stiffness_interval
    return float(np.max(low)), float(np.min(high))


def usual_stiffness(joint: AntagonistJoint) -> float:
    """Return the middle [N·m/rad] of the joint's usual stiffnesses."""
    return sum(usual_stiffnesses(joint)) / 2


def shrunk(about: Callable[[float], Reference], K: float, joint: AntagonistJoint) -> Reference:
    """Return the trajectory `about` K [N·m/rad], with swings of angle and stiffness that `joint` can follow.

    Angles are limited to its usual swing, and stiffness to half of the distance from the nearer end of its usual ones
    (half of `K` beyond them), since motion needs some. Smaller swings are unchanged.
    """
    shape = about(_SAFE)
    low, high = usual_stiffnesses(joint)
    most = min(high - K, K - low) / 2
    theta = _limited(shape.theta, usual_swing(joint))
    return Reference(shape.t, theta, K + _limited(shape.K - _SAFE, most if most > 0 else K / 2))


def _limited(values: Array, most: float) -> Array:
    """Return `values`, scaled down if their greatest magnitude is more than `most`."""
    greatest = float(np.abs(values).max())
    return values * (most / greatest) if greatest > most else values


class Standard(NamedTuple):
    """Named standard trajectory."""

    about: Callable[[float], Reference]  # the stiffness K [N·m/rad]
    summary: str


TRAJECTORIES = {
    "sine": Standard(rested_sine, "±40° at 0.5 Hz, K ± 0.3"),
    "min-jerk": Standard(point_to_point, "60° in 1 s, there and back"),
    "chirp": Standard(chirp, "±28°, 0.15 to 0.55 Hz"),
    "steps": Standard(steps, "of 20°, shaped"),
    "stiffness-step": Standard(
        lambda K: stiffness_step((K - 0.5, K + 0.5)), "from K - 0.5 to K + 0.5 and back, at 20°"
    ),
    "stiffness-ramps": Standard(stiffness_ramps, "K ± 0.5 at rest, at 20°"),
    "together": Standard(together, "±40° and K ± 0.3 at once"),
    "jumps": Standard(jumps, "±25° at once, more than a joint can"),
}
"""Standard trajectories by name."""
