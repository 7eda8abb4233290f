"""Angles of joints that rest against a stop."""

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.identification.end_stops import described, stops, stops_of_rests


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


def rests(noise, stop=np.inf, seed=0):
    """Return 40 rests of a joint with hysteresis of ±2°, and which of them are on a stop."""
    rng = np.random.default_rng(seed)
    P = rng.uniform(1.0, 4.5, (2, 40)) * BAR
    free = 1.2 * (P[0] - P[1]) / P.sum(0) + 2 * DEG * rng.choice([-1, 1], 40)
    return np.clip(free, -stop, stop) + noise * rng.standard_normal(40), *P, np.abs(free) > stop


def test_most_stops_of_rests_are_found_under_noise():
    count = dict.fromkeys((stops, stops_of_rests), 0)
    for seed in range(30):
        *data, on = rests(0.3 * DEG, 20 * DEG, seed)
        count[stops] += len(list(stops(*data)))
        found = stops_of_rests(*data)
        count[stops_of_rests] += len(found)
        for end, angle in (("greatest", 20 * DEG), ("least", -20 * DEG)):
            if end in found:
                assert found[end].angle == pytest.approx(angle, abs=0.7 * DEG)
                assert found[end].there[~on].mean() < 0.2
    assert count[stops_of_rests] >= 30  # of 60
    assert count[stops] < 20


@pytest.mark.parametrize("noise", [0.0, 0.3, 2.0])
def test_rests_of_a_free_joint_have_no_stops(noise):
    for seed in range(100):
        assert not stops_of_rests(*rests(noise * DEG, np.inf, seed)[:3]), seed
