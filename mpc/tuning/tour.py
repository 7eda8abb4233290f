"""Reference on which loops are tuned, in legs that are evaluated one by one.

A sine, a minimum-jerk movement there and back, and shaped steps, at rest and in motion, come before a payload and again
with it. One run thus gives every figure of `mpc.trials.motions.trajectories` in a third of the time.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from allocator.units import DEG
from mpc.trials.motions.reference import Reference
from mpc.trials.motions.trajectories import min_jerk, usual_stiffness, usual_swing

MOTIONS = ("sine", "min-jerk", "steps")
LEAD = 1.5  # [s] initial rest
REST = 1.2  # [s] before the payload, and at the end
SETTLE = 1.5  # [s] after the payload is added
_STILL = 0.8  # [s] at the end of a rest, in which commands should stand still


class Tour(NamedTuple):
    """A reference, its legs, and the time of the payload."""

    reference: Reference
    legs: dict[str, slice]  # of samples: the motions "sine" … "steps" and, with the payload, "sine loaded" …, "load"
    rests: tuple[slice, slice]  # before the payload, and with it
    loaded: float  # [s]
    K: float  # [N·m/rad]

    @property
    def postures(self) -> list[tuple[float, float]]:
        """Pairs (θ [rad], K [N·m/rad]): the middle, and half-way to either end."""
        swing = float(np.abs(self.reference.theta).max())
        return [(share * swing, self.K) for share in (-0.5, 0.0, 0.5)]

    @classmethod
    def of(cls, joint: AntagonistJoint, dt: float, K: float | None = None) -> "Tour":
        """Return the tour of a joint about the stiffness `K` [N·m/rad], by default its usual one."""
        K, swing = usual_stiffness(joint) if K is None else K, usual_swing(joint)
        pieces, legs, rests = [np.zeros(round(LEAD / dt))], {}, []
        for word in ("", " loaded"):
            for name, theta in _motions(swing, dt).items():
                begin = sum(map(len, pieces))
                pieces.append(theta)
                legs[name + word] = slice(begin, begin + len(theta))
            end = sum(map(len, pieces)) + round(REST / dt)
            pieces.append(np.zeros(round(REST / dt)))
            rests.append(slice(end - round(_STILL / dt), end))
            if not word:
                legs["load"] = slice(end, end + round(SETTLE / dt))
                pieces.append(np.zeros(round(SETTLE / dt)))
        theta = np.concatenate([*pieces, [0.0]])
        t = np.asarray(dt * np.arange(len(theta)), float)
        reference = Reference(t, theta, np.full_like(t, K))
        return cls(reference, legs, (rests[0], rests[1]), legs["load"].start * dt, K)


def _motions(swing: float, dt: float) -> dict[str, Array]:
    """Return the angles [rad] of each motion, from rest at 0 to rest at 0."""

    def moves(stops: tuple[float, ...], time: float, rest: float) -> Array:
        s = np.asarray(dt / time * np.arange(1, round((time + rest) / dt) + 1), float)
        return np.concatenate([a + (b - a) * min_jerk(s) for a, b in zip((0.0, *stops), stops, strict=False)])

    t = np.asarray(dt * np.arange(1, round(2.3 / dt) + 1), float)
    low, step = -0.75 * swing, min(20 * DEG, 0.5 * swing)
    return {
        "sine": np.where(t < 2.0, swing * np.sin(np.pi * t), 0.0),
        "min-jerk": moves((low, -low, 0.0), 1.0, 0.3),
        "steps": moves((step, 2 * step, step, 0.0), 0.4, 0.5),
    }
