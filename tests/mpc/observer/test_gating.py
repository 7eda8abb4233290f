"""What no joint can have done is not believed, what it can have done is, and no reading ends a loop."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocator import BAR, DEG, report_joint, stiffness_interval
from allocator.muscles.catalogue import (
    MARTENS_DMSP_20_300,
    SAROSI_DMSP_20_400N,
    TONDU_DMSP_20_400N,
    TONDU_MCKIBBEN,
)
from mpc import Compensation, KalmanObserver, Plant, RealPlant, Reference, Rung, TrackingMPC, Weights, simulate, sine
from mpc.model.faults import SupplyDrop, WrongReadings
from mpc.observer.filter import Belief
from mpc.observer.gating import Gate, SensorGate, Verdict
from mpc.observer.pressure_diagnosis import DATA_SHEET

DT, LAG = 0.01, 0.12
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=LAG)
GATE = Gate.of(PLANT, DT, (0.01 * DEG, 0.02 * BAR))
REST = PLANT.at_rest(0.1, 5.5)


def loop(real):
    """Controller and observer for a real plant."""
    known = real.known()
    controller = TrackingMPC(real.nominal, DT, 10, weights=Weights.calm(), compensation=known)
    return controller, KalmanObserver(real.nominal, DT, compensation=known)


def reference(samples):
    return sine(amplitude=30 * DEG, K=5.5, frequency=0.25, duration=samples * DT, ramp=1.0, dt=DT)


def fed(observer, readings, u=REST[2:]):
    """Estimates (n, 5) of the angles `readings` [rad], and the verdicts on them; the pressures are right."""
    found, verdicts = [], []
    for theta in readings:
        x, d = observer.estimate(np.array([theta, np.nan, *REST[2:]]), u)
        found.append([*x, d])
        verdicts.append(observer.verdicts[0])
    return np.array(found), verdicts


# --- one gate ---------------------------------------------------------------------------------------------------------


def test_of_a_right_model_s_readings_as_many_are_rejected_as_is_said():
    """Beyond σ² = 36 of χ² with one degree of freedom lie 2·10⁻⁹; with 3 in place of 6 what is seen can be counted."""
    gate, rng = SensorGate(replace(GATE, floor=(0.0, 0.0, 0.0)), 0, DT), np.random.default_rng(0)
    beyond = [gate.width(1e-6) / 2 < abs(reading) for reading in 1e-3 * rng.standard_normal(200_000)]
    assert np.mean(beyond) == pytest.approx(0.0027, rel=0.1)
    readings = 1e-6 * rng.normal(size=1000)
    assert all(SensorGate(GATE, 0, DT).check(y, 0.0, 0.0, 1e-12) is Verdict.BELIEVED for y in readings)


def test_a_gate_that_rejects_opens_slowly_whatever_the_variance_has_become():
    gate, widest = SensorGate(GATE, 0, DT), GATE.floor[0]
    verdicts = [gate.check(0.5 + 1e-3 * k, 0.0, 0.0, 1.0 if k else 0.0) for k in range(30)]
    assert set(verdicts) == {Verdict.REJECTED}
    assert gate.check(0.9 * widest, 0.0, 0.0, 1.0) is Verdict.BELIEVED


@pytest.mark.parametrize(
    ("reading", "verdict"),
    [(np.nan, Verdict.SILENT), (np.inf, Verdict.SILENT), (1e300, Verdict.IMPOSSIBLE), (-2.6, Verdict.IMPOSSIBLE)],
)
def test_what_no_sensor_of_this_joint_says_is_named(reading, verdict):
    assert SensorGate(GATE, 0, DT).check(reading, 0.0, 0.0, 1e-6) is verdict


@given(theta=st.floats(-1.5, 1.5), turns=st.integers(-1000, 1000))
def test_whole_turns_are_unwrapped(theta, turns):
    assert GATE.unwrapped(theta + 2 * np.pi * turns, theta + 0.01) == pytest.approx(theta, abs=1e-9)
    assert GATE.unwrapped(theta + 1.0, theta) == theta + 1.0


def test_the_numbers_follow_from_the_joint():
    """A load as great as the muscles' torque moves a light joint farther before anybody can know of it."""
    light = Gate.of(replace(PLANT, inertia=0.01), DT)
    assert light.jump[0] > 2 * GATE.jump[0]
    assert Gate.of(Plant(report_joint(MARTENS_DMSP_20_300)), DT).upper[1] > 5 * BAR
    stopped = replace(PLANT.joint, angle_limits=(-0.5, 0.6))
    free = replace(PLANT.joint, angle_limits=None)
    assert Gate.of(replace(PLANT, joint=stopped), DT).upper[0] == pytest.approx(0.6 + 10 * DEG)
    assert Gate.of(replace(PLANT, joint=free), DT).upper[0] == pytest.approx(free.angle_range[1] + 90 * DEG)


SCALE = np.outer(*2 * [[1, 10, BAR, BAR, 10]])

# --- the observer -----------------------------------------------------------------------------------------------------


