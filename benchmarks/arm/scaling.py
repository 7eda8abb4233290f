"""Growth of the time of a step with joints, muscles and horizon."""

from typing import NamedTuple

import numpy as np

from allocator.mechanism import Mechanism, Pulleys
from allocator.mechanism.bodies import Bodies
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import DEG
from benchmarks.arm.nominal import Times, times
from mpc.model.arm.model import Arm
from mpc.tracking.controller import TrackingMPC

HORIZONS = 10, 20, 40


class Grown(NamedTuple):
    """Time of an arm's step at a horizon."""

    joints: int
    muscles: int
    horizon: int
    decisions: int
    times: Times


def chain(n: int) -> Arm:
    """Return an arm with an antagonistic pair on a 2 cm pulley at each of n joints, and links of 25 cm and 0.5 kg."""
    arms = [[sign * 0.02 if i == j else 0.0 for j in range(n)] for i in range(n) for sign in (1, -1)]
    limits = tuple((-60 * DEG, 60 * DEG) for _ in range(n))
    mechanism = Mechanism(Pulleys(0.4, arms, 0.1375), SAROSI_DMSP_20_400N, angle_limits=limits)
    return Arm(mechanism, Bodies.rods([0.25] * n, [0.5] * n, np.full(n, 0.15).tolist()))


def grown(horizons: tuple[int, ...] = HORIZONS) -> list[Grown]:
    """Yield chains of one to three joints, arm26 with two redundant muscles, and arm48, at some horizons."""
    found = []
    for arm in (chain(1), chain(2), Arm.machine("arm26"), chain(3), Arm.machine("arm48")):
        for N in horizons:
            controller = TrackingMPC(arm, N=N)
            decisions = arm.m * len(controller.blocks or ())
            found.append(Grown(arm.n, arm.m, N, decisions, times(arm, controller, turns=0.5, rounds=3)))
            print(found[-1], flush=True)
    return found
