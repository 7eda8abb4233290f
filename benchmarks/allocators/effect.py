"""Effect of pressures on a real joint.

Everything is computed from the pressures by the muscle laws alone, at the joint's angle: a cable with a negative model
force is slack and adds neither torque nor stiffness. Pressures are used unchanged, even impossible ones of the raw
inverse, which flatters its errors; its clipped form shows them.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.allocators.contenders import Answer
from benchmarks.allocators.targets import Array, Flags, TargetSet

ROUNDING = 1e-9  # of the supply range, and of the greatest force: tolerance of limits


class Effect(NamedTuple):
    """Effect of pressures, each (n,)."""

    T: Array  # [N·m]
    K: Array  # [N·m/rad]
    taut: Flags  # both cables
    within: Flags  # all limits


def effect(targets: TargetSet, answer: Answer) -> Effect:
    """Return torque, stiffness and limits at the pressures; NaN gives NaN, not taut, not within."""
    joint, T, K = targets.joint, np.zeros(targets.K.shape), np.zeros(targets.K.shape)
    taut, within = np.ones(T.shape, bool), np.ones(T.shape, bool)
    (low, high), tolerance = joint.pressure_limits, ROUNDING * joint.pressure_span
    for side, P in zip(joint.sides(targets.reached), (answer.P1, answer.P2), strict=True):
        force = side.force(P)
        slack = force < -ROUNDING * np.abs(side.force(high)).max()
        T += np.where(slack, 0.0, side.torque(P))
        K += np.where(slack, 0.0, side.stiffness(P))
        taut &= ~slack & ~np.isnan(force)
        within &= (low - tolerance <= P) & (min(high, side.muscle.max_pressure) + tolerance >= P)
    return Effect(T, K, taut, within & taut)
