"""Where the reference stands still the commands come to rest, keep all limits, and let go when something happens."""

from dataclasses import replace
from math import copysign, pi

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc import Compensation, KalmanObserver, PlanStatus, Plant, RealPlant, Reference, TrackingMPC, Weights, simulate
from mpc.model.friction.dahl import Friction
from mpc.observer.base import Differentiator
from mpc.observer.filter import Noise
from mpc.trials.loops import Settings, loop
from mpc.trials.metrics import metrics

pytestmark = pytest.mark.compiles

REAL = RealPlant.standard()
TOLD = REAL.known()
DT = 0.01
MOVED, LOADED, END = 1.5, 3.0, 23.0  # [s] end of the move, the load's coming, end
QUIET = LOADED + 6.0  # [s]


@pytest.fixture(scope="module")
def driver():
    return loop("mpc", Settings(REAL.nominal, compensation=TOLD, weights=Weights.calm()))


def move(end=END, angle=60 * DEG):
    t = np.arange(0, end + DT / 2, DT)
    s = np.clip((t - 0.5) / (MOVED - 0.5), 0, 1)
    return Reference(t, angle * (s - np.sin(2 * pi * s) / (2 * pi) - 0.5), np.full_like(t, 5.5))


def driven(driver, real, seed=0, reference=None):
    controller, observer = driver
    loaded = replace(real, torque_profile=((LOADED, 1.0),))
    return simulate(loaded, controller, move() if reference is None else reference, observer=observer, seed=seed)


def rates(run, since):
    """RMS rates of both commands [bar/s]."""
    return np.sqrt(np.mean((np.diff(run.u[round(since / DT) :], axis=0) / DT / BAR) ** 2, axis=0))


def swing(run, since):
    return np.ptp(run.theta[round(since / DT) :]) / DEG


def resting(run):
    return run.status == PlanStatus.RESTING


@pytest.mark.slow
@pytest.mark.parametrize(
    "real",
    [
        REAL,
        RealPlant.standard((0.9, 1.1)),
        RealPlant.standard((1.1, 1.1)),
        replace(REAL, friction=Friction.of_width(REAL.nominal, 3 * DEG, coulomb=0.1, presliding=2 * DEG)),
        replace(REAL, dead_band=0.12 * BAR),
        replace(REAL, dead_band=0.06 * BAR),
    ],
    ids=["standard", "gains swapped", "both +10 %", "other hysteresis", "wider dead band", "narrower dead band"],
)
def test_angle_and_commands_are_still_six_seconds_after_a_load(real, driver):
    run = driven(driver, real)
    assert (rates(run, QUIET) <= 0.02).all()
    assert swing(run, QUIET) <= 0.05
    assert abs((run.theta - run.theta_ref)[round(QUIET / DT) :].mean()) < 0.1 * DEG
    assert metrics(run).limits_kept


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1000, 1004, 1007])
def test_corrections_of_a_rest_end_where_pressures_rise_to_a_narrower_band(seed, driver):
    """They alternated where a rise beyond the band's edge that was told was taken for its play."""
    run = driven(driver, replace(REAL, dead_band=0.06 * BAR), seed, move(16.0))
    assert (rates(run, QUIET) <= 0.02).all()
    assert swing(run, QUIET) <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("load", [0.0, 1.0], ids=["free", "loaded"])
