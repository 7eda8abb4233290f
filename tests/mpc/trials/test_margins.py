"""Margins of a loop, against a disturbance of one frequency that is injected, and against a delay that breaks it."""

from dataclasses import replace

import control
import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Arm, Compensation, KalmanObserver, Plant, TrackingMPC
from mpc.model.friction.dahl import Friction
from mpc.model.real import RealArm, RealPlant
from mpc.tracking.cost import Weights
from mpc.trials import hold
from mpc.trials.loops import Settings, loop, margins_in_words, sliding_margins
from mpc.trials.margins import LISTEN, UNHELD, Margins, margins, middle_posture, usual_postures
from mpc.trials.robust import robust_weights

pytestmark = pytest.mark.compiles

DT = 0.01
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
TOLD = Compensation(dead_time=0.03)
POSTURE = (0.3, 6.0)
CALM = Weights.calm()


@pytest.fixture(scope="module", params=["mpc", "lqr"])
def parts(request):
    return loop(request.param, Settings(PLANT, DT, compensation=TOLD, weights=CALM))


@pytest.fixture(scope="module")
def found(parts):
    return margins(*parts, [POSTURE])[0]


def injected(parts, frequency, seconds=12.0, delta=1e-5):
    """|S| at a frequency [Hz]: readings disturbed by a sine, over the disturbance."""
    controller, observer = parts
    controller.rest = False
    controller.reset()
    observer.reset()
    x0 = PLANT.at_rest(*POSTURE)
    trial, u = RealPlant(PLANT, dead_time=TOLD.dead_time).begin(DT, x0, 0), x0[2:]
    t, read = DT * np.arange(round(seconds / DT)), []
    for now in t:
        y = trial.measure()
        y[0] += delta * np.sin(2 * np.pi * frequency * now)
        read.append(y[0])
        x, d = observer.estimate(y, u)
        u = controller.step(x, *POSTURE, d).u[0]
        trial.advance(u)
    late = t >= seconds / 2
    wave = np.exp(-2j * np.pi * frequency * t[late])
    whole = int(np.floor(frequency * seconds / 2) / frequency / DT)  # whole periods
    return 2 * abs(np.mean(((np.array(read) - POSTURE[0])[late] * wave)[:whole])) / delta


def test_the_sensitivity_is_what_an_injected_sine_meets(parts, found):
    for frequency in (0.7, 2.0, found.peak_frequency, 8.0):
        expected = np.interp(frequency, found.frequency, np.abs(found.S))
        assert injected(parts, frequency) == pytest.approx(expected, rel=0.05)


def test_gain_and_phase_margins_are_those_of_python_control(found):
    locus = control.frd(found.L[0], 2 * np.pi * found.frequency, smooth=True)
    gain, phase, *_ = control.stability_margins(locus, returnall=True)
    assert found.gain_margin == pytest.approx(gain[gain > 1].min(), rel=1e-4)
    assert found.phase_margin == pytest.approx(np.abs(phase).min() * DEG, rel=1e-4)


def test_without_feedback_every_margin_is_infinite():
    alone = Margins.of(0.0, 5.0, np.eye(1, 800)[0], 0.01)  # the readings are the disturbance
    assert alone.sensitivity_peak == pytest.approx(1.0)
    assert np.isinf([alone.gain_margin, alone.phase_margin, alone.delay_margin]).all()
    assert np.isnan([alone.inertia_margin, alone.inertia_frequency]).all()  # not computed
    assert "inertia" not in str(alone)
    sprung = control.sample_system(control.tf([1.0], [1.0, 2.0, 40.0]), 0.01)  # passive: any inertia may be added
    pulse = control.forced_response(sprung, 0.01 * np.arange(800), np.eye(1, 800)[0]).outputs
    passive = Margins.of(0.0, 5.0, np.eye(1, 800)[0], 0.01, swing=pulse[:, None, None])
    assert passive.inertia_margin == np.inf


def test_the_short_response_gives_the_margins_of_the_long_one(parts, found):
    [long] = margins(*parts, [POSTURE], listen=LISTEN)
    assert found.sensitivity_peak == pytest.approx(long.sensitivity_peak, rel=1e-3)
    assert found.gain_margin == pytest.approx(long.gain_margin, rel=5e-3)
    assert found.delay_margin == pytest.approx(long.delay_margin, rel=2e-2)
    assert (found.S != long.S).any()  # the tail after two seconds is left out


def test_a_loop_that_has_not_decayed_is_listened_to_longer():
    heavy = Settings(replace(PLANT, inertia=2.0), DT, compensation=TOLD, weights=Weights.calm(8.0))
    parts = loop("mpc", heavy)
    [found], [long] = margins(*parts, [POSTURE]), margins(*parts, [POSTURE], listen=LISTEN)
    np.testing.assert_array_equal(found.S, long.S)


def swung(parts, real, posture=POSTURE):
    """Angles [rad] of the first joint of a loop on a real machine, after a small disturbance of its reading."""
    controller, observer = parts
    controller.rest = False
    controller.reset()
    observer.reset()
    x0, n = controller.plant.at_rest(*posture), controller.plant.n
    trial, u, angles = real.begin(DT, x0, 0), x0[2 * n :], []
    for k in range(1500):
        y = trial.measure()
        y[0] += 1e-5 * (k == 100)
        x, d = observer.estimate(y, u)
        u = controller.step(x, *posture, d).u[0]
        trial.advance(u)
        angles.append(trial.x[0])
    return np.array(angles)


