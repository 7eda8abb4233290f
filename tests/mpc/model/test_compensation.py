"""What the controller knows beyond its model: dead time, dead band and friction cost no accuracy once it knows them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allocator import BAR, DEG, InvalidInput, PrandtlIshlinskii, report_joint
from allocator.errors import InvalidFile
from allocator.machine_file import dumps
from mpc import Rung, TrackingMPC, Weights, simulate, sine
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.friction.contact import Loads
from mpc.model.friction.dahl import Friction
from mpc.model.plant import Plant
from mpc.model.real import RealPlant
from mpc.observer.kalman import KalmanObserver
from mpc.trials.metrics import metrics

PLANT = RealPlant.standard().nominal
CALM = Weights(theta=1 / (0.3 * DEG) ** 2, omega=1 / (10 * DEG) ** 2, rate=1 / (2 * BAR) ** 2)
MOVE = sine(amplitude=30 * DEG, K=5.5, duration=3, ramp=1)


def rms(real, compensation, controller_plant=PLANT):
    mpc = TrackingMPC(controller_plant, weights=CALM, compensation=compensation)
    run = simulate(real, mpc, MOVE, observer=KalmanObserver(controller_plant, 0.01, compensation=compensation))
    assert (run.rung == Rung.QP).all()
    assert metrics(run).violations["pressure slew"][0] == 0.0
    return metrics(run).theta_rms


@pytest.mark.compiles
def test_a_dead_time_that_is_known_hardly_costs_accuracy():
    late = RealPlant(PLANT, dead_time=0.05)
    assert rms(late, Compensation(dead_time=0.05)) < 0.05
    assert rms(late, Compensation()) > 0.2


@pytest.mark.compiles
def test_a_dead_band_that_is_known_hardly_costs_accuracy():
    lazy = RealPlant(PLANT, dead_band=0.2 * BAR)
    assert rms(lazy, Compensation(dead_band=0.2 * BAR)) < 0.5 * rms(lazy, Compensation())


@pytest.mark.compiles
def test_friction_that_is_known_hardly_costs_accuracy():
    friction = Friction.of_width(PLANT, 5 * DEG)
    rubbing = RealPlant(PLANT, friction=friction)
    assert rms(rubbing, Compensation(friction)) < 0.3 * rms(rubbing, Compensation())


@pytest.mark.compiles
def test_what_is_sent_in_the_dead_time_is_what_the_prediction_starts_from():
    """On the plant that is its model but for the dead time, the first predicted state is met when it is due."""
    mpc = TrackingMPC(PLANT, compensation=Compensation(dead_time=0.04))
    reference = sine(K=5.5, duration=2, ramp=1).resampled(0.01)
    experiment = RealPlant(PLANT, dead_time=0.04).begin(0.01, PLANT.at_rest(0.0, 5.5), 0)
    predicted, true = [], []
    for k in range(150):
        true.append(experiment.x)
        plan = mpc.step(experiment.x, *reference.preview(k, mpc.ahead))
        predicted.append(plan.x[0])
        experiment.advance(plan.u[0])
    np.testing.assert_allclose(np.array(predicted)[:-4], np.array(true)[4:], rtol=1e-3, atol=1e-4)


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_far_from_the_command_the_inverse_of_the_dead_band_is_exact(v, P):
    known = Compensation(dead_band=0.1 * BAR)
    found = known.after_dead_band(known.inverse_dead_band(v * BAR, P * BAR), P * BAR)
    error = abs(found / BAR - v)
    assert error <= 0.05
    if abs(v - P) > 0.25:
        assert error < 1e-3


def test_jitter_of_the_angle_does_not_wear_the_friction_off():
    state = FrictionState(Friction(0.1))
    contact = Loads.of(PLANT, PLANT.at_rest(0.0, 5.5))
    for theta in (0.0, 5 * DEG):
        state.follow(theta, contact)
    for theta in 5 * DEG + 0.02 * DEG * np.random.default_rng(0).choice([-1, 1], 1000):
        state.follow(float(theta), contact)
    assert state.memory == pytest.approx(1.0, abs=1e-3)


@pytest.mark.compiles
def test_without_compensation_nothing_changes_for_a_nominal_plant():
    assert Compensation().delay(0.01) == 0
    mpc = TrackingMPC(Plant(), N=10)
    assert mpc.ahead == 10


def test_impossible_knowledge_is_refused_by_its_name():
    with pytest.raises(InvalidInput, match="dead_time"):
        Compensation(dead_time=-0.01)


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"dead_time": "a"}, "dead_time = 'a' is not a number"),
        ({"dead_time": None}, "dead_time = None is not a number"),
        ({"dead_time": 60}, "dead_time = 60 s is none of a regulator; if milliseconds were meant"),
        ({"dead_time": 5}, "dead_time = 5 s is none of a regulator; if milliseconds were meant"),
        ({"reading_age": 2}, "reading_age = 2 s is none of a sensor; if milliseconds were meant"),
        ({"lag_up": 60}, "lag_up = 60 s is none of a regulator; if milliseconds were meant"),
        ({"dead_band": 0.1}, "dead_band = 0.1 Pa is next to nothing; if bar was meant"),
    ],
)
def test_numbers_that_cannot_be_meant_are_one_sentence(known, said):
    with pytest.raises(InvalidInput, match=said):
        Compensation(**known)


@pytest.mark.parametrize(
    ("hysteresis", "more", "said"),
    [
        ((0.6, 0.2), "[regulators]\ndead_tim = 1", r"plant.toml: \[regulators\] has no dead_tim; it has dead_time"),
        ((0.6, 0.2), "[regulators]\ndead_time = [0.1]", r"plant.toml: \[regulators\]: dead_time = \(0.1,\) has to"),
        ((1.2, -0.2), "", r"plant.toml: \[hysteresis\]: weights = .* negative weight is no friction"),
        ((0.6, 0.2), "[gas]\ngamma = 1.4", r"plant.toml: \[gas\] has no gamma; it has kappa, atmosphere"),
        ((0.6, 0.2), "[gas]\nkappa = 14", r"plant.toml: \[gas\]: Gas: kappa = 14"),
    ],
)
def test_a_file_that_was_edited_wrongly_is_named_once(hysteresis, more, said, tmp_path):
    joint = replace(report_joint(), hysteresis=PrandtlIshlinskii(hysteresis, (0.05,)))
    path = tmp_path / "plant.toml"
    path.write_text(f"{dumps(joint)}\n{more}\n", encoding="utf-8")
    with pytest.raises(InvalidFile, match=said) as refusal:
        Compensation.load(path)
    assert str(refusal.value).count("plant.toml") == 1
