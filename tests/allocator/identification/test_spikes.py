"""Spikes are told from motion: those that were put into a known motion are found, and no others."""

import numpy as np
import pytest

from allocator.identification.recording import pressure_spikes, spikes_of
from allocator.units import BAR, DEG

T = 0.02 * np.arange(2000)


def angle_spikes(t, theta):
    """Return which rows of the angle are spikes."""
    return spikes_of(t, {"theta": theta}).get("theta", np.zeros(t.size, bool))


def moving(speed):
    """Angles [rad] that swing and turn at up to 300°/s times `speed`, with encoder steps and noise."""
    rng = np.random.default_rng(0)
    smooth = 30 * np.sin(2 * np.pi * 0.7 * T) + 15 * np.sin(2 * np.pi * 1.9 * T + 1) * (T > 10)
    return (0.05 * np.round(speed * smooth / 0.05) + 0.02 * rng.normal(size=T.size)) * DEG


@pytest.mark.parametrize(("size", "speed"), [(5, 0.2), (10, 0.4), (30, 1.0), (40, 1.0)])
@pytest.mark.parametrize("rows", [1, 2, 3])
def test_spikes_in_motion_are_found_and_nothing_else(size, speed, rows):
    rng = np.random.default_rng(size + rows)
    begins = 20 + 190 * np.arange(10) + rng.integers(0, 90, 10)
    theta = moving(speed)
    put_in = np.zeros(T.size, bool)
    for first in begins:
        put_in[first : first + rows] = True
        theta[first : first + rows] += size * DEG * rng.choice([-1, 1])
    found = angle_spikes(T, theta)
    assert (found & put_in).sum() >= 0.9 * put_in.sum()
    assert not (found & ~put_in).any()


@pytest.mark.parametrize("hertz", [1, 3, 5, 6.25, 8, 10])
def test_a_joint_that_rings_has_no_spikes(hertz):
    after = np.clip(T - 20, 0, None)
    assert not angle_spikes(T, 20 * DEG * np.exp(-3 * after) * np.sin(2 * np.pi * hertz * after)).any()
    assert not angle_spikes(T, 20 * DEG * np.sin(2 * np.pi * hertz * after) * (T < 22)).any()


def test_missing_rows_do_not_make_spikes_of_a_quick_motion():
    """Half of the rows of a swing at 3 Hz are missing."""
    kept = np.flatnonzero(np.random.default_rng(3).random(T.size) < 0.5)
    assert not angle_spikes(T[kept], 20 * DEG * np.sin(2 * np.pi * 3 * T[kept])).any()


def test_steps_of_any_width_are_no_spikes_of_a_commanded_pressure():
    rng = np.random.default_rng(4)
    widths = rng.integers(1, 40, 200)
    commands = np.repeat(rng.uniform(1, 4, 200), widths)[: T.size] * BAR
    t = 0.02 * np.arange(commands.size)
    assert not pressure_spikes(t, commands).any()


def test_a_pressure_that_is_let_out_and_in_again_by_a_regulator_has_not_dropped_out():
    target = np.where((T % 4) < 2, 2.0, 0.0)
    P = np.zeros(T.size)
    for k in range(1, T.size):
        P[k] = P[k - 1] + 0.02 / 0.1 * (target[k] - P[k - 1])
    noisy = np.clip(P + 0.01 * np.random.default_rng(0).normal(size=T.size), 0, None) * BAR
    assert not pressure_spikes(T, noisy).any()


def test_short_logs_have_no_spikes():
    for n in range(8):
        assert not angle_spikes(T[:n], np.arange(n) * 100.0 * DEG).any()
        assert not pressure_spikes(T[:n], np.arange(n) * BAR).any()
