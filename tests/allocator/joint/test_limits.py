"""What is asked of forces and pressures is one value, which the joint turns into a box of pressures."""

import numpy as np
import pytest

from allocator import BAR, Limit, allocate, report_joint
from allocator.allocation import Problem
from allocator.joint.limits import TAUT, Limits

THETA = np.array([-0.5, 0.0, 0.4])
NOW = np.array([2 * BAR, 2.2 * BAR, 2.5 * BAR]), np.array([2.4 * BAR, 2 * BAR, 1.8 * BAR])
ALL = Limits(40.0, 700.0, 2.2 * BAR, NOW, np.full(3, 0.5 * BAR))


def bounds(box):
    return [end for side in box for end in (side.lo, side.hi)]


def test_the_pressure_box_is_the_box():
    joint = report_joint()
    np.testing.assert_array_equal(bounds(joint.box(THETA, ALL)), bounds(joint.pressure_box(THETA.tolist(), ALL)))
    np.testing.assert_array_equal(bounds(joint.box(THETA)), bounds(joint.pressure_box(THETA)))


def test_allocate_keeps_all_of_the_limits():
    a = allocate(THETA, 7.5, 1.0, limits=ALL)
    assert report_joint().box(THETA, ALL).contains(a.P1, a.P2, tolerance=1e-3).all()
    assert (a.P1 + a.P2 >= 4.4 * BAR - 1e-3).all()


def test_limits_of_some_targets_are_those_of_the_whole_at_them():
    problem = Problem(report_joint(), THETA, np.full(3, 7.5), np.ones(3), limits=ALL)
    for where in (np.array([True, False, True]), np.array([2, 0])):
        part = problem.take(where)
        np.testing.assert_array_equal(bounds(part.box), [end[where] for end in bounds(problem.box)])
        np.testing.assert_array_equal(part.limits.previous, np.array(NOW)[:, where])
    assert TAUT.take(np.array([0])) is TAUT


def test_without_the_force_limits_the_others_stay():
    joint, free = report_joint(), ALL.without_forces
    box = joint.box(THETA, free)
    assert (free.min_force, free.max_force) == (None, None)
    assert free[2:] == ALL[2:]
    assert not any((side.lo_limit & (Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK)).any() for side in box)


@pytest.mark.parametrize(("muscle", "now"), [(0, NOW[0]), (1, NOW[1])])
def test_a_slew_limit_reaches_a_step_either_way(muscle, now):
    np.testing.assert_array_equal(ALL.reach(muscle), (now - 0.5 * BAR, now + 0.5 * BAR))
    assert TAUT.reach(muscle) == (-np.inf, np.inf)


def test_limits_cannot_be_changed():
    with pytest.raises(AttributeError):
        TAUT.min_force = 5.0


def test_beyond_the_joint_range_the_limit_that_ends_it_is_named():
    joint = report_joint()
    left, right = joint.angle_range
    theta = np.array([left - 0.1, left, 0.0, right, right + 0.1])
    expected = [joint.angle_limit(False), 0, 0, 0, joint.angle_limit(True)]
    assert joint.outside_range(theta).tolist() == expected
    assert (
        allocate(theta, 7.5).limits & np.int32(Limit.JOINT_RANGE | Limit.CONTRACTION_THRESHOLD)
    ).tolist() == expected
