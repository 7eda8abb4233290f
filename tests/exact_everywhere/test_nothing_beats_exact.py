"""Every model, geometry and priority: no pressures are better than the answer's, and its claims are true.

At 4 angles of each joint 5 targets at random and 5 made by random taut pressures: 40 targets, 180 × 40 in all, judged
by a dense search. `python -m benchmarks.exactness` does the same for 30 000 each.
"""

from functools import cache

import numpy as np
import pytest

from allocator.allocation.optimisers.backends import CERTIFIED

from .curves import image
from .dense_search import Targets
from .joints import GEOMETRIES, MUSCLES, joint_of
from .judge import PRIORITIES, asked, false_intervals, judged
from .targets import made_targets, random_targets

ANGLES, EACH = 4, 5


@cache
def reach_of(muscle, geometry):
    """Return the joint, its reach at some angles, and targets there: random ones, made ones."""
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(14)
    left, right = joint.angle_range
    reach = image(joint, np.sort(left + rng.uniform(0.02, 0.98, 3 * ANGLES) * (right - left)))
    reach = reach.take(np.linspace(0, reach.theta.size - 1, ANGLES).astype(int))
    return joint, reach, random_targets(reach, EACH, rng), made_targets(joint, reach, EACH, rng)


@pytest.fixture(params=MUSCLES)
def muscle(request):
    return request.param


@pytest.fixture(params=GEOMETRIES)
def case(request, muscle):
    return reach_of(muscle, request.param)


@pytest.fixture(params=PRIORITIES)
def priority(request):
    return request.param


@pytest.mark.slow
def test_no_answer_is_beaten_and_no_status_is_false(case, priority):
    joint, reach, *both = case
    targets = Targets(*map(np.concatenate, zip(*both, strict=True)))
    verdict = judged(joint, reach, targets, priority, asked(joint, reach, targets, priority))
    assert not verdict.outside.any()
    assert not verdict.beaten.any(), f"{verdict.beaten.sum()} of {verdict.beaten.size}, by {verdict.excess.max():.1e}"
    assert not verdict.refused.any(), f"{verdict.refused.sum()} of {verdict.refused.size}"
    assert not verdict.false_status.any()
    assert not verdict.unequalled.any(), "the dense search is not dense enough to judge"


def test_every_answer_is_certified_twice(case, priority):
    """Check the gap to a proved bound, and the conditions of Karush, Kuhn and Tucker."""
    joint, reach, *both = case
    targets = Targets(*map(np.concatenate, zip(*both, strict=True)))
    answer = asked(joint, reach, targets, priority)
    assert (answer.gap <= 1e-12).all()
    assert (answer.kkt_residual <= CERTIFIED).all()


def test_what_pressures_in_the_box_made_is_met(case, priority):
    joint, reach, _random, made = case
    assert made.T.size
    assert asked(joint, reach, made, priority).success.all()


@pytest.mark.slow
def test_the_intervals_are_those_of_the_dense_search(case, priority):
    joint, reach, *both = case
    targets = Targets(*map(np.concatenate, zip(*both, strict=True)))
    assert not false_intervals(joint, reach, targets, asked(joint, reach, targets, priority)).any()
