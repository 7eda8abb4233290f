"""A plant as an arm moves as the plant does, and what works on arms works on it."""

import numpy as np
import pytest

from allocator import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR
from mpc.arm.mjcf import to_mjcf
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.governor import PressureGovernor
from mpc.model.plant import Plant

from ...rigs.one_joint import arm_of

JOINT = report_joint(SAROSI_DMSP_20_400N)
PLANTS = {
    "horizontal": Plant(JOINT),
    "hanging": Plant(JOINT, gravity_torque=1.2, lag=(0.05, 0.2)),
    "standing": Plant(JOINT, gravity_torque=-4.0, inertia=0.02, damping=0.0),
    "without gas": Plant(JOINT, gravity_torque=0.3, gas=False),
}


@pytest.fixture(params=PLANTS)
def plant(request):
    return PLANTS[request.param]


def test_it_moves_as_the_plant(plant):
    arm, dt = arm_of(plant), 0.02
    one, many = plant.discrete(dt, 0.02), arm.discrete(dt, 0.02)
    x, u = np.array([0.3, -1.5, 2.1 * BAR, 3.2 * BAR]), np.array([2.5, 2.9]) * BAR
    np.testing.assert_allclose(many(x, u, 0.4), one(x, u, 0.4), rtol=1e-7)


def test_it_holds_as_the_plant(plant):
    arm, K = arm_of(plant), float(plant.stiffness(np.array([0.2, 0.0, 2.5 * BAR, 2.5 * BAR])))
    np.testing.assert_allclose(arm.at_rest([0.2], K), plant.at_rest(0.2, K), rtol=1e-9, atol=1e-6)


def test_the_governor_keeps_the_joint_inside():
    plant = Plant(JOINT, gravity_torque=0.5)
    arm, dt = arm_of(plant), 0.01
    governor = PressureGovernor.of_arm(arm, dt)
    step, (left, right) = plant.discrete(dt, 0.05), plant.angle_limits
    x, previous, free = plant.at_rest(0.0, 12.0), np.full(2, 2.5 * BAR), plant.at_rest(0.0, 12.0)
    for k in range(200):
        wild = np.array([5.0, 0.0] if k < 150 else [0.0, 5.0]) * BAR
        sent = governor(x[:1], x[1:2], x[2:], wild, previous)
        assert np.abs(sent - previous).max() <= plant.slew * dt * (1 + 1e-9)
        x, previous = np.array(step(x, sent, 0.0)).ravel(), sent
        free = np.array(step(free, wild, 0.0)).ravel()
        assert left - 1e-6 <= x[0] <= right + 1e-6
    assert abs(free[0]) > right or abs(free[1]) > 0.5  # without it the joint flies


def test_mujoco_moves_it_as_the_plant():
    plant = Plant(JOINT, gravity_torque=0.8)
    arm, dt = arm_of(plant), 0.01
    text = to_mjcf(arm.mechanism, arm.bodies, timestep=2e-4)
    moved = MujocoPlant(text, arm.mechanism.muscles, lag=arm.lag, slew=np.inf, gas=arm.gas)
    x, u, step = np.array([0.3, 0.5, 2.1 * BAR, 3.0 * BAR]), np.array([2.6, 2.4]) * BAR, plant.discrete(dt, 0.02)
    moved.reset(x[:1], x[2:], omega=x[1:2])
    for _ in range(50):
        moved.step(u, dt)
        x = np.array(step(x, u, 0.0)).ravel()
    np.testing.assert_allclose(np.concatenate([moved.q, moved.omega]), x[:2], atol=2e-3)
