"""An arm of two joints from its log: which muscles pull, the law of a joint, episodes and bands."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.identification import Episode, Windows, assign_muscles, fit_arm
from allocator.identification.arm.fit import Bands, fit_law, folds, joint_error
from allocator.identification.arm.law import JointLaw, Surroundings, run
from allocator.units import DEG

STEP = 0.01
PAIRS = (2, 1), (0, 3)


def law(joint, **values):
    one = JointLaw(joint, PAIRS[joint], 2)
    return one, np.array([[values.get(p.name, p.start) for p in one.parameters]])


TRUTH = {
    0: law(0, c1=-20.0, a0=60.0, b0=-50.0, d0=6.0, f0=2.0, f1=2.0),
    1: law(1, c1=-40.0, a0=30.0, b0=-45.0, d0=9.0, f0=4.0, f1=1.0),
}


def episode(seed, n=90):
    rng = np.random.default_rng(seed)
    knots = rng.uniform(0.1, 0.9, (8, 4))
    p = np.stack([np.interp(np.arange(n), np.linspace(0, n, 8), knots[:, i]) for i in range(4)], axis=1)
    rest = np.zeros((1, n, 2))
    found = run(TRUTH, Windows(rest, rest, p[None], STEP, np.array([""])))
    q = np.concatenate([np.zeros((2, 2)), np.stack([found[0][0, 0], found[1][0, 0]], axis=1)])
    v = np.diff(q, axis=0, prepend=q[:1]) / STEP
    return Episode(q, v, p, STEP, f"episode {seed}")


EPISODES = [episode(seed) for seed in range(12)]


def test_muscles_are_assigned_to_the_joints_that_they_pull():
    found = assign_muscles(EPISODES)
    assert found.pairs == PAIRS
    assert found.margin > 0
    assert found.doubtful == ()


def test_a_joint_that_does_not_move_has_no_muscles_to_find():
    still = [Episode(0 * e.q, 0 * e.v, e.p, e.step, e.name) for e in EPISODES]
    with pytest.raises(InvalidInput, match="joint 1 moves in 0 rows only"):
        assign_muscles(still)


@pytest.mark.parametrize("force", [1.9, 2.1])
def test_a_joint_at_rest_moves_if_the_force_exceeds_its_friction(force):
    one, x = law(0, c0=force, a0=0.0, b0=0.0, f0=2.0, f1=0.0)
    rest = np.zeros((1, 1))
    near = Surroundings((rest,), (rest,), (rest,), (rest, rest))
    q, v = one.step(one.named(x), rest, rest, rest, rest, near, STEP)
    assert (v > 0).all() == (force > 2.0)
    assert (q == STEP * v).all()


def test_stops_hold_the_joint_and_take_its_speed():
    one = JointLaw(0, (0, 1), 2, ("stops",), (-0.5, 0.5))
    x = np.array([[p.start for p in one.parameters]])
    at, fast = np.full((1, 1), 0.49), np.full((1, 1), 5.0)
    rest = np.zeros((1, 1))
    q, v = one.step(one.named(x), at, fast, rest, rest, Surroundings((), (), (), ()), STEP)
    assert q == 0.5
    assert v == 0.0


def test_the_law_of_a_joint_is_found_again():
    windows = Windows.cut(EPISODES, 40, 10)
    one = JointLaw(0, PAIRS[0], 2)
    seen = fit_law(one, windows.only(~folds(windows, 4)[0]))
    assert joint_error(one, seen, windows.only(folds(windows, 4)[0])) < 0.3 * DEG


def test_no_episode_is_in_two_folds():
    windows = Windows.cut(EPISODES, 40, 10)
    parts = folds(windows, 3)
    assert (np.sum(parts, axis=0) == 1).all()
    assert not set(windows.episode[parts[0]]) & set(windows.episode[parts[1]])


def test_a_log_in_one_piece_has_folds_too():
    windows = Windows.cut(EPISODES[:1], 20, 2)
    parts = folds(windows, 5)
    assert (np.sum(parts, axis=0) == 1).all()
    assert min(part.sum() for part in parts) >= len(windows.q) // 6


def test_a_jump_of_the_clock_ends_a_stretch():
    e = EPISODES[0]
    late = np.concatenate([e.q[:40], e.q[45:] + 0.3])
    parts = Episode.checked(late, np.delete(e.p, slice(40, 45), 0), STEP, v=np.delete(e.v, slice(40, 45), 0))
    assert [len(part.q) for part in parts] == [40, 45]


def test_what_is_no_episode_is_refused():
    with pytest.raises(InvalidInput, match=r"angles \(n, m\) and pressures \(n, 2 m\)"):
        Episode.checked(np.zeros((5, 2)), np.zeros((5, 3)), STEP)
    with pytest.raises(InvalidInput, match="no episode has the 109 rows"):
        Windows.cut(EPISODES, 100, 10)
    slow = replace(EPISODES[1], step=2 * STEP)
    with pytest.raises(InvalidInput, match=r"episode 1 has 2 joints and rows 0.02 s apart, episode 0 has 2 and 0.01 s"):
        Windows.cut([EPISODES[0], slow], 40, 10)


def test_bands_hold_95_percent_of_errors_like_those_they_were_made_of():
    rng = np.random.default_rng(1)
    predicted = np.cumsum(rng.normal(0, 0.02, (400, 40, 1)), axis=1)
    error = rng.normal(0, 0.01 + 0.02 * np.abs(predicted))
    start = np.zeros((400, 1))
    bands = Bands.of(predicted[:200], start[:200], error[:200])
    inside = np.abs(error[200:]) <= bands.around(predicted[200:], start[200:])
    assert 0.93 < inside.mean() < 0.985


@pytest.mark.slow
def test_an_arm_is_predicted_within_its_bands():
    """Motion of seeds that were not fitted; the truth is of the law's form, so that little is left but friction."""
    fitted = fit_arm(EPISODES, every=20, terms={0: (), 1: ()})
    others = Windows.cut([episode(seed) for seed in range(100, 106)], 40, 20)
    predicted, half = fitted.predict(others)
    error = predicted - others.future
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean((others.future - others.q[:, 1:2]) ** 2))
    assert 0.85 < np.mean(np.abs(error) <= half) <= 1.0
