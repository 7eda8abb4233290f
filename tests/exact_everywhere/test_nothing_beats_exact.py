"""Every model, geometry and priority: no pressures are better than the answer's, and its claims are true.

At 4 angles of each joint 5 targets at random and 5 made by random taut pressures: 40 targets, 180 × 40 in all, judged
by a dense search. `python -m benchmarks.exactness` does the same for 30 000 each.
"""

from functools import cache
from itertools import product

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
    """Return the joint, its reach at some angles, targets there (random, then made ones), and how many are made."""
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(14)
    left, right = joint.angle_range
    reach = image(joint, np.sort(left + rng.uniform(0.02, 0.98, 3 * ANGLES) * (right - left)))
    reach = reach.take(np.linspace(0, reach.theta.size - 1, ANGLES).astype(int))
    both = random_targets(reach, EACH, rng), made_targets(joint, reach, EACH, rng)
    return joint, reach, Targets(*map(np.concatenate, zip(*both, strict=True))), both[1].T.size


@cache
def answer_to(muscle, geometry, priority):
    """Return the library's answer to all targets of a joint, which every test looks at."""
    joint, reach, targets, _ = reach_of(muscle, geometry)
    return asked(joint, reach, targets, priority)


EVERYTHING = [*product(MUSCLES, GEOMETRIES, PRIORITIES)]
IN_TURNS = [  # every muscle and every geometry with every priority
    (muscle, geometry, PRIORITIES[(i + j) % len(PRIORITIES)])
    for (i, muscle), (j, geometry) in product(enumerate(MUSCLES), enumerate(GEOMETRIES))
]


@pytest.mark.slow
@pytest.mark.parametrize("case", EVERYTHING, ids="-".join)
def test_no_answer_is_beaten_and_no_status_is_false(case):
    joint, reach, targets, _ = reach_of(*case[:2])
    verdict = judged(joint, reach, targets, case[2], answer_to(*case))
    assert not verdict.outside.any()
    assert not verdict.beaten.any(), f"{verdict.beaten.sum()} of {verdict.beaten.size}, by {verdict.excess.max():.1e}"
    assert not verdict.refused.any(), f"{verdict.refused.sum()} of {verdict.refused.size}"
    assert not verdict.false_status.any()
    assert not verdict.unequalled.any(), "the dense search is not dense enough to judge"


@pytest.mark.parametrize("case", EVERYTHING, ids="-".join)
def test_every_answer_is_certified_twice_and_what_pressures_in_the_box_made_is_met(case):
    """Check the gap to a proved bound, and the conditions of Karush, Kuhn and Tucker."""
    answer, made = answer_to(*case), reach_of(*case[:2])[3]
    assert (answer.gap <= 1e-12).all()
    assert (answer.kkt_residual <= CERTIFIED).all()
    assert made
    assert answer.success[-made:].all()


@pytest.mark.slow
@pytest.mark.parametrize("case", IN_TURNS, ids="-".join)
def test_the_intervals_are_those_of_the_dense_search(case):
    """They depend on the torque of the answer, and not on the priority that led to it."""
    joint, reach, targets, _ = reach_of(*case[:2])
    assert not false_intervals(joint, reach, targets, answer_to(*case)).any()
