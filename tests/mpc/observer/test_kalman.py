"""The observer: it knows how well it knows, finds the torque, and says when it is blind."""

from dataclasses import replace
from math import inf

import control
import numpy as np
import pytest
from scipy.stats import chi2

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import PlanStatus, Plant, Reference, TrackingMPC, simulate
from mpc.codegen.buffered import Buffered
from mpc.model.compensation import Compensation
from mpc.model.faults import FrozenSensors
from mpc.model.friction.dahl import Friction
from mpc.model.real import RealPlant
from mpc.observer.base import BadNumbers, Differentiator
from mpc.observer.filter import Belief, Noise
from mpc.observer.gating import Verdict
from mpc.observer.kalman import KalmanObserver

pytestmark = pytest.mark.compiles

DT = 0.01
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
REST = PLANT.at_rest(0.0, 5.5)
STEP = Buffered(PLANT.discrete(DT))


def watched(observer, real, steps, u=REST[2:], silent=()):
    """Estimates (steps, 5) and true states (steps, 4) with constant commands; in samples `silent` all sensors are."""
    experiment, estimates, truth = real.begin(DT, REST, 1), [], []
    for k in range(steps):
        y = np.where(k in silent, np.nan, experiment.measure())
        x, d = observer.estimate(y, u if k else REST[2:])
        estimates.append([*x, d])
        truth.append(experiment.x)
        experiment.advance(u)
    return np.array(estimates), np.array(truth)


def test_the_squared_error_matches_the_covariance_on_the_nominal_plant_with_the_model_s_noise():
    """NEES over 40 runs within its two-sided 95 % band about 95 % of the time (Bar-Shalom 2001, section 5.4)."""
    noise, runs, steps = Noise(d_walk=1.0), 40, 150
    rng, observer = np.random.default_rng(7), KalmanObserver(PLANT, DT, noise)
    Q, R = np.linalg.cholesky(noise.Q(DT) + 1e-24 * np.eye(5)), np.sqrt(noise.R())
    spread = np.linalg.cholesky(observer.filter.stationary)
    nees = np.zeros((runs, steps))
    for run in range(runs):
        observer.reset()
        observer.estimate(np.array([REST[0], np.nan, *REST[2:]]), REST[2:])
        observer.belief = Belief(np.append(REST, 0.0), observer.filter.stationary)
        xi = observer.belief.xi + spread @ rng.standard_normal(5)
        for k in range(steps):
            u = REST[2:] + 0.3 * BAR * np.array([np.sin(k / 10), -np.sin(k / 10)])
            xi = np.append(STEP(xi[:4], u, xi[4])[0][0], xi[4]) + Q @ rng.standard_normal(5)
            theta, *P = xi[[0, 2, 3]] + R @ rng.standard_normal(3)
            observer.estimate(np.array([theta, np.nan, *P]), u)
            error = observer.belief.xi - xi
            nees[run, k] = error @ np.linalg.solve(observer.belief.covariance, error)
    low, high = chi2.ppf([0.025, 0.975], 5 * runs) / runs
    mean = nees.mean(axis=0)
    assert ((mean > low) & (mean < high)).mean() > 0.88
    assert mean.mean() == pytest.approx(5.0, rel=0.05)


def test_the_covariance_begins_at_the_stationary_one_of_python_control():
    observer = KalmanObserver(PLANT, DT)
    middle = np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR])
    scale = np.array([1, 1, BAR, BAR, 1])

    def f(xi):
        return np.append(STEP(xi[:4], middle[2:], xi[4])[0][0], xi[4])

    xi = np.append(middle, 0.0)
    h = 1e-5 * scale
    A = np.stack([(f(xi + e) - f(xi - e)) / (2 * h[i]) for i, e in enumerate(np.diag(h))], axis=1)
    A = A / scale[:, None] * scale
    Q, R = observer.noise.Q(DT) / np.outer(scale, scale), observer.noise.R() / np.outer(*2 * [scale[[0, 2, 3]]])
    _, P, _ = control.dlqe(A, np.eye(5), np.eye(5)[[0, 2, 3]], Q, R)
    np.testing.assert_allclose(observer.filter.stationary / np.outer(scale, scale), P, rtol=1e-4, atol=1e-12)


def test_a_constant_torque_is_found_without_an_offset():
    real = RealPlant(PLANT, torque_profile=((0.0, 1.0),))
    estimates, truth = watched(KalmanObserver(PLANT, DT), real, 200)
    assert estimates[-1, 4] == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(estimates[-1, :2], truth[-1, :2], atol=1e-5)


