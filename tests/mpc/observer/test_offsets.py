"""Sensors that read something else than their regulators: nothing of that is left in the angle."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import KalmanObserver, Plant, Reference, TrackingMPC, simulate
from mpc.model.real import RealPlant
from mpc.observer.filter import Noise
from mpc.tracking.cost import Weights

DT = 0.01
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
OFF = (0.05 * BAR, -0.05 * BAR)
CALM = Weights.calm()
NONE = Noise(offset=0.0)
STILL = Reference(np.arange(0, 8, DT), np.full(800, 15 * DEG), np.full(800, 5.5))


def standing(noise, offset=OFF):
    """Mean error of the angle in the last second [°], and the offsets that the observer found [bar]."""
    observer = KalmanObserver(PLANT, DT, noise, compiled=False)
    controller = TrackingMPC(PLANT, DT, weights=CALM, rest=False, compiled=False)
    real = RealPlant(PLANT, pressure_offset=offset, pressure_noise=0.01 * BAR)
    run = simulate(real, controller, STILL, observer=observer)
    return abs((run.theta - run.theta_ref)[-100:].mean()) / DEG, observer.offset / BAR


@pytest.mark.slow
def test_a_sensor_beside_its_regulator_leaves_no_standing_error():
    error, found = standing(Noise())
    assert error < 0.05
    assert found == pytest.approx(np.array(OFF) / BAR, abs=0.01)
    assert standing(NONE)[0] > 5 * max(error, 0.05)


def test_offsets_are_bounded():
    _, found = standing(Noise(offset=0.03 * BAR))
    assert found == pytest.approx([0.03, -0.03], abs=0.002)


def test_sound_sensors_have_none():
    _, found = standing(Noise(), (0.0, 0.0))
    assert np.abs(found).max() < 0.01


def test_a_dead_band_that_is_known_is_no_offset():
    from mpc import Compensation

    told = Compensation(dead_band=0.2 * BAR)
    observer = KalmanObserver(PLANT, DT, compensation=told, compiled=False)
    P = np.array([2.5 * BAR, 2.5 * BAR])
    for _ in range(1000):  # the pressure stays at the edge of the band
        observer.estimate(np.array([0.0, np.nan, *(P + 0.09 * BAR)]), P)
    assert np.abs(observer.offset).max() < 0.01 * BAR


@pytest.mark.compiles
def test_compiled_samples_find_the_same():
    real = RealPlant(PLANT, pressure_offset=OFF, pressure_noise=0.01 * BAR)
    found = []
    for compiled in (True, False):
        observer, rows = KalmanObserver(PLANT, DT, compiled=compiled), []
        trial, u = real.begin(DT, PLANT.at_rest(0.0, 5.5), 3), np.array([2.5, 2.3]) * BAR
        for _ in range(300):
            x, d = observer.estimate(trial.measure(), u)
            rows.append([*x, d, *observer.offset])
            trial.advance(u)
        found.append(rows)
    assert np.array(found[0]) == pytest.approx(np.array(found[1]), rel=1e-9, abs=1e-9)


def test_an_offset_below_zero_is_refused():
    with pytest.raises(InvalidInput, match="offset"):
        Noise(offset=-1.0)
    with pytest.raises(InvalidInput, match="pressure_offset"):
        RealPlant(PLANT, pressure_offset=(3 * BAR, 0.0))


def test_old_readings_are_the_angle_of_then():
    real = RealPlant(PLANT, reading_age=0.025)
    trial, truth = real.begin(DT, PLANT.at_rest(0.0, 5.5), 0), []
    for _ in range(100):
        truth.append(trial.x[0])
        read = trial.measure()[0]
        trial.advance(np.array([3.0, 2.0]) * BAR)
    expected = np.interp(0.99 - 0.025, DT * np.arange(100), truth)
    assert read == pytest.approx(expected, abs=1e-12)
    again = replace(real, reading_age=0.0).begin(DT, PLANT.at_rest(0.0, 5.5), 0)
    assert again.measure()[0] == again.x[0]
