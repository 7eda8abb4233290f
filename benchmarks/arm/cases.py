"""The arms and plants of the report."""

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
LOAD = 1.0  # [N·m] at the first joint, of which nobody tells
ARRIVES = 2.0  # [s] after the beginning


def plant(arm: Arm, **effects: Any) -> MujocoPlant:
    """An arm's bodies and tendons on MuJoCo, with effects that its model does not know."""
    return MujocoPlant.of(arm, **effects)


def rough_plant(arm: Arm, seed: int = 0, off: float = 0.05) -> MujocoPlant:
    """Muscles that pull 5 % more or less than their laws say, by chance, encoder steps, noise and 20 ms dead time."""
    signs = np.random.default_rng(100 + seed).choice([-1.0, 1.0], arm.m)
    return plant(arm, force_gains=1 + off * signs, dead_time=DEAD_TIME, **SENSORS)


def load(arm: Arm) -> Any:
    """The torques (n,) [N·m] from outside over the time."""

    def at(t: float) -> Array:
        return LOAD * np.eye(arm.n)[0] * (t >= ARRIVES)

    return at
