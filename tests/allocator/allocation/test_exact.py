"""Laws of `allocate`: in the box, exact where possible, never beaten, and truthful about what binds."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from allocator import AntagonistJoint, Limit, Limits, Status, Table, allocate, inverse
from allocator.muscles import PolynomialMcKibben
from allocator.units import BAR, DEG

shares = st.floats(0.0, 1.0).map(lambda x: round(x, 4))  # no pressures of a few Pa: they are refused as bar
PRIORITIES = ("torque", "stiffness", "weighted")
MINUTE = 1e-9  # of the scale of torque or stiffness
_ANGLES = np.linspace(-0.9, 0.9, 4)
_POLYNOMIAL = PolynomialMcKibben.identify(0.01, 23.5 * DEG, (3 * BAR, 4 * BAR, 5 * BAR), (0.25, 0.28, 0.3))
UNCOMMANDED = AntagonistJoint(
    Table(0.4, _ANGLES, 0.13 + 0.04 * np.sin(_ANGLES), 0.13 - 0.045 * np.sin(_ANGLES)),
    _POLYNOMIAL,
    _POLYNOMIAL,
    angle_limits=(-45 * DEG, 45 * DEG),
)


def target(joint, share_theta, share_T, share_K, stretch=1.0):
    """An angle in the joint range, and targets across `stretch` times the ranges of torque and stiffness there."""
    left, right = joint.angle_range
    theta = left + share_theta * (right - left)
    T_min, T_max = allocate(theta, 5.0, joint=joint).torque_interval
    T = (T_min + T_max) / 2 + stretch * (share_T - 0.5) * (T_max - T_min)
    box = joint.pressure_box(theta)
    corners = [joint.stiffness(theta, P1, P2) for P1 in ends(box.agonist) for P2 in ends(box.antagonist)]
    K_min, K_max = min(corners), max(corners)
    return theta, max((K_min + K_max) / 2 + stretch * (share_K - 0.5) * (K_max - K_min), 0.01), T


def ends(interval):
    return float(interval.lo), float(interval.hi)


def options(priority, **more):
    return {"priority": priority, "weights": (2.0, 5.0) if priority == "weighted" else None, **more}


def inside(interval, share):
    return interval.lo + share * (interval.hi - interval.lo)


def point(joint, share, s1, s2):
    """An angle of the joint range, its pressure box, and pressures in it."""
    left, right = joint.angle_range
    theta = left + share * (right - left)
    box = joint.pressure_box(theta)
    return theta, box, inside(box.agonist, s1), inside(box.antagonist, s2)


@given(share=shares, s1=shares, s2=shares)
def test_the_inverse_of_the_direct_model_is_the_identity(joint, share, s1, s2):
    theta, _box, P1, P2 = point(joint, share, s1, s2)
    K, T = joint.stiffness(theta, P1, P2), joint.torque(theta, P1, P2)
    if K > 0 and allocate(theta, K, T, joint=joint).pairs == 1:
        found = inverse(theta, K, T, joint=joint)
        assert np.array(found) == pytest.approx(np.array([P1, P2]), rel=1e-7, abs=1e-2)


@pytest.mark.parametrize("priority", PRIORITIES)
@given(share=shares, s1=shares, s2=shares)
def test_a_feasible_target_is_met(joint, priority, share, s1, s2):
    theta, box, P1, P2 = point(joint, share, s1, s2)
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    if K > 0 and not box.empty:
        a = allocate(theta, K, T, joint=joint, **options(priority))
        assert abs(a.T_error) <= 1e-8 * max(abs(T), 1.0)
        assert abs(a.K_error) <= 1e-8 * K
        assert a.status is Status.EXACT
        assert a.success


@pytest.mark.parametrize("priority", PRIORITIES)
@given(share=shares, share_T=shares, share_K=shares, max_step=st.sampled_from([None, 0.2 * BAR]))
def test_every_answer_lies_in_the_box_and_says_what_binds(joint, priority, share, share_T, share_K, max_step):
    theta, K, T = target(joint, share, share_T, share_K, stretch=3)
    slew = {} if max_step is None else {"limits": Limits(previous=(2.5 * BAR, 2.0 * BAR), max_step=max_step)}
    a = allocate(theta, K, T, joint=joint, **options(priority, **slew))
    box = joint.pressure_box(theta, **slew)
    assert box.contains(a.P1, a.P2)
    assert (a.T, a.K) == pytest.approx((joint.torque(theta, a.P1, a.P2), joint.stiffness(theta, a.P1, a.P2)), rel=1e-9)
    if not a.success:
        assert a.active
    at_bound = {
        Limit.P1_LOWER: a.P1 - 0.0,
        Limit.P1_UPPER: a.P1 - 5 * BAR,
        Limit.P2_LOWER: a.P2 - 0.0,
        Limit.P2_UPPER: a.P2 - 5 * BAR,
        Limit.AGONIST_SLACK: a.forces[0],
        Limit.ANTAGONIST_SLACK: a.forces[1],
        Limit.P1_RATE: abs(a.P1 - 2.5 * BAR) - (max_step or 0),
        Limit.P2_RATE: abs(a.P2 - 2.0 * BAR) - (max_step or 0),
    }
    for limit, distance in at_bound.items():
        if limit.text in a.active:
            assert distance == pytest.approx(0, abs=1e-2)  # Pa, or N


def beats(e_T, e_K, a, priority, scales):
    """Where errors (e_T, e_K) are better than the answer's by more than rounding."""
    T_scale, K_scale = scales
    mine_T, mine_K = abs(a.T_error), abs(a.K_error)
    if priority == "weighted":
        mine = 2 * mine_T**2 + 5 * mine_K**2
        return 2 * e_T**2 + 5 * e_K**2 < mine - 1e-9 * (mine + 1e-9)
    pairs = [(np.abs(e_T), mine_T, T_scale * MINUTE), (np.abs(e_K), mine_K, K_scale * MINUTE)]
    (first, mine_1, tol_1), (second, mine_2, tol_2) = pairs if priority == "torque" else pairs[::-1]
    return (first < mine_1 - tol_1) | ((first <= mine_1 + 1e-3 * tol_1) & (second < mine_2 - tol_2))


