"""Reference on which loops are tuned, in legs that are evaluated one by one.

A sine, a minimum-jerk movement there and back, and shaped steps, at rest and in motion, come before a payload and again
with it. One run thus gives every figure of `mpc.trials.motions.trajectories` in a third of the time. All joints of an
arm make the minimum-jerk movements together; the other motions are left out, since its runs take longer.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.units import DEG
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.trials.motions import arm_trajectories
from mpc.trials.motions.reference import Reference, min_jerk
from mpc.trials.motions.trajectories import usual_stiffness, usual_swing

MOTIONS = ("sine", "min-jerk", "steps")
_OF_AN_ARM = ("min-jerk",)
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
    K: Value  # [N·m/rad] of the joints in the middle, (n, n) for an arm
    postures: list[tuple[Value, Value]]  # θ [rad] and tracked stiffness in the middle, and half-way to either end

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the motions."""
        return tuple(name for name in MOTIONS if name in self.legs)

    @classmethod
    def of(cls, plant: Machine, dt: float, K: Value | None = None) -> "Tour":
        """Return the tour of a machine, by default with its usual stiffness.

        `K` is a number [N·m/rad] for a joint, a matrix (k, k) for an arm. Raises `InvalidInput` for one that the
        machine refuses.
        """
        return _of_arm(plant, dt, K) if isinstance(plant, Arm) else _of_joint(plant.joint, dt, K)


def _of_joint(joint: AntagonistJoint, dt: float, K: Value | None) -> Tour:
    K, swing = usual_stiffness(joint) if K is None else K, usual_swing(joint)
    theta, legs, rests = _path(_motions(np.asarray(swing), dt), dt)
    postures = [(share * swing, K) for share in _SHARES]
    return Tour(_reference(theta, np.full(len(theta), K), dt), legs, rests, legs["load"].start * dt, K, postures)


def _of_arm(arm: Arm, dt: float, K: Value | None) -> Tour:
    swing, middle = arm_trajectories.usual_swings(arm), arm_trajectories.middle_of(arm)
    of_joints = arm_trajectories.usual_stiffness(arm)
    if K is not None and np.shape(K) != arm.stiffness_shape:
        raise InvalidInput(f"K has the shape {np.shape(K)}; expected {arm.stiffness_shape} [{arm.stiffness_unit}]")

    def tracked(q: Array) -> Array:
        if K is None:
            return arm_trajectories.tracked_stiffness(arm, q, of_joints(q))
        return np.tile(np.asarray(K, float), (len(q), 1, 1))

    motions = {name: motion for name, motion in _motions(swing, dt).items() if name in _OF_AN_ARM}
    turned, legs, rests = _path(motions, dt)
    q = np.stack([middle + share * swing for share in _SHARES])
    postures = list(zip(q, tracked(q), strict=True))
    theta = middle + turned
    arm.check_stiffness("K", tracked(theta))
    own = of_joints(middle[None])[0]
    return Tour(_reference(theta, tracked(theta), dt), legs, rests, legs["load"].start * dt, own, postures)


_SHARES = (-0.5, 0.0, 0.5)


def _reference(theta: Array, K: Array, dt: float) -> Reference:
    return Reference(np.asarray(dt * np.arange(len(theta)), float), theta, K)


def _path(motions: dict[str, Array], dt: float) -> tuple[Array, dict[str, slice], tuple[slice, slice]]:
    """Return the angles of a tour from 0 to 0, its legs and its rests."""
    shape = next(iter(motions.values())).shape[1:]

    def still(time: float) -> Array:
        return np.zeros((round(time / dt), *shape))

    pieces, legs, rests = [still(LEAD)], {}, []
    for word in ("", " loaded"):
        for name, theta in motions.items():
            begin = sum(map(len, pieces))
            pieces.append(theta)
            legs[name + word] = slice(begin, begin + len(theta))
        end = sum(map(len, pieces)) + round(REST / dt)
        pieces.append(still(REST))
        rests.append(slice(end - round(_STILL / dt), end))
        if not word:
            legs["load"] = slice(end, end + round(SETTLE / dt))
            pieces.append(still(SETTLE))
    return np.concatenate([*pieces, np.zeros((1, *shape))]), legs, (rests[0], rests[1])


def _motions(swing: Array, dt: float) -> dict[str, Array]:
    """Return the angles [rad] of each motion by ±`swing`, a number or (n,), from rest at 0 to rest at 0."""

    def moves(stops: tuple[Array, ...], time: float, rest: float) -> Array:
        s = np.asarray(dt / time * np.arange(1, round((time + rest) / dt) + 1), float)
        steps = zip((0.0 * swing, *stops), stops, strict=False)
        return np.concatenate([a + np.multiply.outer(min_jerk(s), b - a) for a, b in steps])

    t = np.asarray(dt * np.arange(1, round(2.3 / dt) + 1), float)
    low, step, middle = -0.75 * swing, np.minimum(20 * DEG, 0.5 * swing), 0.0 * swing
    return {
        "sine": np.multiply.outer(np.where(t < 2.0, np.sin(np.pi * t), 0.0), swing),
        "min-jerk": moves((low, -low, middle), 1.0, 0.3),
        "steps": moves((step, 2 * step, step, middle), 0.4, 0.5),
    }
