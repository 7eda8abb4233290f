"""What pressures do to a real joint.

Everything is computed from the pressures by the muscle laws alone, at the angle where the joint stands: a cable whose
model force is negative is slack, so that it adds neither torque nor stiffness. Pressures are taken as they are: those
of the raw inverse that no valve can give are believed here, which flatters its errors; its clipped form shows them.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.allocators.contenders import Answer
from benchmarks.allocators.targets import Array, Flags, TargetSet

ROUNDING = 1e-9  # of the supply range, and of the greatest force: beyond a limit by less is on it


class Effect(NamedTuple):
    """What pressures do; each (n,)."""

    T: Array  # [N·m]
    K: Array  # [N·m/rad]
    taut: Flags  # both cables
    within: Flags  # all limits


def effect(targets: TargetSet, answer: Answer) -> Effect:
    """Torque, stiffness and limits at the pressures; NaN gives NaN, not taut, not within."""
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