def scales(joint, theta):
    sides = joint.sides(theta)
    return sum(abs(s.torque(5 * BAR)) for s in sides), sum(abs(s.stiffness(5 * BAR)) for s in sides)


@pytest.mark.slow
@pytest.mark.parametrize("priority", PRIORITIES)
@given(share=shares, share_T=shares, share_K=shares)
def test_no_point_of_a_fine_grid_over_the_box_is_better(joint, priority, share, share_T, share_K):
    theta, K, T = target(joint, share, share_T, share_K, stretch=2)
    a = allocate(theta, K, T, joint=joint, **options(priority))
    one, two = joint.sides(theta)
    box = joint.pressure_box(theta)
    P1, P2 = np.linspace(*ends(box.agonist), 400), np.linspace(*ends(box.antagonist), 400)[:, None]
    e_T, e_K = one.torque(P1) + two.torque(P2) - T, one.stiffness(P1) + two.stiffness(P2) - K
    assert not beats(e_T, e_K, a, priority, scales(joint, theta)).any()


@pytest.mark.slow
@pytest.mark.parametrize("priority", ["torque", "stiffness"])
@given(share=shares, share_T=shares, share_K=shares)
def test_nothing_on_the_level_of_the_first_target_is_better(joint, priority, share, share_T, share_K):
    """On the curve of all pressures with the torque (or stiffness) of the answer, found here by bisection."""
    theta, K, T = target(joint, share, share_T, share_K, stretch=1.5)
    a = allocate(theta, K, T, joint=joint, **options(priority))
    one, two = joint.sides(theta)
    box = joint.pressure_box(theta)
    quantity, level = ("torque", a.T) if priority == "torque" else ("stiffness", a.K)
    total = [getattr(side, quantity) for side in (one, two)]
    P1 = np.linspace(*ends(box.agonist), 400)
    lo, hi = (np.full_like(P1, end) for end in ends(box.antagonist))
    f_lo, f_hi = total[0](P1) + total[1](lo) - level, total[0](P1) + total[1](hi) - level
    crosses = f_lo * f_hi < 0
    for _ in range(60):
        middle = (lo + hi) / 2
        f_middle = total[0](P1) + total[1](middle) - level
        lo, hi = np.where(f_middle * f_lo > 0, middle, lo), np.where(f_middle * f_lo > 0, hi, middle)
    P1, P2 = P1[crosses], lo[crosses]
    e_T, e_K = one.torque(P1) + two.torque(P2) - T, one.stiffness(P1) + two.stiffness(P2) - K
    other, mine = (e_K, a.K_error) if priority == "torque" else (e_T, a.T_error)
    assert (np.abs(other) >= abs(mine) - 1e-8 * max(scales(joint, theta))).all()