@pytest.mark.compiles
def test_a_spike_leaves_no_trace():
    clean, hit = KalmanObserver(PLANT, DT), KalmanObserver(PLANT, DT)
    readings = REST[0] + 0.01 * DEG * (np.arange(60) % 7 == 3)
    wrong = readings.copy()
    wrong[[20, 40, 41, 42]] += [0.3, -0.01, 1.0, 6.0]
    (usual, _), (got, verdicts) = fed(clean, readings), fed(hit, wrong)
    assert [k for k, v in enumerate(verdicts) if v is not Verdict.BELIEVED] == [20, 40, 41, 42]
    np.testing.assert_array_less(np.abs(got[-1] - usual[-1]), [1e-6, 1e-5, 1.0, 1.0, 1e-4])


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "gas"), [(-20, True), (3, False), (4, True), (10, True)])
def test_an_encoder_that_has_lost_its_zero_is_followed_after_half_a_second_and_once(offset, gas):
    real = RealPlant.standard(nominal=replace(RealPlant.standard().nominal, gas=gas))
    pair = loop(real)
    shifted = WrongReadings(2.0, 8.0, (0,), offset * DEG, added=True)
    verdicts, estimate = [], pair[1].estimate

    def listening(y, u):
        answer = estimate(y, u)
        verdicts.append(pair[1].verdicts[0])
        return answer

    pair[1].estimate = listening
    run = simulate(replace(real, faults=(shifted,)), pair[0], reference(800), observer=pair[1])
    seen = (run.theta - run.theta_ref) / DEG + offset * (run.t >= 2.0 - 1e-9)
    assert verdicts.count(Verdict.ACCEPTED) == 1
    assert 0.5 <= verdicts.index(Verdict.ACCEPTED) * DT - 2.0 <= 0.6
    assert np.abs(seen[400:]).max() < 2.0
    assert np.abs((run.theta - run.theta_ref)[200:250]).max() < 3 * DEG  # nothing is thrown about meanwhile


