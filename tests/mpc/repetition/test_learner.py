"""The learner on loops that are known: linear ones, given by their response."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc import Reference
from mpc.repetition import update
from mpc.repetition.learner import Learner, Reason
from mpc.repetition.response import Response, doubted
from mpc.repetition.update import (
    MOST,
    Update,
    designed,
    filtered,
    passed,
    power_of,
    rested,
    returning,
    unforeseen,
)  # fmt: skip
from mpc.trials.motions.trajectories import point_to_point

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


def wandering(seed, lag):
    """Return what is learned of a joint that wanders: the learner at its end."""
    learner = Learner(WANTED, (FIRST_ORDER,), DT, 14)
    while not learner.done:
        theta = followed(learner.reference.theta, lag=lag) if lag else learner.reference.theta
        learner.learn(theta + wander(seed + len(learner.history)))
    return learner


def test_errors_that_return_are_learned_under_others_as_great():
    learned = [wandering(seed, lag=0.08) for seed in range(0, 1000, 200)]
    left = [WANTED.theta - followed(WANTED.theta + one.best.correction, lag=0.08) for one in learned]
    assert all(one.history[0].rms > 1 * DEG for one in learned)
    assert np.sqrt(np.mean(np.square(left)[:, 400:])) < 0.4 * DEG
    assert np.median([one.rms for each in learned for one in each.history[3:]]) < 1.25 * 0.5 * DEG


def test_errors_that_do_not_return_are_not_learned(monkeypatch):
    def corrected():
        return np.mean([np.std(wandering(seed, lag=0.0).history[1].correction) for seed in range(0, 800, 200)])

    filtered_out = corrected()
    monkeypatch.setattr(update, "OVER", 0.0)
    assert filtered_out < 0.5 * corrected()


def test_a_filter_passes_errors_that_return_and_no_others():
    t = DT * np.arange(WANTED.t.size)
    slow = 1 * DEG * np.sin(2 * np.pi * 0.5 * t)[:, None] * np.exp(-(((t - 5) / 1.5) ** 2))[:, None]
    noise = np.where((FREQUENCY > 2) & (FREQUENCY < 6), power_of(slow, FIRST_ORDER, DT), 0.0)
    H = returning(slow, FIRST_ORDER, DT, noise)
    assert H[5] > 0.95
    assert not H[30:50].any()
    np.testing.assert_allclose(passed(slow, FREQUENCY, H, DT), slow, atol=0.03 * DEG)
    quick = np.sin(2 * np.pi * 4.0 * t)[:, None]
    assert np.abs(passed(quick, FREQUENCY, H, DT)[200:-200]).max() < 0.02


def test_the_power_of_a_rest_is_that_of_a_motion_as_long():
    rng = np.random.default_rng(3)
    errors = 0.1 * DEG * filtered(rng.standard_normal((20_000, 1)), 4.0, DT)
    errors[-1] = 0
    rests = [rested(part, FIRST_ORDER, DT, 600).sum() for part in np.split(errors, 100)]
    motions = [power_of(part - part.mean(), FIRST_ORDER, DT) for part in np.split(errors[:19_800], 33)]
    assert np.mean(rests) == pytest.approx(np.mean(motions), rel=0.35)


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