@pytest.mark.parametrize("rubs", [True, False], ids=["hysteresis", "no hysteresis"])
def test_a_rest_is_where_it_should_be_with_sensors_beside_their_regulators(load, rubs):
    """Without an estimate of the offsets twice as much is left for seconds."""
    known = TOLD if rubs else replace(TOLD, friction=Friction())
    real = replace(REAL, friction=known.friction, pressure_offset=(0.05 * BAR, -0.05 * BAR))
    controller = TrackingMPC(REAL.nominal, DT, weights=Weights.calm(), compensation=known)
    left = []
    for noise in (Noise(), Noise(offset=0.0)):
        observer = KalmanObserver(REAL.nominal, DT, noise, known)
        loaded = replace(real, torque_profile=((LOADED, load),))
        run = simulate(loaded, controller, move(14.0), observer=observer, seed=1000)
        error = (run.theta - run.theta_ref) / DEG
        left.append([abs(error[800:900].mean()), abs(error[-200:].mean()), swing(run, 12.0)])
    with_them, without = left
    assert with_them[1] <= 0.05
    assert with_them[2] <= 0.1
    assert with_them[0] < without[0] / 2


@pytest.mark.slow
def test_a_joint_without_the_friction_that_it_should_have_comes_to_rest(driver):
    run = driven(driver, replace(REAL, friction=Friction()))
    assert (rates(run, QUIET) <= 0.02).all()
    assert swing(run, QUIET) <= 0.1
    assert metrics(run).limits_kept


@pytest.mark.slow
def test_without_a_rest_mode_the_same_loop_chatters(driver):
    controller = TrackingMPC(REAL.nominal, weights=Weights.calm(), compensation=TOLD, rest=False)
    run = driven((controller, driver[1]), REAL)
    assert not resting(run).any()
    assert (rates(run, QUIET) > 0.5).all()


def test_a_load_on_a_resting_joint_is_answered_a_sample_after_it_moves(driver):
    held = replace(REAL, torque_profile=())
    reference = move(5.0)
    loaded_at = 4.5
    run = simulate(replace(held, torque_profile=((loaded_at, 1.0),)), driver[0], reference, observer=driver[1])
    came = round(loaded_at / DT)
    assert resting(run)[came - 20 : came + 1].all()
    assert not resting(run)[came + 2 :].any()


def test_a_rest_ends_where_the_preview_begins_to_move(driver):
    controller, observer = driver
    there_and_back = move(5.0)
    theta = there_and_back.theta.copy()
    theta[460:] += 2 * DEG
    run = simulate(REAL, controller, Reference(there_and_back.t, theta, there_and_back.K), observer=observer)
    seen = np.arange(run.u.shape[0]) >= 460 - controller.ahead
    assert resting(run)[460 - controller.ahead - 20 : 460 - controller.ahead].all()
    assert not resting(run)[seen][2:40].any()


class At:
    """A controller told of friction that is fed one steady state."""

    def __init__(self, **settings):
        self.plant = Plant()
        told = Compensation(Friction(coulomb=0.05), dead_band=0.1 * BAR)
        self.controller = TrackingMPC(self.plant, N=5, compensation=told, **settings)
        self.x = self.plant.at_rest(0.3, 7.6)

    def step(self, x=None, theta=0.3, K=7.6):
        return self.controller.step(self.x if x is None else x, theta, K)

    def rested(self):
        plans = [self.step() for _ in range(200)]
        assert plans[-1].status is PlanStatus.RESTING
        return plans[-1]


@pytest.mark.compiles
@pytest.mark.parametrize("lost", range(4), ids=["angle", "velocity", "P1", "P2"])
def test_a_rest_ends_at_once_where_a_state_is_not_measured(lost):
    at = At()
    at.rested()
    x = at.x.copy()
    x[lost] = np.nan
    assert at.step(x).status is PlanStatus.NO_MEASUREMENT
    assert at.step().status is PlanStatus.OPTIMAL  # and it takes its time before the next


@pytest.mark.compiles
def test_a_rest_ends_at_once_where_the_joint_is_pushed_the_reference_moves_or_means_nothing():
    at = At()
    for happens, status in [
        ({"x": at.x + np.array([0.1 * DEG, 0, 0, 0])}, PlanStatus.OPTIMAL),
        ({"theta": 0.3 + 0.01 * DEG}, PlanStatus.OPTIMAL),
        ({"K": 7.61}, PlanStatus.OPTIMAL),
    ]:
        at.rested()
        assert at.step(**happens).status is status
    at.rested()
    with pytest.warns(UserWarning, match="held"):
        assert at.step(theta=np.nan).status is PlanStatus.BAD_INPUT