@pytest.mark.slow
@pytest.mark.parametrize("priority", PRIORITIES)
@given(share=shares, share_T=shares, share_K=shares, direction=st.floats(0, 2 * np.pi), size=st.floats(1.0, 1e4))
def test_nudging_the_pressures_never_helps(joint, priority, share, share_T, share_K, direction, size):
    theta, K, T = target(joint, share, share_T, share_K, stretch=2)
    a = allocate(theta, K, T, joint=joint, **options(priority))
    box = joint.pressure_box(theta)
    P1 = np.clip(a.P1 + size * np.cos(direction), *ends(box.agonist))
    P2 = np.clip(a.P2 + size * np.sin(direction), *ends(box.antagonist))
    one, two = joint.sides(theta)
    e_T, e_K = one.torque(P1) + two.torque(P2) - T, one.stiffness(P1) + two.stiffness(P2) - K
    assert not beats(e_T, e_K, a, priority, scales(joint, theta))


@pytest.mark.parametrize("priority", PRIORITIES)
def test_a_batch_is_the_same_as_its_elements(joint, priority):
    rng = np.random.default_rng(0)
    targets = np.array([target(joint, *row, stretch=2) for row in rng.uniform(size=(12, 3))]).T
    theta, K, T = targets.reshape(3, 3, 4)
    batch = allocate(theta, K, T, joint=joint, **options(priority))
    assert batch.P1.shape == batch.status.shape == batch.active.shape == (3, 4)
    for index in np.ndindex(3, 4):
        one = allocate(theta[index], K[index], T[index], joint=joint, **options(priority))
        assert (one.P1, one.P2) == pytest.approx((batch.P1[index], batch.P2[index]), rel=1e-9, abs=1e-3)
        assert one.status == batch.status[index]
        assert one.active == batch.active[index]


def test_targets_broadcast_like_a_ufunc():
    a = allocate(np.linspace(-1, 1, 5)[:, None], [6.8, 7.5, 8.0], 0.5)
    assert a.P1.shape == a.T_error.shape == a.torque_interval[0].shape == (5, 3)
    assert a.jacobian().shape == (5, 3, 2, 3)
    assert not a.P1.flags.writeable
    assert "15 targets: 15 EXACT" in a.message


@pytest.mark.parametrize("degrees", [126, 200, -300])
def test_an_angle_beyond_the_range_is_answered_at_its_end(degrees):
    a = allocate(degrees * DEG, 7.5, 0.3)
    nearest = allocate(np.sign(degrees) * 125 * DEG, 7.5, 0.3)
    assert a.status is Status.OUTSIDE_JOINT_RANGE
    assert (a.P1, a.P2) == (nearest.P1, nearest.P2)
    assert "joint range" in a.active
    assert a.jacobian()[:, 0] == pytest.approx([0, 0])


def test_a_cable_that_no_pressure_keeps_taut_is_reported():
    a = allocate(0.0, 7.5, limits=Limits(min_force=2000.0))
    assert a.status is Status.SLACK
    assert set(a.active) >= {"agonist slack", "antagonist slack"} or set(a.active) >= {"P1 upper", "P2 upper"}


def test_torque_is_kept_where_stiffness_cannot_be():
    a = allocate(0.3, 20.0, 2.0)
    assert a.T == pytest.approx(2.0, rel=1e-12)
    assert a.status is Status.STIFFNESS_LIMITED
    assert a.stiffness_interval[1] == pytest.approx(a.K)


def test_stiffness_is_kept_where_torque_cannot_be():
    a = allocate(0.3, 7.5, 20.0, priority="stiffness")
    assert a.K == pytest.approx(7.5, rel=1e-12)
    assert a.status is Status.TORQUE_LIMITED


def test_the_analytic_method_leaves_nan_where_no_inverse_exists():
    a = allocate([0.0, 0.0], [7.5, 16.0], method="analytic")
    assert np.isnan(a.P1).tolist() == [False, True]
    assert [Status(s).name for s in a.status] == ["EXACT", "NO_INVERSE"]
    assert "K_crit" in allocate(0.0, 16.0, method="analytic").message


