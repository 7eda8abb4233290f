"""An arm on MuJoCo follows its references, and whatever comes in, what goes out keeps the limits."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.units import BAR, DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import Weights
from mpc.tracking.plan import PlanStatus, Rung
from mpc.tracking.preview import BadNumbers
from mpc.trials.motions.arm_trajectories import circle, hold, reach, reference
from mpc.trials.simulation import in_motion, simulate

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
K_REF = np.array([[12.0, 4.6], [4.6, 9.5]])


def plant(arm=ARM, **effects):
    return MujocoPlant.of(arm, **effects)


@pytest.fixture(scope="module")
def controller():
    return TrackingMPC(ARM)


@pytest.fixture(scope="module", params=[False, True], ids=["no gas", "gas"])
def run(request, controller):
    arm = replace(ARM, gas=request.param)
    asked = circle(arm, turns=1)
    follows = controller if request.param else TrackingMPC(arm)
    return simulate(plant(arm), follows, asked, x0=in_motion(arm, asked))


def test_angles_and_stiffness_follow_on_bodies_that_are_mujoco_s(run):
    # with gas a motion needs commands ahead of the pressures, and the slew limits the first ones
    allowed = 0.03 if run.plant.nominal.gas is None else 0.04
    error = (run.theta - run.theta_ref) / DEG
    assert (np.sqrt(np.mean(error**2, axis=0)) <= allowed).all()
    assert (np.sqrt(np.mean(error[20:] ** 2, axis=0)) <= 0.003).all()
    assert np.sqrt(np.mean((run.K - run.K_ref)[50:] ** 2, axis=0)).max() <= 0.015


def test_the_limits_of_commands_are_kept_exactly(run):
    low, high = ARM.mechanism.pressure_limits
    assert low <= run.u.min() <= run.u.max() <= high
    assert np.abs(np.diff(run.u, axis=0)).max() <= ARM.slew * 0.01 * (1 + 1e-12)
    assert (run.forces > 0).all()
    assert set(run.rung) == {Rung.QP}


def test_stiffness_is_what_pushing_measures(controller):
    posed = plant()
    simulate(posed, controller, hold(ARM, 1.0))
    here = ARM.mechanism.stiffness(posed.settle(), posed.P)
    np.testing.assert_allclose(posed.pushed_stiffness(), here, atol=0.004)
    np.testing.assert_allclose(here, K_REF, atol=0.01)


@pytest.mark.slow
def test_the_observer_finds_loads_and_weak_muscles():
    effects = {"dead_time": 0.02, "encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}
    off = plant(force_gains=np.array([1.05, 0.95, 0.95, 1.05, 1.05, 0.95]), **effects)
    weights = Weights(theta=1 / (0.08 * DEG) ** 2, omega=1 / (10 * DEG) ** 2, rate=1 / (1 * BAR) ** 2)
    late = Compensation(dead_time=0.02)
    mpc, observer = TrackingMPC(ARM, compensation=late, weights=weights), KalmanObserver(ARM, 0.01, compensation=late)
    load = np.array([1.0, 0.0])
    done = simulate(off, mpc, hold(ARM, 4.0), observer=observer, load=lambda t: load)
    last = (done.theta - done.theta_ref)[-100:] / DEG
    assert np.abs(last.mean(axis=0)).max() <= 0.05
    blind = simulate(off, mpc, hold(ARM, 4.0), load=lambda t: load)
    assert np.abs((blind.theta - blind.theta_ref)[-100:].mean(axis=0)).max() / DEG > 1.0  # without it


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"theta_ref": (23.0, 17.0)}, "degrees"),
        ({"K_ref": [[1.0, 2.0], [2.0, 1.0]]}, "positive definite"),
        ({"K_ref": [[9.0, 2.0], [1.0, 9.0]]}, "not symmetric"),
        ({"d": (np.nan, 0.0)}, "not finite"),
    ],
)
def test_what_cannot_be_meant_holds_the_pressures_and_says_so(controller, change, said):
    controller.reset()
    x = ARM.at_rest((0.1, 0.2), K_REF)
    good = {"theta_ref": (0.1, 0.2), "K_ref": K_REF, "d": 0.0}
    with pytest.warns(BadNumbers, match=said):
        plan = controller.step(x, **(good | change))
    assert plan.status is PlanStatus.BAD_INPUT
    assert plan.rung is Rung.HOLD
    np.testing.assert_allclose(plan.u[0], x[4:])


@pytest.mark.parametrize(
    ("argument", "value", "said"),
    [
        ("x", np.zeros(9), "n = 2 angles"),
        ("theta_ref", np.zeros(3), r"a value \(2,\) or a preview \(21, 2\)"),
        ("K_ref", np.eye(3), r"\(21, 2, 2\)"),
        ("d", np.zeros(3), "n = 2"),
    ],
)
def test_shapes_that_are_wrong_raise(controller, argument, value, said):
    good = {"x": ARM.at_rest((0.1, 0.2), K_REF), "theta_ref": (0.1, 0.2), "K_ref": K_REF, "d": 0.0}
    with pytest.raises(InvalidInput, match=said):
        controller.step(**(good | {argument: value}))


def test_an_angle_that_is_not_measured_is_predicted_and_after_a_while_the_pressures_are_held(controller):
    controller.reset()
    x = ARM.at_rest((0.1, 0.2), K_REF)
    for _ in range(3):
        controller.step(x, (0.1, 0.2), K_REF)
    x[0] = np.nan
    plans = [controller.step(x, (0.1, 0.2), K_REF) for _ in range(25)]
    assert plans[0].status is PlanStatus.NO_MEASUREMENT
    assert plans[0].rung is Rung.QP
    assert plans[-1].status is PlanStatus.BLIND
    assert plans[-1].rung is Rung.HOLD


def test_random_states_never_get_commands_beyond_the_limits(controller):
    rng, (low, high) = np.random.default_rng(11), ARM.mechanism.pressure_limits
    left, right = ARM.angle_limits
    for _ in range(40):
        controller.reset()
        x = np.concatenate([rng.uniform(1.1 * left, 1.1 * right), rng.normal(0, 4, 2), rng.uniform(low, high, 6)])
        ask = rng.uniform(1.5 * left, 1.5 * right)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BadNumbers)
            plan = controller.step(x, ask, np.diag(rng.uniform(1, 25, 2)))
        assert np.isfinite(plan.u).all()
        assert low <= plan.u.min() <= plan.u.max() <= high
        steps = np.diff(plan.u, axis=0, prepend=x[None, 4:])
        assert np.abs(steps).max() <= ARM.slew * 0.01 * (1 + 1e-9)


def test_soft_limits_of_the_joints_hold_where_they_can(controller):
    controller.reset()
    _, right = ARM.angle_limits
    beyond = np.array([right[0] + 0.2, 0.0])
    run_into = plant()
    run_into.reset((right[0] - 0.05, 0.0), ARM.at_rest((right[0] - 0.05, 0.0), K_REF)[4:])
    worst = -1.0
    for _ in range(150):
        x = np.concatenate([run_into.q, run_into.omega, run_into.P])
        run_into.step(controller.step(x, beyond, K_REF).u[0], 0.01)
        worst = max(worst, run_into.q[0] - right[0])
    assert -0.5 * DEG < worst < 0.02 * DEG


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InvalidInput, match="blocks"):
        TrackingMPC(ARM, N=10, blocks=(1, 2, 3))
    with pytest.raises(InvalidInput, match="dt = 5 s"):
        TrackingMPC(ARM, dt=5.0)
    with pytest.raises(InvalidInput, match="dead_time"):
        TrackingMPC(ARM, compensation=Compensation(dead_time=-1.0))


@pytest.mark.parametrize("name", ["circle", "reach", "hold"])
def test_references_are_smooth_and_within_reach(name):
    asked = reference(name, ARM)
    fine = asked.resampled(asked.duration / 2000)
    q, K = fine.theta[:2001], fine.K[:2001]
    left, right = ARM.angle_limits
    assert ((left < q) & (q < right)).all()
    assert (np.linalg.eigvalsh(K) > 1).all()
    speed = np.diff(q, axis=0) * 2000 / asked.duration
    assert np.abs(np.diff(speed, axis=0)).max() < 0.05
    assert reach(ARM).duration == pytest.approx(6.5)
