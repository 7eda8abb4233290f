"""Arms and plants of the report."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR, DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm

ARMS = "arm26", "arm48"
DT = 0.01  # [s]
DEAD_TIME = 0.02  # [s]
SENSORS = {"encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}
LOAD = 1.0  # [N·m] at the first joint, unmodelled
ARRIVES = 2.0  # [s] after the beginning


def plant(arm: Arm, **effects: Any) -> MujocoPlant:
    """Return an arm's bodies and tendons on MuJoCo, with unmodelled effects."""
    return MujocoPlant.of(arm, **effects)


def rough_plant(arm: Arm, seed: int = 0, off: float = 0.05) -> MujocoPlant:
    """Return a plant with random force errors of ±5 %, encoder steps, noise and 20 ms dead time."""
    signs = np.random.default_rng(100 + seed).choice([-1.0, 1.0], arm.m)
    return plant(arm, force_gains=1 + off * signs, dead_time=DEAD_TIME, **SENSORS)


def load(arm: Arm) -> Any:
    """Return the external torques (n,) [N·m] over time."""

    def at(t: float) -> Array:
        return LOAD * np.eye(arm.n)[0] * (t >= ARRIVES)

    return at
