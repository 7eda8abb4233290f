"""Intervals of torque, stiffness and angle: the report's values, and that the three agree."""

import numpy as np
import pytest

from allocator import AntagonistJoint, InvalidInput, Lever, Limits, Stiffness, Table, report_joint
from allocator.feasibility import angle_interval, angle_intervals, stiffness_interval, torque_interval
from allocator.muscles import Tondu2021
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG


@pytest.mark.parametrize(
    ("degrees", "least", "greatest"),
    [(0, 6.486, 10.575), (60, 6.580, 8.982), (125, 7.027, 8.288)],
    ids="the report's muscle at {}°".format,
)
def test_the_report_s_muscle_has_these_stiffnesses_without_torque(degrees, least, greatest):
    assert stiffness_interval(degrees * DEG) == pytest.approx((least, greatest), abs=1e-3)


def test_of_the_report_s_curves_only_7_03_to_8_28_are_feasible_everywhere():
    """Mathematics.md section 1."""
    for K, everywhere in ((7.02, False), (7.03, True), (8.28, True), (8.29, False)):
        left, right = angle_interval(K)
        assert (right - left == pytest.approx(250 * DEG, rel=1e-12)) == everywhere


def test_angle_and_stiffness_intervals_agree(joint):
    left, right = joint.angle_range
    theta = np.linspace(left, right, 41)
    K_min, K_max = stiffness_interval(theta, 0.5, joint=joint)
    K = np.nanquantile(np.maximum([K_min, K_max], 0.01), [0.05, 0.3, 0.5, 0.7, 0.95])
    starts, ends = angle_intervals(K, 0.5, joint=joint)
    covered = ((starts[:, None] <= theta[:, None]) & (theta[:, None] <= ends[:, None])).any(axis=0)
    inside = (K_min[:, None] <= K) & (K <= K_max[:, None])
    near = np.minimum(np.abs(K - K_min[:, None]), np.abs(K - K_max[:, None])) < 1e-6 * K
    assert (covered == inside)[~near].all()
    for edge in (starts, ends):
        m, i = np.nonzero(np.isfinite(edge) & (edge > left + 1e-9) & (edge < right - 1e-9))
        at = stiffness_interval(edge[m, i], 0.5, joint=joint)
        limits = torque_interval(edge[m, i], joint=joint)
        on_stiffness = np.isclose(at, K[i], rtol=1e-6, atol=1e-6).any(axis=0)
        on_torque = np.isclose(limits, 0.5, rtol=1e-6).any(axis=0)
        assert (on_stiffness | on_torque).all()


