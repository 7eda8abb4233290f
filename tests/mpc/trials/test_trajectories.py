"""The standard trajectories are what their names say, and a joint can follow those that are meant to be followed."""

import numpy as np
import pytest

from allocator import DEG, allocate
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.geometry import Pulley
from allocator.muscles import Hogan1984
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant
from mpc.trials.motions.trajectories import (
    LEAD,
    TRAJECTORIES,
    jumps,
    shrunk,
    stiffness_ramps,
    together,
    usual_stiffness,
)

JOINTS = {"report": report_joint(), "Sarosi": report_joint(SAROSI_DMSP_20_400N)}


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_every_trajectory_begins_and_ends_with_a_rest(name):
    reference = TRAJECTORIES[name].about(7.0)
    for values in (reference.theta, reference.K):
        np.testing.assert_allclose(values[: round(LEAD / 0.01)], values[0], atol=1e-12)
        np.testing.assert_allclose(values[-5:], values[-1], atol=1e-3)
    np.testing.assert_allclose(np.diff(reference.t), 0.01)
    assert reference.K[0] == pytest.approx(7.0, abs=0.5)


@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS)
@pytest.mark.parametrize("name", sorted(TRAJECTORIES.keys() - {"jumps", "stiffness-ramps"}))
def test_at_the_usual_stiffness_the_joint_has_the_pressures_for_it(name, joint):
    """The ramps have corners, and a jump no acceleration: for these a few samples cannot be had exactly."""
    reference = TRAJECTORIES[name].about(usual_stiffness(joint))
    omega = np.gradient(reference.theta, 0.01)
    T = Plant(joint).torque_for(reference.theta, omega, np.gradient(omega, 0.01))
    assert allocate(reference.theta, reference.K, T, joint=joint).success.all()


def test_a_trajectory_stays_as_it_is_where_the_joint_has_the_room():
    for name, standard in TRAJECTORIES.items():
        for joint in JOINTS.values():
            asked = standard.about(K := usual_stiffness(joint))
            given = shrunk(standard.about, K, joint)
            np.testing.assert_allclose(given.theta, asked.theta, atol=1e-12, err_msg=name)
            np.testing.assert_allclose(given.K, asked.K, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("name", sorted(TRAJECTORIES.keys() - {"jumps", "stiffness-ramps"}))
def test_a_weak_joint_of_little_range_has_the_pressures_for_a_shrunk_trajectory(name):
    pulley = Pulley(rest_length=0.18, radius=0.01, initial_contraction=0.12)
    muscle = Hogan1984(F_max=16.0, eps_max=0.25, P_max=3e5)
    joint = AntagonistJoint(pulley, muscle, muscle, (0.0, 3e5), angle_limits=(-25 * DEG, 60 * DEG))
    reference = shrunk(TRAJECTORIES[name].about, usual_stiffness(joint), joint)
    assert np.abs(reference.theta).max() <= 22.5 * DEG * (1 + 1e-12)
    omega = np.gradient(reference.theta, 0.01)
    T = Plant(joint, inertia=2e-5, damping=1e-4).torque_for(reference.theta, omega, np.gradient(omega, 0.01))
    assert allocate(reference.theta, reference.K, T, joint=joint).success.all()


def test_stiffness_ramps_are_straight_at_a_constant_angle():
    reference = stiffness_ramps(7.0, 0.5, 20 * DEG)
    np.testing.assert_array_equal(reference.theta, 20 * DEG)
    slopes = np.unique(np.round(np.diff(reference.K) / 0.01, 6))
    np.testing.assert_allclose(slopes, [-1.0, 0.0, 0.25, 1.0])
    assert (reference.K.min(), reference.K.max()) == (6.5, 7.5)


def test_angle_and_stiffness_move_together():
    reference = together(7.0, 0.3, 40 * DEG)
    np.testing.assert_allclose((reference.K - 7.0) / 0.3, reference.theta / (40 * DEG), atol=1e-9)
    assert np.abs(reference.theta).max() == pytest.approx(40 * DEG)


def test_jumps_take_one_sample():
    reference = jumps(7.0, 25 * DEG)
    np.testing.assert_allclose(np.unique(np.abs(np.diff(reference.theta))), np.array([0, 25, 50]) * DEG)
    np.testing.assert_array_equal(reference.resampled(0.01).theta, reference.theta)