def test_an_angle_that_has_jumped_and_creeps_over_the_steps_of_its_encoder_is_believed():
    """It repeats once after each step, as that of a joint does which friction nearly holds."""
    observer, step, samples = KalmanObserver(PLANT, DT, compiled=False), 0.02 * DEG, np.arange(200)
    _, verdicts = fed(observer, REST[0] + step * np.concatenate([samples[:50] % 2, 1000 + samples // 2]))
    assert verdicts[50] is Verdict.REJECTED
    assert 0.5 <= (verdicts.index(Verdict.ACCEPTED) - 50) * DT <= 1.2
    assert verdicts[-20:] == [Verdict.BELIEVED] * 20


@pytest.mark.compiles
def test_a_joint_that_is_hit_is_found_again_at_once():
    """A blow of 8 N·m moves it as no model says: readings are doubted for a few samples, and then explained."""
    real = RealPlant(PLANT, encoder=0.02 * DEG, torque_profile=((0.1, 0.1), (0.5, 8.0), (0.6, 0.0)))
    pair = TrackingMPC(PLANT, DT, 10, weights=Weights.calm()), KalmanObserver(PLANT, DT)
    run = simulate(real, pair[0], sine(amplitude=0.0, K=5.5, K_amplitude=0.0, duration=4.0), observer=pair[1])
    assert np.abs(run.theta).max() > 5 * DEG
    assert set(run.rung) == {Rung.QP}
    assert np.abs(run.theta[-50:]).max() < 0.1 * DEG


def test_a_snapped_cable_throws_the_joint_and_its_muscle_s_pressure_jumps():
    """An angle that moves off is believed at once with the pressure that jumps; a jump alone is not."""
    noise = np.random.default_rng(0).normal(1.0, 0.02, (7, 2))
    jumped = np.array([1.5, 0.01]) * GATE.jump[1] * noise
    for off, verdict in ((0.1 * GATE.jump[0], Verdict.BELIEVED), (0.0, Verdict.REJECTED)):
        observer = KalmanObserver(PLANT, DT)
        fed(observer, [REST[0]] * 50)
        for k, less in enumerate(jumped):
            observer.estimate(np.array([REST[0] + off * k**2, np.nan, *REST[2:] - less]), REST[2:])
        assert [*observer.verdicts] == [Verdict.BELIEVED, verdict, Verdict.BELIEVED]


@pytest.mark.compiles
def test_a_coarse_encoder_s_step_is_learnt():
    real = replace(RealPlant.standard(), encoder=0.5 * DEG)
    pair, wanted = loop(real), reference(600)
    run = simulate(real, pair[0], wanted, observer=pair[1])
    assert np.sqrt(np.mean((run.theta - run.theta_ref)[200:] ** 2)) < 1.5 * DEG
    assert pair[1].encoder_step == pytest.approx(0.5 * DEG)


@pytest.mark.filterwarnings("ignore::mpc.observer.base.BadNumbers")
@pytest.mark.compiles
@settings(max_examples=40, deadline=None)
@given(storm=st.lists(st.lists(st.floats(), min_size=6, max_size=6), min_size=1, max_size=20))
def test_no_numbers_whatever_make_it_raise_or_lose_itself(storm):
    observer = KalmanObserver(PLANT, DT)
    for theta, omega, P1, P2, *u in storm:
        observer.estimate(np.array([theta, omega, P1, P2]), np.array(u))
    observer.reset()
    fed(observer, [REST[0]])
    for theta, omega, P1, P2, *u in storm:
        x, d = observer.estimate(np.array([theta, omega, P1, P2]), np.array(u))
        assert np.isfinite(d)
        assert not np.isinf(x).any()
        assert observer.belief is None or np.linalg.eigvalsh(observer.belief.covariance / SCALE).min() > 0


@pytest.mark.compiles
def test_a_state_that_is_not_finite_is_built_anew_from_the_readings():
    observer = KalmanObserver(PLANT, DT)
    fed(observer, [REST[0]] * 5)
    observer.belief = observer.belief._replace(xi=np.full(5, np.nan))
    found, _ = fed(observer, [REST[0]] * 3)
    assert observer.rebuilt == 1
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[-1, 0], REST[0], atol=1e-6)


# --- the loop ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "muscle",
    [SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_MCKIBBEN, MARTENS_DMSP_20_300],
    ids=["Sarosi", "Tondu", "McKibben", "Martens"],
)
def test_an_encoder_that_is_wrong_for_three_samples_does_not_matter(muscle):
    plant = Plant(report_joint(muscle), lag=0.12)
    K = float(np.mean(stiffness_interval(0.0, 0.0, joint=plant.joint)))
    wanted = sine(amplitude=20 * DEG, K=K, K_amplitude=0.0, duration=2.0, ramp=0.5, dt=DT)
    controller = TrackingMPC(plant, DT, 10, compiled=False)
    observer = KalmanObserver(plant, DT, compiled=False)
    for value in (3.2, 4.9, 6.0, 6.28):
        wrong = WrongReadings(1.0, 1.03, (0,), value)
        run = simulate(replace(RealPlant(plant), faults=(wrong,)), controller, wanted, observer=observer)
        assert np.isfinite(run.u).all()
        assert np.abs(run.theta - run.theta_ref)[150:].max() < 2 * DEG


@pytest.mark.compiles
def test_a_pressure_beyond_the_supply_does_not_move_the_joint():
    real = RealPlant.standard()
    controller, observer = loop(real)
    wanted = sine(amplitude=0.0, K=5.5, K_amplitude=0.0, duration=4.0)
    quiet = simulate(real, controller, wanted, observer=observer)
    hit = simulate(
        replace(real, faults=(WrongReadings(2.0, 2.01, (2,), 49 * BAR),)), controller, wanted, observer=observer
    )
    assert np.abs(hit.theta - quiet.theta).max() < 0.2 * DEG


@pytest.mark.compiles
def test_lags_that_were_not_measured_reject_no_pressure():
    """Without a doubt of the lags, 29 readings are rejected."""
    real = RealPlant(replace(PLANT, lag=2 * LAG))
    untold = replace(real.known(), lag_up=None, lag_down=None)
    t = DT * np.arange(600)
    high = t // 1 % 2 > 0
    jumps = Reference(t, np.where(high, 20, -20) * DEG, np.where(high, 6.0, 4.5))
    verdicts = []

    class Heard(KalmanObserver):
        def estimate(self, y, u):
            found = super().estimate(y, u)
            verdicts.extend(self.verdicts)
            return found

    controller, observer = TrackingMPC(PLANT, DT, 10, compensation=untold), Heard(PLANT, DT, compensation=untold)
    simulate(real, controller, jumps, observer=observer)
    assert set(verdicts) == {Verdict.BELIEVED}


def test_gates_allow_the_pressures_of_quick_and_slow_regulators():
    rng, told = np.random.default_rng(0), Compensation(lag_up=LAG, lag_down=LAG)
    for compensation, spread in ((told, 1.0), (Compensation(), DATA_SHEET)):
        own = KalmanObserver(PLANT, DT, compensation=compensation).filter
        model, quick, slow, apart = REST[2:], REST[2:], REST[2:], np.zeros((2, 2))
        for v in rng.uniform(1 * BAR, 5 * BAR, (50, 2)):
            belief = Belief(np.concatenate([REST[:2], model, [0.0]]), own.stationary)
            apart = own.apart(apart, belief, v)
            model, quick, slow = (
                v + (P - v) * np.exp(-DT / lag)
                for P, lag in ((model, LAG), (quick, LAG / spread), (slow, LAG * spread))
            )
            assert np.allclose(model + apart, [quick, slow], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_an_angle_is_found_again_although_the_supply_has_dropped():
    faults = SupplyDrop(3.0, supply=1.5 * BAR), WrongReadings(5.0, 5.5, (0,), 0.9)
    real = replace(RealPlant.standard(), faults=faults)
    controller, observer = loop(real)
    verdicts, estimate = [], observer.estimate

    def noting(y, u):
        answer = estimate(y, u)
        verdicts.append(observer.verdicts[0])
        return answer

    observer.estimate = noting
    simulate(real, controller, sine(K=5.5, duration=9.0), observer=observer, seed=1)
    assert not any(verdict.counts for verdict in verdicts[501:550])
    assert all(verdict.counts for verdict in verdicts[620:])
