"""The whole step of an arm in one compiled call is that of the stages."""

from copy import deepcopy

import numpy as np
import pytest

from allocator.units import BAR, DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.plan import PlanStatus
from mpc.trials.motions.arm_trajectories import circle

pytestmark = [pytest.mark.compiles, pytest.mark.slow]

DT = 0.01
ARM = Arm.machine("arm26")
KNOWN = {
    "nothing": Compensation(),
    "dead time and dead band": Compensation(dead_time=0.02, dead_band=0.1 * BAR),
    "friction": Compensation(Friction(mu=0.05, coulomb=0.1), dead_time=0.02),
    "friction of one joint": Compensation(frictions=(Friction(), MaxwellSlip.of_width(ARM, 4 * DEG, joint=1))),
}
NEAR = 1e-10 * 5 * BAR  # [Pa]: what CasADi and compiled code predict over the dead time differs in the last bits


class Pair:
    """A controller with whole steps, and at every step a copy of it that goes stage by stage."""

    def __init__(self, known):
        self.whole = TrackingMPC(ARM, DT, compensation=known)
        self.taken = []

    def step(self, *given):
        staged = deepcopy(self.whole)
        staged._whole = None
        plan, wanted = self.whole.step(*given), staged.step(*given)
        self.taken.append(not self.whole._whole.behind)
        assert (plan.status, plan.rung) == (wanted.status, wanted.rung)
        near = 0.0 if self.whole.compensation == Compensation() else NEAR
        np.testing.assert_allclose(plan.u, wanted.u, rtol=0, atol=near)
        np.testing.assert_allclose(plan.x, wanted.x, rtol=1e-9, atol=near)
        np.testing.assert_allclose(plan.K, wanted.K, rtol=1e-9)
        np.testing.assert_allclose((plan.slack, plan.slack_force), (wanted.slack, wanted.slack_force), atol=1e-9)
        for one, other in zip(self.whole._preview.frictions, staged._preview.frictions, strict=True):
            np.testing.assert_allclose(one.memory, other.memory, rtol=0, atol=1e-12)
            assert one.theta == other.theta
        np.testing.assert_allclose(self.whole.rest_mode.numbers, staged.rest_mode.numbers, rtol=1e-9, atol=1e-9)
        return plan


@pytest.mark.parametrize("known", KNOWN.values(), ids=KNOWN.keys())
def test_a_circle_with_silent_and_wrong_sensors(known):
    pair, observer = Pair(known), KalmanObserver(ARM, DT, compensation=known)
    asked = circle(ARM).resampled(DT)
    plant = MujocoPlant.of(ARM, dead_time=known.dead_time, encoder=0.02 * DEG, pressure_noise=0.02 * BAR)
    x0 = np.concatenate([asked.theta[0], np.zeros(2), np.full(6, 2.5 * BAR)])
    experiment, u = plant.begin(DT, x0, 3), x0[4:]
    silent, wrong = range(40, 70), range(85, 88)
    for k in range(110):
        y = np.array(experiment.measure())
        if k in silent:
            y[0] = np.nan
        if k in wrong:
            y[5] = 9 * BAR
        u = pair.step(*(x := observer.estimate(y, u))[:1], *asked.preview(k, pair.whole.ahead), x[1]).u[0]
        experiment.advance(u)
    taken = np.array(pair.taken)
    assert taken[:40].all()
    assert not taken[52:70].any()  # the tolerance has passed
    assert taken[75:].all()


def test_a_rest_and_the_corrections_in_it():
    pair, rng = Pair(KNOWN["friction"]), np.random.default_rng(2)
    q, error, held = np.radians([20.0, 60.0]), 0.0, []
    K = np.array([[11.0, 3.5], [3.5, 9.0]])
    x = np.concatenate([q, np.zeros(2), np.full(6, 2.5 * BAR)])
    for k in range(420):
        error += (k > 300) * (0.1 * DEG - error) / 40
        noise = rng.normal(size=10) * np.array([1e-5, 1e-5, 0, 0, *6 * [200.0]])
        plan = pair.step(x + noise + error * np.eye(10)[0], q, K)
        if plan.status is PlanStatus.RESTING:
            held.append(plan.u[0])
    assert all(pair.taken)
    assert len(held) > 50
    assert len(np.unique(np.round(held, 3), axis=0)) > 2  # corrected


@pytest.mark.filterwarnings("ignore::mpc.tracking.preview.BadNumbers")
def test_references_that_are_no_matrices_of_a_stiffness_are_left_to_the_stages():
    pair, q = Pair(Compensation()), np.radians([20.0, 60.0])
    x = np.concatenate([q, np.zeros(2), np.full(6, 2.5 * BAR)])
    for K in ([[11, 3.5], [3.5, 9]], [[1, 5], [5, 1]], [[11, 3.5], [3, 9]]):
        pair.step(x, q, K, 0.0)
    pair.step(x.tolist(), [q] * (pair.whole.ahead + 1), [[11, 3.5], [3.5, 9]], np.zeros(2))
    assert pair.taken == [True, False, False, True]
