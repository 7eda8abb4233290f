"""Torque levels: all pressure pairs of the box with one torque.

Since T grows with P1 and falls with P2 the level T(P1, P2) = const is one curve that rises from the lower left to the
upper right of the box. Along it

    dK/dP1 = det ∂(T,K)/∂(P1,P2) / |∂T/∂P2|

so the stiffness grows from one end to the other if the determinant is positive. The stiffnesses at a torque are then an
interval with ends where the level leaves the box, and each occurs exactly once.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, increasing_root
from allocator.joint.limits import PressureBox
from allocator.joint.one_muscle import OneMuscle

Pair = tuple[Array, Array]
BothMuscles = tuple[OneMuscle, OneMuscle]


class Level(NamedTuple):
    """Points where a torque level enters and leaves the box."""

    low: Pair  # least stiffness (P1, P2) [Pa]; NaN where the torque is out of reach
    high: Pair  # greatest stiffness


def torque_interval(sides: BothMuscles, box: PressureBox) -> Pair:
    """Return [T_min, T_max] [N·m] in the box: one muscle at its least, the other at its greatest pressure."""
    agonist, antagonist = sides
    (lo1, hi1), (lo2, hi2), least_sum = (
        (box.agonist.lo, box.agonist.hi),
        (box.antagonist.lo, box.antagonist.hi),
        box.least_sum,
    )
    return (
        agonist.torque(np.maximum(lo1, least_sum - hi2)) + antagonist.torque(hi2),
        agonist.torque(hi1) + antagonist.torque(np.maximum(lo2, least_sum - hi1)),
    )


def torque_level(sides: BothMuscles, box: PressureBox, T: Array) -> Level:
    """Return the ends of the level T in the box."""
    agonist, antagonist = sides
    (lo1, hi1), (lo2, hi2) = ((side.lo, side.hi) for side in box)
    T_min, T_max = torque_interval(sides, box)
    reached, T = (T_min <= T) & (T <= T_max), np.clip(T, T_min, T_max)
    low = (
        np.maximum(lo1, agonist.pressure_for_torque(T - antagonist.torque(lo2))),
        np.maximum(lo2, antagonist.pressure_for_torque(T - agonist.torque(lo1))),
    )
    high = (
        np.minimum(hi1, agonist.pressure_for_torque(T - antagonist.torque(hi2))),
        np.minimum(hi2, antagonist.pressure_for_torque(T - agonist.torque(hi1))),
    )
    if box.has_floor:
        low = _lifted(sides, box, T, low, high)
    return Level(*((np.where(reached, P1, np.nan), np.where(reached, P2, np.nan)) for P1, P2 in (low, high)))


def _lifted(sides: BothMuscles, box: PressureBox, T: Array, low: Pair, high: Pair) -> Pair:
    """Move the low end of the level up to the co-contraction floor: the sum of the pressures grows along the level."""
    agonist, antagonist = sides
    P1, *varying = np.broadcast_arrays(low[0], *agonist.arrays, *antagonist.arrays, T, box.least_sum)

    def excess(P1: Array, *a: Array) -> Array:
        one, two = agonist.isobaric.moved(*a[:3]), antagonist.isobaric.moved(*a[3:6])
        return P1 + two.pressure_for_torque(a[6] - one.torque(P1)) - a[7]

    found = increasing_root(excess, P1, np.maximum(P1, high[0]), *varying)
    P1 = np.where(np.isfinite(found), found, np.where(found > 0, high[0], P1))
    return P1, np.maximum(low[1], antagonist.pressure_for_torque(T - agonist.torque(P1)))


def torque(sides: BothMuscles, pair: Pair) -> Array:
    """Return the torque T [N·m] of a pressure pair."""
    return np.asarray(sides[0].torque(pair[0]) + sides[1].torque(pair[1]))
