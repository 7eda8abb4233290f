"""Five targets once answered wrongly, each with the best answer, found by hand over a grid."""

import numpy as np
import pytest

from allocator import Status, allocate

from .joints import REPORT, joint_of

FIVE_BAR = 5e5


def test_the_other_end_of_a_stiffness_level_has_the_nearer_torque():
    joint, K, T = joint_of("Andrikopoulos2016", "table"), 30.346504081749746, -31.995028370875847
    a = allocate(0.437976296377911, K, T, joint=joint, priority="stiffness")
    assert pytest.approx(K, rel=1e-9) == a.K
    assert abs(a.T_error) == pytest.approx(8.578, abs=2e-3)  # 31.81 at P2 = 104 792 Pa
    assert (a.P1, a.P2) == pytest.approx((329_456, 411_646), abs=20)


def test_a_stiffness_that_can_be_had_is_met():
    joint, K, T = joint_of("Andrikopoulos2016", "lever-A"), 79.34538860509909, -17.048282221707098
    a = allocate(-0.31296400250177636, K, T, joint=joint, priority="stiffness")
    assert pytest.approx(K, rel=1e-9) == a.K  # was off by 0.0107
    assert abs(a.T_error) == pytest.approx(7.355, abs=2e-3)
    assert (a.P1, a.P2) == pytest.approx((150_629, FIVE_BAR), abs=20)


def test_both_sides_of_a_kink_are_searched():
    joint, K, T = joint_of("Wickramatunge2010", "table"), 36.14288427399319, -16.96943942283405
    a = allocate(-0.4583455664177291, K, T, joint=joint, priority="weighted", weights=(0.03, 1.0))
    assert 0.03 * a.T_error**2 + a.K_error**2 == pytest.approx(26.870874, abs=2e-6)  # 26.878626 at P1 = 248 220 Pa
    assert (a.P1, a.P2) == pytest.approx((255_664, FIVE_BAR), abs=20)


@pytest.mark.parametrize(
    ("muscle", "theta", "T", "K", "P1", "P2"),
    [
        (REPORT, -0.0560, -1.3580, 58.5008, 142_763, 180_465),
        ("Tondu2021", -0.0015, 0.7181, 78.7957, 397_776, 391_742),
    ],
)
def test_what_can_be_had_on_a_lever_is_not_refused(muscle, theta, T, K, P1, P2):
    joint = joint_of(muscle, "lever-A")
    assert joint.torque(theta, P1, P2) == pytest.approx(T, abs=5e-3)  # θ, T and K are rounded
    assert joint.stiffness(theta, P1, P2) == pytest.approx(K, abs=5e-3)
    a = allocate(theta, K, T, joint=joint)
    assert a.status is Status.EXACT, a.message
    low, high = a.stiffness_interval
    assert low <= K <= high
    assert np.isfinite([low, high]).all()
