"""Simulated joints whose truth is known: sweeps as a laboratory makes them, with friction, noise and weights."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from allocator import AntagonistJoint, Lever, Pulley
from allocator.calculus import increasing_root
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

FRICTION = 0.13
NOISE = 0.5 * DEG
WEIGHT = 1.2  # [N·m], 8 to 15 degrees
TAUT = 25.0  # [N]
STOPS = (-50 * DEG, 50 * DEG)

TWINS = {
    "sarosi-pulley": AntagonistJoint(
        Pulley(0.40, 0.02, 0.1375), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS, friction=FRICTION
    ),
    "sarosi-lever": AntagonistJoint(
        Lever(0.40, 0.30, 0.03, 0.0435), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS, friction=FRICTION
    ),
    "martens-pulley": AntagonistJoint(
        Pulley(0.30, 0.02, 0.11), MARTENS_DMSP_20_300, MARTENS_DMSP_20_300, angle_limits=STOPS, friction=FRICTION
    ),
    "martens-lever": AntagonistJoint(
        Lever(0.30, 0.25, 0.03, 0.0175), MARTENS_DMSP_20_300, MARTENS_DMSP_20_300, angle_limits=STOPS, friction=FRICTION
    ),
}


@dataclass(frozen=True)
class Log:
    """What the laboratory wrote down."""

    theta: Any
    P1: Any
    P2: Any
    torque: Any
    direction: Any

    def fit_arguments(self, loaded=True):
        """Positional and keyword arguments of `fit_joint`."""
        keep = slice(None) if loaded else self.torque == 0
        return (self.theta[keep], self.P1[keep], self.P2[keep]), {
            "torque": self.torque[keep],
            "direction": self.direction[keep],
        }


def truth(joint, P1, P2, torque, direction):
    """Equilibrium angles by bracketed root finding on the public methods of the joint."""

    def lacking(theta, P1, P2, torque, direction):
        return torque + joint.friction_torque(theta, P1, P2, direction) - joint.torque(theta, P1, P2)

    return increasing_root(lacking, *joint.angle_range, P1, P2, torque, direction)


def log_of(joint, weights_a_side=3, seed=0, noise=NOISE, weight=WEIGHT):
    """Both sweeps without load, and the weight on either side at some co-contractions, from both directions."""
    held, swept = np.arange(1.5, 5.1, 0.7), np.arange(1.5, 5.1, 0.5)
    held, swept = (a.ravel() * BAR for a in np.meshgrid(held, swept))
    level = {0: (), 1: (3.0,), 3: (2.0, 3.0, 4.0)}[weights_a_side]
    hung = np.array([(p * BAR, side * weight, s) for p in level for side in (-1, 1) for s in (-1, 1)]).reshape(-1, 3)
    P1 = np.concatenate([held, swept, hung[:, 0]])
    P2 = np.concatenate([swept, held, hung[:, 0]])
    torque = np.concatenate([0 * held, 0 * held, hung[:, 1]])
    direction = np.concatenate([0 * held - 1, 0 * held + 1, hung[:, 2]])
    theta = truth(joint, P1, P2, torque, direction)
    forces = joint.forces(np.where(np.isfinite(theta), theta, 0.0), P1, P2)
    there = np.isfinite(theta) & (np.minimum(*forces) > TAUT)  # the simulation knows no slack cable
    theta = theta + noise * np.random.default_rng(
        [seed, weights_a_side, int(1e4 * joint.geometry.rest_length)]
    ).standard_normal(theta.size)
    return Log(*(a[there] for a in (theta, P1, P2, torque, direction)))


@pytest.fixture(scope="session")
def all_twins():
    return TWINS


@pytest.fixture(scope="session")
def log_maker():
    return log_of


@pytest.fixture(scope="session")
def truth_of():
    return truth
