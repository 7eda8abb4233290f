"""Angles of joints that rest against a stop."""

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.identification.outliers import described, stops


def stepped(stop, hysteresis=0.0):
    """Return random steps of the pressures, and an angle that follows them up to a stop."""
    rng = np.random.default_rng(0)
    P = np.repeat(rng.uniform(1.0, 4.0, (2, 60)), 20, axis=1) * BAR
    theta = np.clip((P[0] - P[1]) / 3e5, -stop, stop)
    return theta + hysteresis * np.sign(np.diff(theta, prepend=0.0)), *P


def test_a_stop_is_named_with_its_angle():
    at_both = [described(stop) for stop in stops(*stepped(20 * DEG))]
    assert [sentence.split(" are the ")[1].split(",")[:2] for sentence in at_both] == [
        ["greatest one", " 20°"],
        ["least one", " -20°"],
    ]


@pytest.mark.parametrize("hysteresis", [0.0, 2 * DEG])
def test_a_free_joint_has_no_stops(hysteresis):
    assert list(stops(*stepped(np.inf, hysteresis))) == []


def test_a_joint_that_turns_round_slowly_has_no_stops():
    wave = np.sin(0.025 * np.arange(1200))
    assert list(stops(0.5 * wave, (2.5 + wave) * BAR, (2.5 - wave) * BAR)) == []


def test_readings_on_a_stop_are_found_under_noise_and_hardly_any_others():
    theta, P1, P2 = stepped(np.inf)
    on = np.abs(theta) > 20 * DEG
    noisy = np.clip(theta, -20 * DEG, 20 * DEG) + 0.1 * DEG * np.random.default_rng(1).standard_normal(theta.size)
    found = np.any([stop.there for stop in stops(noisy, P1, P2)], axis=0)
    assert found[on].mean() > 0.98
    assert found[~on].mean() < 0.05
