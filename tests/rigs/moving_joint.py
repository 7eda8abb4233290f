"""Log of a joint with known parameters, by a plant of another structure than the fitted model.

The plant has Maxwell slip in the torque, an inertia that oscillates, and regulators with lag and dead time.
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allocator import BAR, DEG, report_joint
from allocator.identification import fit_motion
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.plant import Plant
from mpc.model.real import RealPlant

from .once import once

JOINT = report_joint(SAROSI_DMSP_20_400N)
LAG, DEAD_TIME, WIDTH = 0.15, 0.06, 6 * DEG
STEP = 0.02


@dataclass(frozen=True)
class Recorded:
    """Rows of the recorder."""

    t: Any
    theta: Any
    P1: Any
    P2: Any

    @property
    def rows(self):
        return self.t, self.theta, self.P1, self.P2


def recorded(plant, seconds=60.0, seed=0):
    """Return random steps of both commands, each for 0.4 to 1.5 s, and the angle by an encoder of 0.05°."""
    rng, n = np.random.default_rng(seed), round(seconds / STEP)
    under_way = plant.begin(STEP, np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]), seed)
    u, until, theta, commands = np.full(2, 2.5 * BAR), 0, np.empty(n), np.empty((n, 2))
    for k in range(n):
        if k == until:
            u, until = rng.uniform(1.6, 3.8, 2) * BAR, k + int(rng.uniform(0.4, 1.5) / STEP)
        theta[k], commands[k] = 0.05 * DEG * np.round(under_way.measure()[0] / (0.05 * DEG)), u
        under_way.advance(u)
    return Recorded(np.arange(n) * STEP, theta, *commands.T)


@pytest.fixture(scope="session")
def slow_joint():
    """Return the joint with negligible inertia, and its log."""
    plant = Plant(JOINT, inertia=0.002, damping=0.05, lag=LAG, gas=False)
    return recorded(RealPlant(plant, friction=MaxwellSlip.of_width(plant, WIDTH), dead_time=DEAD_TIME))


@pytest.fixture(scope="session")
def swinging_joint():
    plant = Plant(JOINT, inertia=0.2, damping=0.4, lag=LAG, gas=False)
    return plant, recorded(RealPlant(plant, friction=MaxwellSlip.of_width(plant, WIDTH), dead_time=DEAD_TIME))


@pytest.fixture(scope="session")
def slow_fit(slow_joint, tmp_path_factory):
    """Return the fit of the joint with negligible inertia."""
    return once(tmp_path_factory, "slow_fit", lambda: fit_motion(*slow_joint.rows, joint=JOINT))


@pytest.fixture(scope="session")
def swinging_fit(swinging_joint, tmp_path_factory):
    """Return the fit of the oscillating joint."""
    return once(tmp_path_factory, "swinging_fit", lambda: fit_motion(*swinging_joint[1].rows, joint=JOINT))


@pytest.fixture(scope="session")
def measured(shared):
    """Return the rows of a measured joint: times [s], angles [rad] and both pressures [Pa]."""
    lines = shared(Path("data") / "joint_log_40hz.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    t, theta, P1, P2 = (
        np.array([float(row[name]) for row in rows])
        for name in ("time_s", "theta_rad", "pressure1_mpa", "pressure2_mpa")
    )
    return t, theta, 10 * BAR * P1, 10 * BAR * P2
