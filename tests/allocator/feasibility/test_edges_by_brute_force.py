"""The closed-form ends of the feasible set against a search that knows nothing of them."""

import numpy as np
import pytest

from allocator import allocate
from allocator.feasibility import stiffness_interval, torque_interval

pytestmark = pytest.mark.filterwarnings("ignore::allocator.joint.assumption.Extrapolated")  # of fits, at 0 bar
RELATIVE = 1e-6
FINE = 20_001


def allowed_pressures(joint, theta):
    """A fine grid of each muscle's pressures that are in the supply range, valid and taut; the ends by bisection."""
    P = np.linspace(*joint.pressure_limits, FINE)
    grids = []
    for side in joint.sides(theta):
        allowed = np.append(P[P < side.muscle.max_pressure], min(P[-1], side.muscle.max_pressure))
        slack = np.nonzero(side.force(allowed) < -1e-9)[0]
        first = (
            slack[-1] + 1 if slack.size else 0
        )  # some laws pull nothing at 0 bar, less than nothing above, then more
        if first == allowed.size:
            return None
        if first:
            slack, pulls = allowed[first - 1], allowed[first]
            for _ in range(60):
                middle = (slack + pulls) / 2
                slack, pulls = (slack, middle) if side.force(middle) >= 0 else (middle, pulls)
            allowed = np.append(pulls, allowed[first:])
        grids.append(allowed)
    return grids


def searched(joint, theta, T):
    """Least and greatest stiffness among the grid's pressures with the torque T, interpolated between them."""
    one, two = joint.sides(theta)
    P1, P2 = allowed_pressures(joint, theta)
    t1, t2 = one.torque(P1), two.torque(P2)
    K = []
    for own, other, (t_own, t_other), (s_own, s_other) in (
        (P1, P2, (t1, t2), (one, two)),
        (P2, P1, (t2, t1), (two, one)),
    ):
        order = np.argsort(t_other)
        needed = T - t_own
        possible = (needed >= t_other.min()) & (needed <= t_other.max())
        partner = np.interp(needed[possible], t_other[order], other[order])
        K.append(s_own.stiffness(own[possible]) + s_other.stiffness(partner))
    K = np.concatenate(K)
    return K.min(), K.max()


def check(joint):
    left, right = joint.angle_range
    for theta in left + np.array([0.0, 0.21, 0.5, 0.64, 0.97]) * (right - left):
        pressures = allowed_pressures(joint, theta)
        T_min, T_max = torque_interval(theta, joint=joint)
        if pressures is None:
            assert np.isnan([T_min, T_max]).all()
            continue
        one, two = joint.sides(theta)
        t1, t2 = one.torque(pressures[0]), two.torque(pressures[1])
        scale = np.abs(t1).max() + np.abs(t2).max()
        assert (T_min, T_max) == pytest.approx((t1.min() + t2.min(), t1.max() + t2.max()), abs=RELATIVE * scale)
        for share in (0.1, 0.35, 0.5, 0.8):
            T = T_min + share * (T_max - T_min)
            found = stiffness_interval(theta, T, joint=joint)
            assert found == pytest.approx(searched(joint, theta, T), rel=RELATIVE)


def test_torque_and_stiffness_intervals_are_those_of_a_fine_search(joint):
    check(joint)


def test_torque_and_stiffness_intervals_are_those_of_a_fine_search_for_every_usable_model(fitted_joint):
    check(fitted_joint)


def test_a_stiffness_inside_exists_and_one_outside_does_not(joint):
    left, right = joint.angle_range
    theta = np.linspace(left, right, 11)[1:-1]
    T_min, T_max = torque_interval(theta, joint=joint)
    T = 0.7 * T_min + 0.3 * T_max
    K_min, K_max = stiffness_interval(theta, T, joint=joint)
    exists = np.isfinite(K_min) & (K_min > 0)  # a lever may destabilise more than its muscles hold
    theta, T, K_min, K_max = theta[exists], T[exists], K_min[exists], K_max[exists]
    width = K_max - K_min
    for K, inside in ((K_min + 1e-4 * width, True), (K_max - 1e-4 * width, True), (K_max + 1e-4 * width, False)):
        answer = allocate(theta, K, T, joint=joint)
        assert (answer.success == inside).all()