def test_an_odd_mechanism_has_several_intervals_of_angles():
    """Two bumps in the arm make two ranges of angles that are stiff enough."""
    angles = np.linspace(-1.5, 1.5, 61)
    wavy = 0.03 * angles + 0.004 * np.sin(4 * angles)
    joint = AntagonistJoint(Table(0.40, angles, 0.13 + wavy, 0.13 - wavy), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    theta = np.linspace(*joint.angle_range, 4001)
    K_min, K_max = stiffness_interval(theta, joint=joint)
    K = 0.8 * np.nanmax(K_max)
    inside = np.isfinite(K_min) & (K_min <= K) & (K <= K_max)
    changes = np.diff(np.pad(inside, 1).astype(int))
    starts, ends = angle_intervals(K, joint=joint)
    assert len(starts) == (changes == 1).sum() > 1
    step = theta[1] - theta[0]
    assert starts == pytest.approx(theta[np.nonzero(changes == 1)[0]], abs=step)
    assert ends == pytest.approx(theta[np.nonzero(changes == -1)[0] - 1], abs=step)
    widest = int(np.argmax(ends - starts))
    assert angle_interval(K, joint=joint) == (starts[widest], ends[widest])


def test_a_narrow_interval_of_angles_is_found():
    left, right = angle_interval(10.57457)
    assert -1e-5 < left < 0 < right < 1e-5


def test_what_does_not_exist_is_nan_in_the_shape_of_the_arguments():
    assert np.isnan(angle_interval([[20.0, 30.0]])).all()
    assert np.shape(angle_interval([[20.0, 30.0]])) == (2, 1, 2)
    assert angle_intervals(20.0)[0].shape == (0,)
    assert np.isnan(torque_interval(126 * DEG)).all()
    assert np.isnan(stiffness_interval([0.0, 0.0], [16.0, -16.0])).all()
    assert np.isnan(torque_interval(0.0, limits=Limits(min_force=1500.0))).all()
    assert stiffness_interval(np.zeros((3, 1)), np.zeros(4))[0].shape == (3, 4)


def test_more_force_or_more_co_contraction_leaves_less():
    free, tight = stiffness_interval(0.5), stiffness_interval(0.5, limits=Limits(min_force=50.0))
    assert tight[0] > free[0]
    assert tight[1] == free[1]
    assert stiffness_interval(0.5, limits=Limits(max_force=500.0))[1] < free[1]
    floor = stiffness_interval(0.5, limits=Limits(min_cocontraction=3 * BAR))
    assert floor[0] > free[0]
    assert angle_interval(8.5, limits=Limits(min_cocontraction=3 * BAR)) == pytest.approx(angle_interval(8.5))


def test_a_level_along_which_the_stiffness_turns_is_searched():
    """A poor model on a lever: more pressure, less stiffness. The ends of the level are not the extremes."""
    muscle = Tondu2021(0.0081, 21.9 * DEG, 148 * BAR, -9.59 * BAR, -1888 * BAR**2)
    lever = Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435)
    joint = AntagonistJoint(lever, muscle, muscle, angle_limits=(-80 * DEG, 80 * DEG))
    turned = 0
    for theta in np.linspace(-1.2, 1.2, 9):
        T_min, T_max = torque_interval(theta, joint=joint)
        T = (T_min + T_max) / 2
        one, two = joint.sides(theta)
        box = joint.pressure_box(theta)
        ends = (one.pressure_for_torque(T - two.torque(P2)) for P2 in (box.antagonist.lo, box.antagonist.hi))
        P1 = np.append(np.linspace(box.agonist.lo, box.agonist.hi, 20_001), [*ends])
        P1 = np.sort(np.clip(P1, box.agonist.lo, box.agonist.hi))
        P2 = two.pressure_for_torque(T - one.torque(P1))
        P1, P2 = (P[box.contains(P1, P2, 1e-6)] for P in (P1, P2))
        K = joint.stiffness(theta, P1, P2)
        turned += K.max() > max(K[0], K[-1]) + 1e-6 or K.min() < min(K[0], K[-1]) - 1e-6
        assert stiffness_interval(theta, T, joint=joint) == pytest.approx((K.min(), K.max()), rel=1e-6)
    assert turned > 0


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: torque_interval(90), "if degrees were meant"),
        (lambda: stiffness_interval(0.0, np.nan), "T = nan is not finite"),
        (lambda: stiffness_interval([0.0, 0.1], [0.0, 1.0, 2.0]), "shapes do not broadcast"),
        (lambda: angle_interval(-1.0), "K = -1 N·m/rad has to be positive"),
        (lambda: torque_interval(0.0, limits=Limits(min_force=-1)), "min_force = -1"),
        (lambda: torque_interval(0.0, joint=report_joint(), limits=Limits(max_force=0.0)), "max_force = 0"),
        (lambda: torque_interval(0.0, limits=(0.0,)), r"limits = \(0.0,\) have to be Limits"),
        (lambda: torque_interval(0.0, stiffness="shut"), "stiffness = 'shut' has to be a Stiffness"),
        (lambda: torque_interval(0.0, stiffness=Stiffness(force=3.0)), "a joint has no hand"),
        (lambda: torque_interval(0.0, stiffness=Stiffness(tolerance=1.0)), "a tolerance is for `allocate`"),
        (lambda: torque_interval(0.0, joint="report"), "joint = 'report' has to be an AntagonistJoint"),
    ],
)
def test_wrong_input_is_one_sentence(call, said):
    with pytest.raises(InvalidInput, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)