def with_payload(factor):
    """The joint with so many times the inertia."""
    return RealPlant(replace(PLANT, inertia=factor * PLANT.inertia), dead_time=TOLD.dead_time)


def rings(angles):
    """Whether they swing more and more."""
    return np.ptp(angles[-100:]) > np.ptp(angles[100:300])


def test_a_loop_stands_a_little_less_delay_than_its_margin_and_no_more(parts, found):
    for share in (0.9, 1.1):
        real = RealPlant(PLANT, dead_time=TOLD.dead_time, reading_age=share * found.delay_margin)
        assert rings(swung(parts, real)) == (share > 1)


def test_a_loop_carries_a_little_less_inertia_than_its_margin_and_no_more(parts, found):
    assert 1.5 < found.inertia_margin < 10
    assert not rings(swung(parts, with_payload(0.9 * found.inertia_margin)))
    ringing = swung(parts, with_payload(1.1 * found.inertia_margin))
    assert rings(ringing)
    late = ringing[-500:] - ringing[-500:].mean()
    turns = np.count_nonzero(np.diff(np.signbit(late)))
    assert turns / 2 / (late.size * DT) == pytest.approx(found.inertia_frequency, rel=0.1)


@pytest.mark.slow
def test_an_arm_carries_a_little_less_mass_than_its_margin_and_no_more():
    arm, told = Arm.machine("arm26"), Compensation(dead_time=0.02)
    parts = loop("mpc", Settings(arm, DT, 10, told).calm)
    posture = usual_postures(arm)[1]
    found = margins(*parts, [posture])[0]
    for share in (0.9, 1.1):
        real = RealArm(arm, mass=share * found.inertia_margin, dead_time=told.dead_time)
        assert rings(swung(parts, real, posture)) == (share > 1)


def test_dead_time_costs_margin_and_slow_commands_buy_it():
    def peak(weights, dead_time):
        told = Compensation(dead_time=dead_time)
        parts = loop("mpc", Settings(PLANT, DT, compensation=told, weights=weights))
        return margins(*parts, [POSTURE])[0].sensitivity_peak

    calm = peak(CALM, 0.03)
    assert peak(CALM, 0.0) < calm
    assert peak(replace(CALM, rate=16 * CALM.rate), 0.03) < calm


def test_the_usual_postures_are_in_the_joint_range(parts):
    found = margins(*parts)
    assert len(found) == 3
    assert all(PLANT.angle_limits[0] < m.theta < PLANT.angle_limits[1] for m in found)
    assert "M_s" in str(found[0])


def test_a_loop_that_swings_has_no_margin():
    undamped = replace(PLANT, gas=False)
    parts = loop("pid", Settings(undamped, DT, compensation=TOLD))
    found = margins(*parts, [POSTURE])[0]
    assert not found.stable
    assert found.sensitivity_peak == np.inf
    assert found.delay_margin == 0.0
    assert found.inertia_margin == 1.0


def test_commands_that_rest_and_what_is_not_linear_have_no_part():
    told = Compensation(Friction(mu=0.05), dead_time=TOLD.dead_time, dead_band=0.1 * BAR)
    [found] = sliding_margins("mpc", Settings(PLANT, DT, compensation=told, weights=CALM), [POSTURE])
    controller, observer = loop("mpc", Settings(PLANT, DT, compensation=TOLD, weights=CALM))
    [expected] = margins(controller, observer, [POSTURE])
    assert found.sensitivity_peak == pytest.approx(expected.sensitivity_peak)
    assert controller.rest  # as before


@pytest.mark.parametrize("told", [Compensation(Friction(mu=0.05)), Compensation(dead_band=0.1 * BAR)])
def test_friction_and_dead_bands_that_are_told_are_refused(told):
    parts = TrackingMPC(PLANT, DT, compensation=told), KalmanObserver(PLANT, DT, compensation=told)
    with pytest.raises(InvalidInput, match="without friction and dead band"):
        margins(*parts, [(5 * DEG, 5.5 + 0 * BAR)])


def test_the_sum_of_dead_time_and_reading_age_counts():
    peaks = []
    for told in (Compensation(dead_time=0.05), Compensation(dead_time=0.03, reading_age=0.02)):
        (one,) = sliding_margins("mpc", Settings(PLANT, DT, compensation=told, weights=CALM), [POSTURE])
        peaks.append((one.sensitivity_peak, one.peak_frequency))
    assert peaks[1] == pytest.approx(peaks[0], rel=0.01)


def test_a_joint_that_gravity_keeps_from_its_ends_has_margins_in_the_middle():
    heavy = Plant(gravity_torque=9.0, hanging_angle=0.5)
    assert len(usual_postures(heavy)) == 1
    theta, K = middle_posture(heavy)
    assert theta == pytest.approx(0.0)
    assert K == usual_postures(heavy)[0][1]


def test_postures_of_an_arm_that_are_not_stable_are_left_out(monkeypatch):
    arm = Arm.machine("arm26")
    assert middle_posture(arm)[0] == pytest.approx(arm.middle)
    monkeypatch.setattr(Arm, "tracked_stiffness", lambda self, x: np.diag([-1.0, 2.0]))
    assert usual_postures(arm) == []
    settings = Settings(arm, DT)
    assert margins_in_words("mpc", settings, hold(arm, 1.0), loop("mpc", settings)[0]) == [UNHELD]
    with pytest.raises(InvalidInput, match="none of its usual postures"):
        robust_weights(arm, DT)