@pytest.mark.compiles
def test_steps_of_a_coarse_encoder_do_not_end_a_rest_and_a_push_does():
    at, step = At(), np.array([0.05 * DEG, 0, 0, 0])
    flickering = [at.step(at.x + (-1) ** k * step).status for k in range(400)]
    assert set(flickering[-100:]) == {PlanStatus.RESTING}
    assert at.step(at.x + 6 * step).status is PlanStatus.OPTIMAL


@pytest.mark.compiles
def test_a_pressure_that_leaks_ends_the_rest():
    at = At()
    at.rested()
    at.x = at.x - [0, 0, 0.3 * BAR, 0]
    plans = [at.step() for _ in range(60)]
    assert PlanStatus.OPTIMAL in {plan.status for plan in plans}


@pytest.mark.compiles
def test_commands_of_a_rest_hold_the_pressures_on_one_edge_of_the_dead_band_and_stay():
    at = At()
    plan = at.rested()
    np.testing.assert_allclose(plan.u, np.tile(at.x[2:] + 0.05 * BAR, (5, 1)), rtol=1e-9)
    np.testing.assert_array_equal(at.step().u, plan.u)


@pytest.mark.compiles
def test_a_rest_near_the_supply_s_end_holds_the_lower_edge():
    at = At()
    high = 4.9 * BAR
    at.x = np.array([0.0, 0.0, high, high])
    K = float(at.plant.stiffness(at.x))
    plans = [at.step(theta=0.0, K=K) for _ in range(200)]
    assert all((plan.u <= 5 * BAR).all() for plan in plans)
    assert plans[-1].status is PlanStatus.RESTING
    np.testing.assert_allclose(plans[-1].u[0], high - 0.05 * BAR, rtol=1e-9)


@pytest.mark.compiles
@pytest.mark.parametrize("side", [-1, 1])
def test_an_error_is_corrected_by_pressures_that_push_against_it(side):
    at = At()
    plan = at.rested()
    turned = 0.3 + side * 0.1 * DEG
    joint = at.plant.joint
    plans = [at.step(at.x + side * 0.01 * DEG * min(k // 3, 10) * np.eye(4)[0]) for k in range(200)]
    assert {p.status for p in plans} == {PlanStatus.RESTING}
    assert copysign(1, joint.torque(turned, *plans[-1].u[0]) - joint.torque(turned, *plan.u[0])) == -side


@pytest.mark.compiles
def test_a_loop_that_is_told_of_nothing_never_rests_and_settles_exactly():
    plant = Plant()
    for controller in (TrackingMPC(plant), TrackingMPC(plant, rest=False)):
        run = simulate(plant, controller, move(4.0), observer=Differentiator(DT))
        assert not resting(run).any()
        assert abs(run.theta[-1] - run.theta_ref[-1]) < 1e-6


@pytest.mark.slow
def test_what_the_loop_does_before_its_first_rest_does_not_depend_on_the_mode(driver, monkeypatch):
    controller = TrackingMPC(REAL.nominal, weights=Weights.calm(), compensation=TOLD, rest=False)
    in_one_call = driven((controller, driver[1]), REAL)
    for one in (driver[0], controller):  # the stages, which a mode needs where previews stand still
        monkeypatch.setattr(one, "_whole", None)
    with_it, without = driven(driver, REAL), driven((controller, driver[1]), REAL)
    first = int(np.argmax(resting(with_it)))
    assert first > round(MOVED / DT)
    np.testing.assert_array_equal(with_it.u[:first], without.u[:first])
    np.testing.assert_allclose(with_it.u[:first], in_one_call.u[:first], rtol=1e-12)
