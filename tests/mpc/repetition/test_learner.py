"""The learner on loops that are known: linear ones, given by their response."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc import Reference
from mpc.repetition.learner import Learner, Reason
from mpc.repetition.response import Response, doubted
from mpc.repetition.update import MOST, Update, designed, filtered, power_of, unforeseen
from mpc.trials.trajectories import point_to_point

DT, LAG = 0.01, 0.05
FREQUENCY = np.arange(0.0, 16.0, 0.1)
FIRST_ORDER = Response(FREQUENCY, (1 / (1 + 2j * np.pi * FREQUENCY * LAG))[:, None, None])
WANTED = point_to_point(5.0)


def followed(theta, lag=LAG, sign=1.0):
    """Return the angles of a joint that lags behind what it is asked for."""
    done = np.empty_like(theta)
    done[0] = theta[0]
    keep = np.exp(-DT / lag)
    for k in range(1, theta.size):
        done[k] = keep * done[k - 1] + (1 - keep) * theta[k]
    return sign * (done - theta[0]) + theta[0]


def taught(learner, **joint):
    while not learner.done:
        learner.learn(followed(learner.reference.theta, **joint))
    return learner


def test_the_error_of_a_lag_falls_monotonically_and_by_far():
    learner = taught(Learner(WANTED, (FIRST_ORDER,), DT, 8))
    rms = [one.rms for one in learner.history]
    until = rms.index(learner.best.rms) + 1
    assert (np.diff(rms[:until]) < 0).all()
    assert until > 3
    assert learner.gain > 100


def test_the_predicted_errors_are_those_seen_on_the_joint_that_was_told():
    learner = taught(Learner(WANTED, (FIRST_ORDER,), DT, 4))
    seen = np.array([one.rms for one in learner.history]) / learner.history[0].rms
    np.testing.assert_allclose(seen[1:3], learner.update.predicted[1:3], atol=0.03)


def test_it_is_monotone_for_all_responses_that_it_was_told():
    some = doubted([FIRST_ORDER])
    error = (WANTED.theta - followed(WANTED.theta))[:, None]
    update = designed(some, error, DT, 6)
    Q = 1 / (1 + (FREQUENCY / update.cutoff) ** 4)
    learned = update.gain * np.exp(2j * np.pi * FREQUENCY * update.lead)
    worst = max(np.abs(Q * (1 - learned * one.T[:, 0, 0])).max() for one in some)
    assert worst == pytest.approx(update.rate)
    assert update.rate <= MOST
    assert update.rate >= designed([FIRST_ORDER], error, DT, 6).rate - 1e-12


def test_a_joint_that_turns_the_wrong_way_is_left_alone():
    learner = taught(Learner(WANTED, (FIRST_ORDER,), DT, 10), sign=-1.0)
    assert learner.reason is Reason.GREW
    assert len(learner.history) == 3
    assert learner.best is learner.history[0]
    np.testing.assert_array_equal(learner.reference.theta, WANTED.theta)


def test_it_stops_where_noise_is_all_that_is_left():
    rng = np.random.default_rng(1)
    learner = Learner(WANTED, (FIRST_ORDER,), DT, 30)
    while not learner.done:
        learner.learn(followed(learner.reference.theta) + 0.1 * DEG * rng.standard_normal(WANTED.t.size))
    assert learner.reason in (Reason.SETTLED, Reason.GREW)
    assert len(learner.history) < 30
    assert learner.best.rms == pytest.approx(0.1 * DEG, rel=0.15)


def wander(seed, size=0.5 * DEG):
    """Errors (M,) [rad] below 2 Hz that come in one repetition only, of this RMS."""
    noise = filtered(np.random.default_rng(seed).standard_normal((WANTED.t.size, 1)), 2.0, DT)[:, 0]
    noise *= np.clip((WANTED.t[-1] - WANTED.t) / 0.5, 0, 1)  # none at the end
    return size * noise / np.sqrt(np.mean(noise**2))


def test_the_gain_falls_to_what_is_left_to_learn_where_errors_do_not_return():
    """With the gain of the first update errors of one repetition would return in the next: √2 of their size."""
    learner = Learner(WANTED, (FIRST_ORDER,), DT, 14)
    while not learner.done:
        learner.learn(followed(learner.reference.theta, lag=0.08) + wander(len(learner.history)))
    gains, rms = ([getattr(one, name) for one in learner.history] for name in ("gain", "rms"))
    assert learner.history[0].rms > 1 * DEG
    assert np.median(gains[3:]) < 0.5 * gains[1]
    assert np.median(rms[3:]) < 1.2 * 0.5 * DEG


def test_what_is_unforeseen_is_the_power_of_what_does_not_return():
    t = DT * np.arange(WANTED.t.size)
    before, change = wander(1)[:, None], (0.02 * np.exp(-(((t - 5) / 0.3) ** 2)))[:, None]
    after = before - followed(change[:, 0])[:, None]
    nothing = unforeseen(FIRST_ORDER, before, after, change, DT)
    assert nothing.sum() < 1e-3 * power_of(change, FIRST_ORDER, DT)
    noises = [wander(seed)[:, None] for seed in range(2, 42)]
    found = [
        unforeseen(FIRST_ORDER, before + one, after + other, change, DT).sum()
        for one, other in zip(noises[::2], noises[1::2], strict=True)
    ]
    assert np.mean(found) == pytest.approx(np.mean([power_of(one, FIRST_ORDER, DT) for one in noises]), rel=0.3)


def test_no_guarantee_no_learning():
    opposed = replace(FIRST_ORDER, T=-FIRST_ORDER.T)
    learner = taught(Learner(WANTED, (FIRST_ORDER, opposed), DT, 5))
    assert learner.reason is Reason.UNKNOWN
    assert len(learner.history) == 1
    with pytest.raises(InvalidInput, match="learning has ended"):
        learner.learn(WANTED.theta)


def test_nothing_is_corrected_in_the_first_half_of_a_rest_nor_beyond_the_joint_range():
    learner = Learner(WANTED, (FIRST_ORDER,), DT, 4, angle_limits=(-31 * DEG, 31 * DEG))
    learner.learn(followed(WANTED.theta, lag=0.3))
    shift = learner.reference.theta - WANTED.theta
    assert not shift[:200].any()
    assert np.abs(learner.reference.theta).max() <= 31 * DEG
    assert np.abs(shift).max() > 2 * DEG


def test_two_joints_learn_at_once_though_one_moves_the_other():
    coupled = np.array([[1.0, 0.2], [0.1, 1.0]])
    two = Reference(WANTED.t, np.stack([WANTED.theta, -WANTED.theta], 1), np.tile(5 * np.eye(2), (WANTED.t.size, 1, 1)))
    T = FIRST_ORDER.T * coupled
    learner = Learner(two, (Response(FREQUENCY, T),), DT, 8)
    start = two.theta[0]
    while not learner.done:
        lagged = np.stack([followed(column) for column in learner.reference.theta.T], axis=1)
        learner.learn((lagged - start) @ coupled.T + start)
    assert learner.gain > 5


def test_the_low_pass_has_no_phase_and_halves_at_its_cutoff():
    t = DT * np.arange(4000)
    wave = np.sin(2 * np.pi * 2.0 * t)[:, None]
    through = filtered(wave, 2.0, DT)[1000:3000]
    np.testing.assert_allclose(through, 0.5 * wave[1000:3000], atol=2e-3)


def test_a_lead_is_that_of_the_error():
    t = DT * np.arange(400)
    error = np.exp(-(((t - 2.0) / 0.3) ** 2))[:, None]
    made = Update(1.0, 0.1, 40.0, 0.5, ()).applied(np.zeros_like(error), error, DT)
    assert t[made[:, 0].argmax()] == pytest.approx(1.9, abs=0.011)


def test_errors_of_the_first_rest_do_not_count():
    learner = Learner(WANTED, (FIRST_ORDER,), DT, 2)
    theta = WANTED.theta.copy()
    theta[:300] += 5 * DEG
    learner.learn(theta)
    assert learner.history[0].rms == 0