def test_known_dead_time_dead_band_and_friction_do_not_look_like_a_torque():
    friction = Friction.of_width(PLANT, 5 * DEG)
    real = RealPlant(PLANT, friction=friction, dead_time=0.03, dead_band=0.1 * BAR)
    u = REST[2:] + np.array([0.8, -0.8]) * BAR
    knowing = KalmanObserver(PLANT, DT, compensation=Compensation(friction, 0.03, 0.1 * BAR))
    ignorant = KalmanObserver(PLANT, DT)
    d, d_ignorant = (np.abs(watched(o, real, 60, u)[0][:, 4]).max() for o in (knowing, ignorant))
    assert d < 0.1
    assert d_ignorant > 3 * d


def test_a_known_flow_is_in_the_predicted_pressures():
    """Of new commands 2 bar away, without readings of pressures."""
    real = RealPlant(PLANT, flow=2 * BAR)
    u = REST[2:] + np.array([2.0, -1.0]) * BAR
    knowing = KalmanObserver(PLANT, DT, compensation=Compensation(flow=2 * BAR), tolerance=1.0)
    for observer, most in ((knowing, 0.01), (KalmanObserver(PLANT, DT, tolerance=1.0), inf)):
        estimates, truth = watched(observer, real, 40, u, silent=range(5, 40))
        off = np.abs(estimates[5:, 2:4] - truth[5:, 2:]).max() / BAR
        assert off < most
    assert off > 0.3


