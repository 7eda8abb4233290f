"""Laws of the joint: stiffness is the slope of torque, mirror symmetry, work, limits."""

from dataclasses import replace

import casadi
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from allocator import AntagonistJoint, InvalidInput, Lever, Limits, Pulley, Status, Table, allocate, report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

shares = st.floats(0.0, 1.0)
pressures = st.floats(0.02 * BAR, 5 * BAR)


def angle(joint, share):
    left, right = joint.angle_range
    return left + 0.01 + share * (right - left - 0.02)


def five_point(f, x, h):
    return (8 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12 * h)


@given(share=shares, P1=pressures, P2=pressures)
def test_stiffness_is_the_slope_of_torque(joint, share, P1, P2):
    theta = angle(joint, share)
    slope = five_point(lambda x: joint.torque(x, P1, P2), theta, 1e-4)
    # a table's stiffness has kinks at its knots, where a difference is less exact
    assert joint.stiffness(theta, P1, P2) == pytest.approx(-slope, rel=1e-7, abs=1e-6)


@given(share=shares, P1=pressures, P2=pressures)
def test_the_jacobian_is_the_slope_by_the_pressures(joint, share, P1, P2):
    theta = angle(joint, share)
    (T1, T2), (K1, K2) = joint.jacobian(theta, P1, P2)
    h = 100.0  # Pa
    assert T1 == pytest.approx(five_point(lambda P: joint.torque(theta, P, P2), P1, h), rel=1e-7)
    assert T2 == pytest.approx(five_point(lambda P: joint.torque(theta, P1, P), P2, h), rel=1e-7)
    assert K1 == pytest.approx(five_point(lambda P: joint.stiffness(theta, P, P2), P1, h), rel=1e-6, abs=1e-12)
    assert K2 == pytest.approx(five_point(lambda P: joint.stiffness(theta, P1, P), P2, h), rel=1e-6, abs=1e-12)


@given(share=shares)
def test_the_arm_is_the_work_balance_of_the_contraction(joint, share):
    theta, l0 = angle(joint, share), joint.geometry.rest_length
    for side, sign in ((joint.geometry.agonist, +1), (joint.geometry.antagonist, -1)):
        arm = sign * l0 * five_point(lambda x, s=side: s(x).contraction, theta, 1e-3)
        assert side(theta).arm == pytest.approx(arm, rel=1e-8)
        assert side(theta).arm > 0
        slope = five_point(lambda x, s=side: s(x).arm, theta, 1e-4)
        assert side(theta).arm_slope == pytest.approx(slope, rel=1e-6, abs=1e-7)


@given(share=shares, P1=pressures, P2=pressures)
def test_swapping_the_muscles_mirrors_the_joint(share, P1, P2):
    joint = report_joint()
    theta = angle(joint, share)
    assert joint.torque(-theta, P2, P1) == pytest.approx(-joint.torque(theta, P1, P2), rel=1e-12, abs=1e-12)
    assert joint.stiffness(-theta, P2, P1) == pytest.approx(joint.stiffness(theta, P1, P2), rel=1e-12)


@pytest.mark.slow
@given(share=shares, P1=pressures, P2=pressures)
def test_symbols_and_numbers_agree(joint, share, P1, P2):
    x = casadi.SX.sym("x", 3)
    f = casadi.Function("f", [x], [joint.torque(x[0], x[1], x[2]), joint.stiffness(x[0], x[1], x[2])])
    theta = angle(joint, share)
    T, K = (float(v) for v in f([theta, P1, P2]))
    assert T == pytest.approx(joint.torque(theta, P1, P2), rel=1e-11, abs=1e-11)
    assert K == pytest.approx(joint.stiffness(theta, P1, P2), rel=1e-11)


@given(share=shares, P1=st.floats(2 * BAR, 5 * BAR), P2=st.floats(2 * BAR, 5 * BAR))
def test_the_equilibrium_angle_carries_its_torque(joint, share, P1, P2):
    theta = angle(joint, share)
    T = joint.torque(theta, P1, P2)
    assume(joint.stiffness(theta, P1, P2) > 1.0)  # near the dead point of a lever an angle is not held
    found = joint.equilibrium(P1, P2, T)
    assert joint.torque(found, P1, P2) == pytest.approx(T, rel=1e-9, abs=1e-9)
    assert joint.stiffness(found, P1, P2) > 0
    if isinstance(joint.geometry, Pulley):  # one equilibrium only
        assert found == pytest.approx(theta, rel=1e-9, abs=1e-9)


def test_there_is_no_equilibrium_beyond_the_joint_range(joint):
    assert np.isnan(joint.equilibrium(3 * BAR, 3 * BAR, [-1e3, 1e3])).all()


@given(share=shares, min_force=st.floats(0, 150))
def test_the_box_ends_where_the_cable_goes_slack(joint, share, min_force):
    box = joint.pressure_box(angle(joint, share), Limits(min_force=min_force))
    for side, interval in zip(joint.sides(angle(joint, share)), box, strict=True):
        if not interval.empty and interval.lo > 0:
            assert side.force(interval.lo) == pytest.approx(min_force, rel=1e-8, abs=1e-7)
        assert interval.lo >= 0
        assert interval.hi <= min(5 * BAR, side.muscle.max_pressure)


