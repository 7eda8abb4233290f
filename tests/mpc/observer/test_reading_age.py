"""Angles that are read late: the observer holds the pressures back until then, and predicts the present."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.errors import InvalidFile
from allocator.files.atomic import write_text
from mpc import Compensation, KalmanObserver, Plant, RealPlant, TrackingMPC, simulate, sine
from mpc.model.storage import save_plant
from mpc.tracking.cost import Weights

DT = 0.01
PLANT = Plant(lag=0.12)
REST = PLANT.at_rest(0.0, 5.5)


def swinging(k):
    return REST[2:] + 0.6 * BAR * np.sin(2 * np.pi * 0.8 * k * DT) * np.array([1, -1])


def errors(real, told):
    """Errors of angle [°] and pressures [bar] of the estimate, less the first second."""
    observer, experiment, found = KalmanObserver(real.nominal, DT, compensation=told, compiled=False), None, []
    experiment = real.begin(DT, REST, 0)
    for k in range(300):
        x, _ = observer.estimate(experiment.measure(), swinging(k - 1) if k else REST[2:])
        found.append(x - experiment.x)
        experiment.advance(swinging(k))
    off = np.abs(found)[100:].max(axis=0)
    return off[0] / DEG, off[2:].max() / BAR


@pytest.mark.parametrize(("age", "dead"), [(0.02, 0.0), (0.05, 0.02), (0.03, 0.03)])
def test_the_estimate_is_that_of_now(age, dead):
    real = RealPlant(PLANT, reading_age=age, dead_time=dead)
    angle, pressure = errors(real, Compensation(dead_time=dead, reading_age=age))
    assert angle < 0.05
    assert pressure < 0.01
    assert errors(real, Compensation(dead_time=dead))[0] > 1.0


@pytest.mark.parametrize("age", [0.0045, 0.006, 0.014])
def test_the_rest_of_an_age_keeps_the_estimate_of_a_light_joint_stable(age):
    """Readings corrected by the estimated velocity made the filter diverge, by 2° and more."""
    light = replace(PLANT, inertia=0.018, damping=0.15)
    assert errors(RealPlant(light, reading_age=age), Compensation(reading_age=age))[0] < 0.05


def test_a_loop_that_is_told_of_old_readings_does_not_swing():
    real, reference = RealPlant(PLANT, reading_age=0.04), sine(K=5.5, K_amplitude=0.0, duration=4.0)
    swing = []
    for told in (Compensation(reading_age=0.04), Compensation()):
        controller = TrackingMPC(PLANT, DT, weights=Weights.calm(), compensation=told, compiled=False)
        observer = KalmanObserver(PLANT, DT, compensation=told, compiled=False)
        run = simulate(real, controller, reference, observer=observer)
        swing.append(np.abs(run.theta - run.theta_ref)[200:].max() / DEG)
    assert swing[0] < 0.3
    assert swing[1] > 3.0


def test_the_sum_with_the_dead_time_is_rounded_once_and_the_rest_of_the_age_is_kept():
    told = Compensation(dead_time=0.014, reading_age=0.014)
    assert (told.delay(DT), told.age(DT)) == (2, 1)
    assert told.older(DT) == pytest.approx(0.004)
    told = Compensation(dead_time=0.02, reading_age=0.03)
    assert (told.delay(DT), told.age(DT), told.older(DT)) == (2, 3, 0.0)
    assert Compensation(dead_time=0.03).age(DT) == 0


def test_an_age_between_samples_is_compensated():
    """Readings 14 ms old: rounded to a sample, the joint would be ahead of a fast reference by 4 ms."""
    told = Compensation(dead_time=0.02, reading_age=0.014)
    real, reference, missed = RealPlant.of(PLANT, told), sine(K=5.5, K_amplitude=0.0, duration=4.0), []
    for known in (told, replace(told, reading_age=0.01)):
        controller = TrackingMPC(PLANT, DT, weights=Weights.calm(), compensation=known, compiled=False)
        observer = KalmanObserver(PLANT, DT, compensation=known, compiled=False)
        run = simulate(real, controller, reference, observer=observer)
        missed.append(np.sqrt(np.mean((run.theta - run.theta_ref)[200:] ** 2)))
    assert 3 * missed[0] < missed[1]


def test_a_pressure_that_is_silent_is_missed_when_its_angle_comes():
    told = Compensation(reading_age=0.02)
    observer = KalmanObserver(PLANT, DT, compensation=told, tolerance=0.0, compiled=False)
    y = np.array([0.0, np.nan, *REST[2:]])
    missing = []
    for k in range(9):
        x, _ = observer.estimate(np.where(np.arange(4) == 2, np.nan, y) if k == 4 else y, REST[2:])
        missing.append(np.isnan(x[2]))
    assert np.flatnonzero(missing).tolist() == [6]


def test_the_age_is_in_a_plant_s_file(tmp_path):
    path = tmp_path / "plant.toml"
    save_plant(path, PLANT.joint, {"lag": 0.1})
    text = path.read_text(encoding="utf-8")
    write_text(path, text + "\n[regulators]\ndead_time = 0.02\n\n[sensors]\nreading_age = 0.03\n")
    told = Compensation.load(path)
    assert told == replace(Compensation.of(PLANT.joint), dead_time=0.02, reading_age=0.03)
    assert "reading age 0.03 s" in told.summary
    for wrong in ("-0.01", "[0.1]", '"old"'):
        write_text(path, f"{text}\n[sensors]\nreading_age = {wrong}\n")
        with pytest.raises(InvalidFile, match=r"\[sensors\].*reading_age"):
            Compensation.load(path)


def test_an_age_in_milliseconds_is_refused():
    with pytest.raises(InvalidInput, match="reading_age = 30 s is none of a sensor; if milliseconds"):
        Compensation(reading_age=30)
