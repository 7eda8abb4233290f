"""Readings of a moving joint are given to the observer as of their due time, whether their dates are right or wrong."""

import numpy as np
import pytest

from allocator import DEG
from mpc import KalmanObserver, RealPlant, TrackingMPC, Weights, sine
from mpc.bench.cycle import Tick
from mpc.bench.device import Reading, SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.loop import RealTimeLoop
from mpc.bench.projection import Projection

DT, STEP, NONE = 0.01, 0.02 * DEG, (0.0, 0.0)


def tick(due, t, theta, P=(2e5, 2e5), missed=0, late=0.0):
    return Tick(0, missed, Reading(t, theta, P), P, due, late)


def test_an_angle_that_is_dated_before_it_was_due_goes_on_with_the_estimated_velocity():
    for age, moved in ((0.004, 0.008), (0.008, 0.016), (0.01, 0.016), (0.015, 0.01), (0.02, 0.0)):
        projection = Projection(1, DT)
        projection.at_due(tick(1.0 - DT, 1.0 - age - DT, 0.1 - 1e-6), 0.0)  # a fine encoder
        said = projection.at_due(tick(1.0, 1.0 - age, 0.1), 2.0)
        np.testing.assert_allclose(said, [0.1 + moved, np.nan, 2e5, 2e5], atol=2e-6)


def motion(t):
    """Angles [rad] and rates [rad/s] of two joints, up to 2 rad/s."""
    return 0.4 * np.sin(5 * t + np.arange(2)), 2.0 * np.cos(5 * t + np.arange(2))


def errors(wrong, true=NONE, late=NONE, lost=0):
    """Errors (M, 2) [rad] of the projected angles over the second half of four seconds, and those of the readings.

    Samples begin `late` [s], their readings have `true` ages [s] then, and their dates are `wrong` by [s]. Of seven
    readings, the first `lost` are missed, silent or both. All ranges are (least, greatest).
    """
    projection, found, none, rng = Projection(2, DT), [], (np.nan,) * 4, np.random.default_rng(0)
    for k, (off, age, after) in enumerate(rng.uniform(*np.array([wrong, true, late]).T, (400, 3))):
        due, omega = k * DT, motion(k * DT)[1]
        if k % 7 < lost:
            if k % 2:
                projection.at_due(tick(due, np.nan, np.full(2, np.nan), none), omega)
            continue
        read = due + after - age
        theta = np.round(motion(read)[0] / STEP) * STEP
        missed = max(lost * (k % 7 == lost) - k % 2, 0)
        said = projection.at_due(tick(due, read + off, theta, (2e5,) * 4, missed, after), omega)
        found.append([said[:2] - motion(due)[0], theta - motion(due)[0]])
    return np.abs(np.array(found)[len(found) // 2 :]).swapaxes(0, 1)


@pytest.mark.parametrize("true", [NONE, (0.0, 0.006), (-0.002, 0.004)], ids=["present", "old", "both"])
@pytest.mark.parametrize("late", [NONE, (0.0, 0.004)], ids=["in time", "late"])
@pytest.mark.parametrize("lost", [0, 2])
def test_true_dates_are_believed(true, late, lost):
    projected, read = errors(NONE, true, late, lost)
    assert np.median(projected) <= max(0.25 * np.median(read), STEP / 2)
    assert lost or projected.max() < max(0.3 * read.max(), STEP)


@pytest.mark.parametrize("spread", [0.001, 0.002, 0.004])
@pytest.mark.parametrize("late", [NONE, (0.0, 0.004)], ids=["in time", "late"])
def test_wrong_dates_do_not_add_noise(spread, late):
    projected, _ = errors((-spread, spread), late=late)
    assert projected.max() < 2 * STEP + 0.3 * 2.0 * spread


@pytest.mark.compiles
@pytest.mark.slow
@pytest.mark.parametrize("wrong", [(-0.004, 0.004), (-0.004, 0.0)], ids=["around the truth", "before it"])
def test_a_device_with_jittering_dates_is_driven_to_the_end(wrong, monkeypatch):
    """Dates up to 4 ms wrong at 100 Hz ended as a rejected angle: at 1 rad/s each was an error of 0.2°."""
    real, clock, rng = RealPlant.standard(), SimulatedClock(), np.random.default_rng(0)
    known, device = real.known(), SimulatedDevice(real, clock)
    read = device.read

    def misdated():
        reading = read()
        return reading._replace(t=reading.t + rng.uniform(*wrong))

    monkeypatch.setattr(device, "read", misdated)
    controller = TrackingMPC(real.nominal, DT, 20, Weights.calm(), compensation=known)
    observer = KalmanObserver(real.nominal, DT, compensation=known)
    record = RealTimeLoop(device, controller, observer, sine(K=5.5, frequency=0.5, duration=8.0), clock=clock).run()
    assert str(record.ending) == "finished"
    assert record.theta_rms < 0.5 * DEG