def test_the_box_shrinks_to_what_the_slew_limit_reaches():
    joint = report_joint()
    now = (np.array(2 * BAR), np.array(0.5 * BAR))  # the antagonist is slack now: 0.5 bar < 1.53 bar
    box = joint.pressure_box(0.0, Limits(previous=now, max_step=0.1 * BAR))
    assert (float(box.agonist.lo), float(box.agonist.hi)) == pytest.approx((1.9 * BAR, 2.1 * BAR))
    assert (float(box.antagonist.lo), float(box.antagonist.hi)) == pytest.approx((0.6 * BAR, 0.6 * BAR))


def test_a_table_of_samples_is_the_geometry_that_it_samples():
    lever = Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435)
    angles = np.linspace(-1.4, 1.4, 141)
    table = Table(0.40, angles, lever.agonist(angles).contraction, lever.antagonist(angles).contraction)
    joints = [AntagonistJoint(g, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N) for g in (lever, table)]
    theta = np.linspace(-1.2, 1.2, 50)
    T = [joint.torque(theta, 3 * BAR, 2 * BAR) for joint in joints]
    K = [joint.stiffness(theta, 3 * BAR, 2 * BAR) for joint in joints]
    assert T[0] == pytest.approx(T[1], rel=1e-5)
    assert K[0] == pytest.approx(K[1], rel=1e-4, abs=1e-3)


def test_the_geometric_part_of_a_lever_s_stiffness_destabilises():
    """Mathematics.md section 1: on a real lever joint it is -11 … -18 % of the elastic part."""
    lever = Lever(rest_length=0.24, anchor=0.1655, lever=0.05094, offset=0.051)
    joint = AntagonistJoint(lever, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    elastic = sum(-(s.arm**2) / 0.24 * s.muscle.slope(3 * BAR, s.contraction) for s in joint.sides(0.0))
    assert joint.stiffness(0.0, 3 * BAR, 3 * BAR) < elastic


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: Pulley(0.4, -0.02, 0.1), "radius = -0.02"),
        (lambda: Pulley(0.4, 0.02, 13.75), "percent"),
        (lambda: Pulley(0.4, 1e-300, 0.1), "shorter than any part of a joint"),
        (lambda: Lever(0.4, 0.03, 0.3), "has to exceed the lever"),
        (lambda: Table(0.4, [0, 1], [0, 1], [0, 1]), "at least 3 samples"),
        (lambda: Table(0.4, [0, 1, 1, 2], [0, 0.1, 0.2, 0.3], [0.3, 0.2, 0.1, 0]), "does not after index 1"),
        (lambda: Table(0.4, [-60, 0, 60], [0, 0.1, 0.2], [0.2, 0.1, 0]), "if degrees were meant, pass -1.047"),
        (lambda: Table(0.4, [-1, 0, 1], [9, 13, 17], [0.2, 0.1, 0]), "if percent was meant, divide by 100"),
        (lambda: Table(0.4, [-1, 0, np.nan], [0, 0.1, 0.2], [0.2, 0.1, 0]), "Table: theta.2. = nan"),
        (lambda: Table(0.4, [0, 1, 2, 3], [0.3, 0.2, 0.1, 0], [0, 0.1, 0.2, 0.3]), "wrong slope"),
        (lambda: report_with(pressure_limits=(0, 5)), "if bar was meant"),
        (lambda: report_with(pressure_limits=(5e5, 0)), "0 <= lower < upper"),
        (lambda: report_with(angle_limits=(-90, 90)), "if degrees were meant"),
        (lambda: report_with(angle_limits=(1, -1)), "have to increase"),
        (lambda: report_with(min_contraction=0.2), "no joint angle"),
        (lambda: report_with(min_contraction=2.5), "min_contraction = 2.5 is no contraction ratio; if percent"),
        (lambda: replace(report_joint(), agonist="sarosi-dmsp-20-400n"), "has to be a Muscle, such as named_muscle"),
        (lambda: replace(report_joint(), geometry=0.02), "geometry = 0.02 has to be a Geometry"),
        (lambda: report_joint().torque(0.0, 5, 3), "if bar was meant"),
        (lambda: report_joint().stiffness(90, 5e5, 3e5), "if degrees were meant"),
    ],
)
def test_a_joint_that_cannot_be_is_refused_in_a_sentence(build, said):
    with pytest.raises(InvalidInput, match=said.replace("(", r"\(")):
        build()


def report_with(**changes):
    joint = report_joint()
    return AntagonistJoint(joint.geometry, joint.agonist, joint.antagonist, **changes)


@pytest.mark.parametrize(
    ("geometry", "reach"),
    [
        (Lever(rest_length=0.4, anchor=0.3, lever=0.03, offset=0.0435), 89 * DEG),
        (Table(0.4, [-1.0, 0.0, 1.0], [0.09, 0.13, 0.17], [0.17, 0.13, 0.09]), 1.0),
    ],
)
def test_end_stops_do_not_let_a_joint_turn_beyond_its_mechanism(geometry, reach):
    joint = AntagonistJoint(geometry, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=(-125 * DEG, 125 * DEG))
    assert joint.angle_range == pytest.approx((-reach, reach))
    assert allocate(110 * DEG, 5.0, joint=joint).status == Status.OUTSIDE_JOINT_RANGE


def test_a_pressure_of_a_few_pascal_is_believed_beside_one_of_some_bar():
    joint = report_joint()
    assert joint.torque(0.1, 3 * BAR, 5.0) == pytest.approx(joint.torque(0.1, 3 * BAR, 0.0), abs=1e-3)
    assert joint.equilibrium(3 * BAR, 5.0) == pytest.approx(joint.equilibrium(3 * BAR, 0.0), abs=1e-3, nan_ok=True)


def test_degrees_are_named_as_such():
    assert 90 * DEG == pytest.approx(np.pi / 2)