@pytest.mark.slow
@pytest.mark.parametrize("priority", PRIORITIES)
@settings(max_examples=8)  # for each of 27 joints and priorities
@given(share=shares, share_T=shares, share_K=shares)
@example(share=1.0, share_T=0.75, share_K=0.75)
def test_the_jacobian_is_the_slope_of_the_answer(joint, priority, share, share_T, share_K):
    x = np.array(target(joint, 0.02 + 0.96 * share, share_T, share_K, stretch=2))

    def pressures(x):
        a = allocate(*x, joint=joint, **options(priority))
        return np.array([a.P1, a.P2]), a.active

    answer = allocate(*x, joint=joint, **options(priority))
    if answer.pairs > 1 or np.isnan(answer.jacobian()).any():  # several sheets, or where the stiffness turns
        return
    if answer.success and answer.active:
        return  # met on a limit: the active set is about to change, and the slope is one-sided
    if isinstance(joint.geometry, Table) and np.abs(joint.geometry.theta - x[0]).min() < 1e-3:
        return  # a kink of the spline's stiffness
    steps = np.diag([1e-4, 1e-4, 1e-3])
    for column, step in enumerate(steps):
        near = [pressures(x + k * step) for k in (-2, -1, 1, 2)]
        if any(active != answer.active for _, active in near):
            continue  # the active set changes here: the slope is one-sided
        (p2m, p1m, p1, p2), h = (P for P, _ in near), step.max()
        slope = (8 * (p1 - p1m) - (p2 - p2m)) / (12 * h)
        assert answer.jacobian()[:, column] == pytest.approx(slope, rel=1e-4, abs=5.0)


@pytest.mark.parametrize("priority", PRIORITIES)
@pytest.mark.parametrize("road", [float, lambda x: np.full(3, x)], ids=["scalar", "array"])
@pytest.mark.parametrize("huge", [1e13, 1e80, 1e300])
def test_a_target_out_of_all_proportion_asks_for_as_much_as_there_is(joint, priority, road, huge):
    """What is beyond reach by any amount is missed by the same pressures, and what they give is told to all digits."""
    left, right = joint.angle_range
    theta = left + 0.55 * (right - left)
    T_min, T_max = allocate(theta, 5.0, joint=joint).torque_interval
    K = joint.stiffness(theta, 5 * BAR, 5 * BAR)
    for far_K, far_T in ((huge, 0.3 * T_max), (0.6 * K, huge), (0.6 * K, -huge), (huge, huge)):
        a = allocate(theta, road(far_K), far_T, joint=joint, **options(priority))
        K_near, T_near = min(far_K, 1e4 * K), np.clip(far_T, 1e4 * T_min, 1e4 * T_max)
        near = allocate(theta, K_near, T_near, joint=joint, **options(priority))
        close = 1e-2 if priority == "weighted" else 1e-8  # of the span: what is weighted is nearly all for the greater
        assert np.abs(a.P1 - near.P1) == pytest.approx(0.0, abs=close * joint.pressure_span)
        assert np.abs(a.P2 - near.P2) == pytest.approx(0.0, abs=close * joint.pressure_span)
        assert np.array(a.T) == pytest.approx(joint.torque(theta, a.P1, a.P2), rel=1e-9, abs=1e-9)
        assert np.array(a.K) == pytest.approx(joint.stiffness(theta, a.P1, a.P2), rel=1e-9)
        assert np.unique(a.status).tolist() == [near.status]


@pytest.mark.parametrize("priority", PRIORITIES)
def test_next_to_no_stiffness_asks_for_as_little_as_there_is(joint, priority):
    for tiny in (1e-9, 1e-80, 1e-300):
        for T in (0.0, 1e300):
            a, near = (allocate([0.1], K, T, joint=joint, **options(priority)) for K in (tiny, 1e-6))
            assert a.P1 == pytest.approx(near.P1, abs=1e-2 * joint.pressure_span)
            assert a.status == near.status


@given(share=shares, s1=shares, s2=shares)
def test_no_torque_is_lost_where_the_stiffness_cannot_be_commanded(share, s1, s2):
    """Of a law with F_Pε = 0 the determinant is rounding, and its inverse is nothing to rely on."""
    theta, box, P1, P2 = point(UNCOMMANDED, share, s1, s2)
    T, K = UNCOMMANDED.torque(theta, P1, P2), UNCOMMANDED.stiffness(theta, P1, P2)
    if K > 0 and not box.empty:
        for a in (allocate(theta, K, T, joint=UNCOMMANDED), allocate(np.array([theta]), K, T, joint=UNCOMMANDED)):
            assert np.array(a.T) == pytest.approx(T, abs=1e-9)
