"""A joint is an arm with n = 1, m = 2: the MPC's plan of a step is the same."""

from itertools import product

import numpy as np
import pytest

from allocator.mechanism import Mechanism
from allocator.mechanism.bodies import EARTH, Bodies
from allocator.units import BAR, DEG
from mpc import Compensation, Plant, TrackingMPC
from mpc.model.arm.model import Arm

pytestmark = [pytest.mark.slow, pytest.mark.compiles]

JOINTS = "mckibben-pulley", "sarosi-lever"
MASS, CENTRE, INERTIA, DAMPING, LAG = 0.8, 0.15, 0.01, 0.2, 0.08
N, STEPS = 20, 30
SENT, PLANNED = 5e-4 * BAR, 2e-3 * BAR  # [Pa] the two integrate with steps of their own


def both(joint, gas, compiled=False, **settings):
    """Controllers of a link that swings under gravity, as a joint and as an arm, which may be compiled."""
    plant = Plant(joint, INERTIA + MASS * CENTRE**2, DAMPING, LAG, MASS * CENTRE * EARTH, gas=gas)
    link = Bodies((0.3,), (MASS,), (CENTRE,), (INERTIA,), (DAMPING,), (EARTH, 0.0))
    arm = Arm(Mechanism.from_joint(joint), link, lag=LAG, gas=gas)
    shared = {"N": N, "solver": "daqp", "blocks": (1,) * N, **settings}
    one = TrackingMPC(plant, rest=False, compiled=False, **shared)
    return plant, one, TrackingMPC(arm, compiled=compiled, **shared)


@pytest.fixture(scope="module", params=product(JOINTS, (False, True)), ids=lambda given: f"{given[0]}, gas {given[1]}")
def controllers(request, joints):
    name, gas = request.param
    return both(joints[name], gas, compiled=name == JOINTS[-1])  # a compiler takes half a minute for each joint


def assert_the_same_plans(controllers, theta, K, d=0.0, hidden=()):
    """Step both along θ(t) and K; the plant follows the first, and its angle is hidden in the steps `hidden`."""
    plant, one, many = controllers
    one.reset()
    many.reset()
    turned, x = plant.discrete(one.dt), np.array([theta(0.0), 0.0, 2.5 * BAR, 2.5 * BAR])
    rungs = set()
    for step in range(STEPS):
        ahead = step + np.arange(one.ahead + 1)
        angles, stiffness = theta(ahead * one.dt), np.full(ahead.size, K)
        seen = np.where([step in hidden, False, False, False], np.nan, x)
        a, b = one.step(seen, angles, stiffness, d), many.step(seen, angles[:, None], stiffness[:, None, None], d)
        assert (b.status, b.rung) == (a.status, a.rung)
        np.testing.assert_allclose(b.u[0], a.u[0], rtol=0, atol=SENT)
        np.testing.assert_allclose(b.u, a.u, rtol=0, atol=PLANNED)
        np.testing.assert_allclose(b.x[:, 0], a.x[:, 0], rtol=0, atol=0.01 * DEG)
        np.testing.assert_allclose(b.K[:, 0, 0], a.K, rtol=1e-3)
        rungs.add(a.rung)
        x = np.array(turned(x, a.u[0], d)).ravel()
    return rungs


def usual(joint):
    return float(joint.stiffness(0.0, 2.5 * BAR, 2.5 * BAR))


def test_a_trajectory_and_a_load(controllers):
    K = usual(controllers[0].joint)
    assert_the_same_plans(controllers, lambda t: 8 * DEG * np.sin(4 * t), K, d=0.3)


def test_where_slew_and_the_joint_range_bind(controllers):
    joint = controllers[0].joint
    jump = 0.97 * joint.angle_range[1]
    assert_the_same_plans(controllers, lambda t: jump * (np.asarray(t) > 0.1), usual(joint))


def test_where_the_stiffness_cannot_be_reached(controllers):
    assert_the_same_plans(controllers, lambda t: 0.0 * t, 5 * usual(controllers[0].joint))


def test_while_the_angle_is_not_seen(controllers):
    rungs = assert_the_same_plans(
        controllers, lambda t: 5 * DEG * np.sin(4 * t), usual(controllers[0].joint), hidden=range(5, 30)
    )
    assert len(rungs) > 1  # pressures are held in the end


def test_with_a_dead_time_and_a_least_force(joints):
    joint = joints["sarosi-lever"]
    plant, one, many = both(joint, gas=True, min_force=60.0)
    late = Compensation(dead_time=0.03)
    one = TrackingMPC(plant, N=N, solver="daqp", rest=False, compiled=False, min_force=60.0, compensation=late)
    many = TrackingMPC(many.plant, N=N, solver="daqp", blocks=(1,) * N, min_force=60.0, compensation=late)
    assert_the_same_plans((plant, one, many), lambda t: 8 * DEG * np.sin(4 * t), usual(joint))
