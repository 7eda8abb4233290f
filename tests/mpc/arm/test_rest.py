"""An arm with friction comes to rest where its reference does, stays there, and lets go when something happens."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import nnls

from allocator.units import BAR, DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.observer.filter import CALM_NOISE
from mpc.observer.kalman import KalmanObserver
from mpc.tracking import rest_memory, resting
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import CALM
from mpc.tracking.plan import PlanStatus
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import simulate

DT, LOADED, END = 0.01, 6.5, 9.0
ARM = Arm.machine("arm26")
SLIPS = tuple(MaxwellSlip.of_width(ARM, 5 * DEG, joint=i) for i in range(ARM.n))
TOLD = Compensation(dead_time=0.02, frictions=tuple(MaxwellSlip.of_width(ARM, 4 * DEG, joint=i) for i in range(ARM.n)))


@cache
def run(rest, gas=True):
    """One of six muscles 8 % off each; a minimum-jerk move of 1 s, then 8 s of rest, and a load on the shoulder."""
    arm = replace(ARM, gas=gas)
    plant = MujocoPlant.of(
        arm, friction=SLIPS, force_gains=1 + 0.08 * np.array([1, -1, -1, 1, -1, 1]), dead_time=0.02,
        encoder=0.02 * DEG, pressure_noise=0.02 * BAR,
    )  # fmt: skip
    t = np.arange(0, END + DT / 2, DT)
    s = np.clip(t, 0, 1)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    theta = np.radians([20.0, 40.0]) + way[:, None] * np.radians([20.0, -15.0])
    reference = Reference(t, theta, np.tile(np.array([[11.0, 3.5], [3.5, 9.0]]), (t.size, 1, 1)))
    controller = TrackingMPC(arm, DT, weights=CALM, compensation=TOLD, solver="daqp", rest=rest)
    observer = KalmanObserver(arm, DT, CALM_NOISE, TOLD)
    return simulate(
        plant, controller, reference, observer=observer, seed=1, load=lambda now: [1.5 * (now >= LOADED), 0.0]
    )


def last_second_before_the_load(run):
    span = slice(round((LOADED - 1) / DT), round(LOADED / DT))
    rate = np.sqrt((np.diff(run.u[span], axis=0) ** 2).mean()) / BAR / DT
    error = (run.theta - run.theta_ref)[span] / DEG
    return rate, np.ptp(error, axis=0).max(), np.abs(error.mean(axis=0)).max()


@pytest.mark.compiles
@pytest.mark.slow
@pytest.mark.parametrize(("gas", "moving"), [(False, 1.0), (True, 0.4)], ids=["no gas", "gas"])
def test_commands_and_joints_are_still_where_they_moved_on_without_the_mode(gas, moving):
    with_it, without = (last_second_before_the_load(run(rest, gas)) for rest in (True, False))
    assert with_it[0] < 0.1  # [bar/s]
    assert without[0] > moving
    assert with_it[1] < 0.1  # [°] swing
    assert with_it[2] < 0.1  # [°] left over


@pytest.mark.compiles
@pytest.mark.slow
def test_a_load_on_one_joint_ends_the_rest_of_all_and_is_answered():
    found, at = run(True), round(LOADED / DT)
    assert (found.status[at - 20 : at + 1] == PlanStatus.RESTING).all()
    assert (found.status[at + 10 : at + 40] == PlanStatus.OPTIMAL).all()
    assert np.abs(found.theta[-1] - found.theta_ref[-1]).max() < 0.3 * DEG


# --- parts ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_changes_of_one_sign_share_a_torque_as_least_squares_do(seed, side):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.3, 0.8, 2)
    slopes = np.transpose([each.torque_gain(p) for each, p in zip(ARM.mechanism.at(q), np.full(6, 3e5), strict=True)])
    memory = resting.memory_in(np.zeros(resting.size(2, 6)), 2, 6)
    torque = rng.uniform(-0.05, 0.05, 2)
    memory.shared[rest_memory.SIDE], memory.joint[:, rest_memory.TORQUE] = side, torque
    resting.share(memory, slopes.ravel())
    change = memory.muscle[:, rest_memory.CHANGE]
    _, left = nnls(side * slopes * BAR, torque)
    assert (change >= 0).all()
    assert np.linalg.norm(side * slopes @ change - torque) == pytest.approx(left, abs=1e-3 * np.linalg.norm(torque))


def test_one_joint_outside_its_dead_zone_is_turned_alone():
    memory = resting.memory_in(np.zeros(resting.size(2, 6)), 2, 6)
    memory.shared[[rest_memory.SIDE, rest_memory.RESTS]] = 1.0
    memory.turned[:, 0] = 0.1 * DEG  # mean, least and greatest e
    K = np.array([[11.0, 3.5], [3.5, 9.0]])
    q, P = np.radians([20.0, 40.0]), np.full(6, 2.5e5)
    muscles = ARM.mechanism.at(q)
    slopes = np.transpose([each.torque_gain(p) for each, p in zip(muscles, P, strict=True)])
    memory.muscle[:, rest_memory.HELD] = memory.muscle[:, rest_memory.BEGAN] = memory.filled[:] = P
    resting.turn(memory, K.ravel(), slopes.ravel())
    turned = np.linalg.solve(K, slopes @ (memory.muscle[:, rest_memory.HELD] - P))
    assert turned[0] == pytest.approx(-resting.FIRST * 0.1 * DEG, rel=0.02)
    assert abs(turned[1]) < 0.02 * abs(turned[0])


def test_an_arm_that_knows_of_nothing_never_rests():
    assert not TrackingMPC(ARM, DT, compiled=False).rests
    assert TrackingMPC(ARM, DT, compensation=TOLD, compiled=False).rests