def test_a_short_silence_is_bridged_and_a_long_one_reported_until_it_ends():
    observer = KalmanObserver(PLANT, DT, tolerance=0.05)
    estimates, truth = watched(observer, RealPlant(PLANT), 80, REST[2:] + 0.2 * BAR, silent=range(30, 50))
    answered = np.isfinite(estimates[:, [0, 2, 3]]).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(~answered), np.arange(35, 50))
    np.testing.assert_allclose(estimates[30:35, 2:4], truth[30:35, 2:], rtol=1e-3)
    np.testing.assert_allclose(estimates[-1, :4], truth[-1], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("absurd", [1e300, -np.inf, 8.0])  # the last only as an angle: more than a turn
def test_what_no_sensor_could_say_counts_as_silence(absurd):
    twins = KalmanObserver(PLANT, DT), KalmanObserver(PLANT, DT)
    good = np.array([0.0, np.nan, *REST[2:]])
    for observer, reading in zip(twins, (absurd, np.nan), strict=True):
        observer.estimate(good, REST[2:])
        observer.estimate(np.array([reading, np.nan, reading if abs(reading) > 10 else np.nan, REST[3]]), REST[2:])
    (x, d), (x_silent, d_silent) = (observer.estimate(good, REST[2:]) for observer in twins)
    np.testing.assert_array_equal(x, x_silent)
    assert d == d_silent


def test_the_controller_says_that_its_observer_is_blind():
    observer, mpc = KalmanObserver(PLANT, DT, tolerance=0.0), TrackingMPC(PLANT, N=5)
    y = np.array([0.0, np.nan, *REST[2:]])
    statuses = []
    for read in (y, np.full(4, np.nan), y):
        x, d = observer.estimate(read, REST[2:])
        statuses.append(mpc.step(x, 0.0, 5.5, d).status)
    assert statuses == [PlanStatus.OPTIMAL, PlanStatus.NO_MEASUREMENT, PlanStatus.OPTIMAL]


def test_before_the_first_angle_there_is_no_state_and_then_there_is():
    observer, mpc = KalmanObserver(PLANT, DT), TrackingMPC(PLANT, N=5)
    answers = []
    for theta in (np.nan, 1e9, 0.0):
        x, d = observer.estimate(np.array([theta, np.nan, *REST[2:]]), REST[2:])
        answers.append((np.isnan(x[0]), mpc.step(x, 0.0, 5.5, d)))
    assert [nothing for nothing, _ in answers] == [True, True, False]
    assert [plan.status for _, plan in answers] == [PlanStatus.BLIND, PlanStatus.BLIND, PlanStatus.OPTIMAL]
    np.testing.assert_array_equal(answers[0][1].u[0], REST[2:])  # held


def test_without_an_observer_the_velocity_is_the_angles_difference():
    plain = Differentiator(DT)
    plain.estimate(np.array([0.1, np.nan, 1e5, 1e5]), REST[2:])
    x, d = plain.estimate(np.array([0.11, np.nan, 1e5, 1e5]), REST[2:])
    assert x[1] == pytest.approx(1.0)
    assert d == 0.0


def test_with_the_observer_a_load_nobody_told_of_leaves_no_error_of_the_angle():
    real = RealPlant(PLANT, torque_profile=((0.3, 1.0),))
    reference = Reference([0, 2], [0.0, 0.0], [5.5, 5.5])
    run = simulate(real, TrackingMPC(PLANT), reference, observer=KalmanObserver(PLANT, DT))
    blind = simulate(real, TrackingMPC(PLANT), reference)
    assert abs(run.theta[-1]) < 0.005 * DEG
    assert abs(blind.theta[-1]) > 1 * DEG
    assert run.estimate[-1, 4] == pytest.approx(1.0, rel=0.01)


# --- frozen sensors ---------------------------------------------------------------------------------------------------


def answered(real, steps, u=lambda k: REST[2:], tolerance=0.1):
    """Whether (θ, P1, P2) were answered, (steps, 3)."""
    observer, experiment, seen = KalmanObserver(PLANT, DT, tolerance=tolerance), real.begin(DT, REST, 1), []
    for k in range(steps):
        x, _ = observer.estimate(experiment.measure(), u(k - 1) if k else REST[2:])
        seen.append(np.isfinite(x[[0, 2, 3]]))
        experiment.advance(u(k))
    return np.array(seen)


def swinging(k):
    return REST[2:] + 0.8 * BAR * np.sin(k / 15) * np.array([1, -1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "real",
    [
        RealPlant(PLANT),
        RealPlant(PLANT, encoder=0.5 * DEG),
        RealPlant(PLANT, encoder=0.02 * DEG, pressure_noise=0.02 * BAR),
        replace(RealPlant.standard(), encoder=0.1 * DEG),
    ],
    ids=["ideal", "coarse encoder", "noise", "all effects"],
)
def test_a_joint_at_rest_is_not_taken_for_frozen_sensors(real):
    assert answered(real, 1000).all()
    assert answered(real, 600, swinging).all()


@pytest.mark.parametrize("sensor", [0, 2, 3], ids=["angle", "P1", "P2"])
def test_a_sensor_that_freezes_in_motion_is_reported_after_the_stated_time_until_it_moves_again(sensor):
    real = replace(RealPlant(PLANT, pressure_noise=0.02 * BAR), faults=(FrozenSensors(0.5, 1.0, sensors=(sensor,)),))
    seen = answered(real, 150, swinging)
    reported = np.flatnonzero(~seen[:, [0, 2, 3].index(sensor)])
    assert 60 <= reported[0] <= 75
    np.testing.assert_array_equal(reported, np.arange(reported[0], 100))
    assert np.delete(seen, [0, 2, 3].index(sensor), axis=1).all()


def test_a_joint_that_sticks_is_found_again_as_soon_as_it_moves():
    """Its angle rests while pressures change, so the encoder is taken for frozen; its next step is no jump."""
    observer = KalmanObserver(PLANT, DT)
    push = np.array([1.0, -1.0])
    for k in range(60):
        u = REST[2:] + min(0.01 * k, 0.3) * BAR * push
        observer.estimate(np.array([REST[0], np.nan, *u]), u)
    assert observer.verdicts[0] is Verdict.FROZEN
    astray = observer.belief.xi[0] - REST[0]
    assert abs(astray) > 5 * DEG  # farther than a joint moves in a sample
    for k in range(1, 4):
        theta = REST[0] + 0.1 * k * DEG
        x, _ = observer.estimate(np.array([theta, np.nan, *u]), u)
        assert observer.verdicts[0].counts
        assert x[0] == pytest.approx(theta, abs=0.2 * DEG)


def test_once_a_sensor_is_known_to_be_frozen_the_estimate_is_that_without_it():
    silent, frozen = (
        watched(
            KalmanObserver(PLANT, DT), RealPlant(PLANT, encoder=0.02 * DEG, faults=faults), 120, REST[2:] + 0.5 * BAR
        )
        for faults in ((), (FrozenSensors(0.1, 0.8, sensors=(2,)),))
    )
    np.testing.assert_allclose(frozen[0][40:80, 3], frozen[1][40:80, 3], atol=0.05 * BAR)
    np.testing.assert_allclose(frozen[0][40:80, 0], silent[0][40:80, 0], atol=0.1 * DEG)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"theta": np.nan}, "theta = nan"), ({"pressure": 0.0}, "pressure = 0"), ({"d_walk": -1.0}, "d_walk = -1")],
)
def test_noise_that_cannot_be_meant_is_named(wrong, said):
    with pytest.raises(InvalidInput, match=f"Noise: {said}"):
        Noise(**wrong)


@pytest.mark.parametrize("observer", [KalmanObserver(Plant(), 0.01), Differentiator(0.01)], ids=["kalman", "none"])
def test_pressures_in_bar_are_pointed_out_once_when_a_vented_joint_shows_them(observer):
    observer.estimate(np.array([0.1, np.nan, 0.0, 0.0]), np.array([5e3, 5e3]))
    for _ in range(2):
        with pytest.warns(BadNumbers, match="pressures of y: P.* = 0.4 Pa is next to nothing; if bar was meant"):
            observer.estimate(np.array([0.1, np.nan, 0.4, 0.3]), np.array([5e3, 5e3]))
        observer.estimate(np.array([0.1, np.nan, 0.5, 0.3]), np.array([5e3, 5e3]))
        observer.reset()
