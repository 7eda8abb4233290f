"""Standard trajectories of the closed-loop benchmark: each begins and ends with a rest, in which a loop settles.

Angles in rad, stiffness in N·m/rad, times in s.
"""

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG
from mpc.reference import Reference, sine

_DT = 0.01  # [s] between samples


def min_jerk(s: Array) -> Array:
    """The shape of a movement of least jerk: from 0 to 1 as `s` goes from 0 to 1 (Flash & Hogan 1985)."""
    s = np.clip(s, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def rested_sine(K: float = 5.5, lead: float = 2.0, duration: float = 10.0) -> Reference:
    """±40° at 0.5 Hz with K ± 0.3 at 0.25 Hz, after `lead` seconds of rest."""
    moving = sine(K=K, duration=duration, dt=_DT)
    rest = np.arange(round(lead / _DT)) * _DT
    still = np.zeros_like(rest)
    return Reference(
        np.concatenate([rest, lead + moving.t]),
        np.concatenate([still, moving.theta]),
        np.concatenate([still + K, moving.K]),
    )


def point_to_point(K: float = 5.5, angle: float = 60 * DEG, time: float = 1.0, rest: float = 2.0) -> Reference:
    """From -angle/2 to angle/2 and back, each in `time`, along the path of least jerk, with a rest before and after."""
    t = np.arange(round((2 * time + 3 * rest) / _DT) + 1) * _DT
    there, back = min_jerk((t - rest) / time), min_jerk((t - 2 * rest - time) / time)
    return Reference(t, angle * (there - back - 0.5), np.full_like(t, K))


def chirp(
    K: float = 5.5,
    amplitude: float = 28 * DEG,
    frequencies: tuple[float, float] = (0.15, 0.55),
    lead: float = 2.0,
    duration: float = 10.0,
) -> Reference:
    """A sine of rising frequency [Hz], fading in and out over one second each, after `lead` seconds of rest."""
    t = np.arange(round((lead + duration) / _DT) + 1) * _DT
    s = np.clip(t - lead, 0, duration)
    low, high = frequencies
    phase = 2 * np.pi * (low * s + (high - low) * s**2 / (2 * duration))
    fade = min_jerk(s) * min_jerk(duration - s)
    return Reference(t, amplitude * fade * np.sin(phase), np.full_like(t, K))


def steps(K: float = 5.5, angle: float = 20 * DEG, time: float = 0.4, rest: float = 2.0) -> Reference:
    """Steps of 20°: 0, 20°, 40°, 20°, each shaped to least jerk over `time` so that every controller can follow."""
    t = np.arange(round(4 * (rest + time) / _DT) + 1) * _DT
    edges = rest + (rest + time) * np.arange(3)
    levels = sum(sign * min_jerk((t - edge) / time) for edge, sign in zip(edges, (1, 1, -1), strict=True))
    return Reference(t, angle * np.asarray(levels), np.full_like(t, K))


def stiffness_step(
    K: tuple[float, float] = (5.0, 6.0), theta: float = 20 * DEG, time: float = 0.3, rest: float = 3.0
) -> Reference:
    """Stiffness from K[0] to K[1] and back at constant angle, each shaped to least jerk over `time`."""
    t = np.arange(round((2 * time + 3 * rest) / _DT) + 1) * _DT
    there, back = min_jerk((t - rest) / time), min_jerk((t - 2 * rest - time) / time)
    return Reference(t, np.full_like(t, theta), K[0] + (K[1] - K[0]) * (there - back))


__all__ = ["chirp", "min_jerk", "point_to_point", "rested_sine", "steps", "stiffness_step"]
