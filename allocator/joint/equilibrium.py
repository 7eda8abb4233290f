"""Angles at which a joint rests: without friction, and after a history of pressures with its hysteresis or friction."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, rising_roots
from allocator.errors import InvalidInput
from allocator.joint.hysteresis import through_friction, through_plays

if TYPE_CHECKING:
    from allocator.joint.antagonist import AntagonistJoint

_PIECES = 64  # of the joint range, in each of which one equilibrium is looked for


def nearest_equilibrium(joint: "AntagonistJoint", P1: Array, P2: Array, T: Array) -> Array:
    """Return the angle [rad] nearest to 0 at which the joint gives and holds T [N·m] at pressures [Pa]; else NaN."""

    def lacking(theta: Array, P1: Array, P2: Array, T: Array) -> Array:
        agonist, antagonist = joint.sides(theta)
        return np.asarray(T - agonist.torque(P1) - antagonist.torque(P2))

    left, right = (np.asarray(end) for end in joint.angle_range)
    found = rising_roots(lacking, left, right, P1, P2, T, pieces=_PIECES)  # rising: K > 0
    nearest = np.abs(np.where(np.isfinite(found), found, np.inf)).argmin(axis=0, keepdims=True)
    return np.asarray(np.take_along_axis(found, nearest, 0)[0])


def after_history(
    joint: "AntagonistJoint", history: tuple[ArrayLike, ArrayLike], P1: ArrayLike, P2: ArrayLike, T: float
) -> Array:
    """Return the angles [rad] after the `history`, see `AntagonistJoint.equilibrium`."""
    before = checks.broadcast(**checks.pressure_pair("history", history, ("history[0]", "history[1]")))
    now = checks.broadcast(P1=checks.pressure("P1", P1), P2=checks.pressure("P2", P2))
    if before[0].ndim > 1 or now[0].ndim > 1:
        raise InvalidInput("a history, and the pressures after it, have to be numbers or rows, in their order")
    one, two = (np.concatenate([np.atleast_1d(b), np.atleast_1d(n)]) for b, n in zip(before, now, strict=True))
    u = joint.equilibrium(one, two, T) if joint.hysteresis else joint.equilibrium(one[:1], two[:1], T)
    if joint.hysteresis:
        theta = through_plays(joint.hysteresis, u, one + two)
    elif np.isnan(u[0]):
        raise InvalidInput("at the first pressures of the history the joint rests at no angle of its range")
    else:
        theta = through_friction(partial(_exceeding, joint, T), float(u[0]), one, two, joint.angle_range)
    left, right = joint.angle_range
    theta = np.where((theta >= left) & (theta <= right), theta, np.nan)[-now[0].size :]
    return np.asarray(theta.reshape(now[0].shape))


def _exceeding(joint: "AntagonistJoint", T: float, theta: float, P1: float, P2: float, z: float) -> float:
    """Return the torque [N·m] less friction in the state `z` [-] and less the load `T` [N·m]."""
    agonist, antagonist = joint.sides(theta)
    t1, t2 = agonist.torque(P1), antagonist.torque(P2)
    return float(t1 + t2 - joint.friction * z * (t1 - t2) - T)
