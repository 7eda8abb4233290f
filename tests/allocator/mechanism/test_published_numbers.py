"""A worked example of the two-link arm, computed independently of this library: to all its printed digits."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import Status, allocate
from allocator.mechanism import machines
from allocator.units import BAR

ARM = replace(machines.arm26(), muscle_names=(), joint_names=())
Q, P = np.array([0.4, -0.3]), np.array([3, 2, 2.5, 3.5, 4, 1.5]) * BAR
LEAST = [3.438382, 1.560573, 2.829473, 3.171097, 3.561288, 1.939144]
BEYOND = [5, 4.554546, 1.872372, 3.608950, 5, 1.420301]


def printed(value, digits=6):
    return pytest.approx(value, abs=0.51 * 10.0**-digits, rel=0)


def test_torque_stiffness_and_taut_bounds():
    assert ARM.torque(Q, P) == printed([9.363994, 4.090842])
    K = ARM.stiffness(Q, P)
    assert [*K[0], *K[1]] == printed([10.174071, 3.975565, 3.975565, 8.760619])
    assert ARM.pressure_box(Q)[0] / BAR == printed([1.67834, 1.33437, 1.37183, 1.62824, 1.56911, 1.42030], 5)
    assert np.array_equal(ARM.pressure_box(Q)[1], np.full(6, 5 * BAR))


def test_the_least_pressures_that_give_the_same():
    a = allocate(Q, ARM.stiffness(Q, P), ARM.torque(Q, P), joint=ARM)
    assert a.status == Status.EXACT
    assert a.P / BAR == printed(LEAST)
    assert a.K == pytest.approx(ARM.stiffness(Q, P), rel=1e-12)


def test_the_null_direction():
    *_, null = np.linalg.svd(ARM.targets_map(Q).M)[2]
    assert null * np.sign(null[0]) == printed([0.441, -0.442, 0.332, -0.331, -0.442, 0.442], 3)


@pytest.mark.parametrize("method", ["exact", "qp"])
def test_more_stiffness_than_there_is(method):
    asked = ARM.stiffness(Q, P) + np.diag([8.0, 0.0])
    assert asked[0, 0] == printed(18.174071)
    once = [[1.0, 0.5], [0.5, 1.0]]  # K12 counted once
    T = ARM.torque(Q, P)
    a = allocate(Q, asked, T, joint=ARM, priority="weighted", weights=(1e4, once), method=method)
    assert a.P / BAR == printed(BEYOND)
    assert (a.K[0, 0], a.K[0, 1]) == printed((15.239134, 4.614675))
    d, reach, asked_for = a.separation
    assert d == printed([0.239158, 0, 1, -0.217759, 0])
    assert (reach, asked_for) == printed((16.473702, 19.547828))
    assert a.active == ("muscle 1 upper", "muscle 5 upper", "muscle 6 slack")
