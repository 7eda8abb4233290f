"""Muscles that are not affine: curves are enclosed, bounds are safe whatever a solver did, answers are optimal."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from allocator import Gas, InvalidInput, Limits, Method, Status, Stiffness, allocate
from allocator.allocation.relaxation.curves import Curve, Level, _safe, relax
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism import Mechanism, Pulleys, machines
from allocator.muscles import Andrikopoulos2016, TonduLopez2000, Wickramatunge2010
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR, DEG
from benchmarks.mechanisms.nonaffine import ARM, laws
from benchmarks.mechanisms.targets import POSTURE, random_targets

LAWS = {
    "Tondu2021": replace(TONDU_DMSP_20_400N, inner_radius=0.01),
    "TonduLopez2000": TonduLopez2000(0.01, 25 * DEG, 1.2, 0.5, 1 * BAR),
    "Andrikopoulos2016": Andrikopoulos2016(0.01, 25 * DEG, 1.5, 2.0, 1 * BAR, 0.8),
    "Wickramatunge2010": Wickramatunge2010(0.4, 0.29, 2e3, 1e5, 0.03, 2e-8, 1e-8, 2.5 * BAR, inner_radius=0.01),
}
JOINTS_NOT_AFFINE = ("report", "tondu-c-pulley", "tondu-lever", "tondu-unequal-pulley")
UNIT = st.floats(0.0, 1.0)


def curve_of(law, eps, share=None):
    muscle = LAWS[law]
    side = OneMuscle(muscle, "muscle 1", 0.4, eps, np.array([0.02]), np.zeros((1, 1)), share, vector=True)
    return Curve.of(side, max(float(muscle.pressure(10.0, eps)), 0.0), min(5 * BAR, muscle.max_pressure))


def beyond(polygon, points):
    """How far points (…, 2) are outside the convex hull of `polygon`, over the size of either coordinate."""
    size = np.abs(points).max(axis=0)
    turn = np.linspace(0, 2 * np.pi, 361)
    d = np.stack([np.cos(turn), np.sin(turn)], axis=1) / size
    return ((points @ d.T).max(axis=0) - (polygon @ d.T).max(axis=0)).max()


# --- curves ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [None, 1.0], ids=["isobaric", "shut"])
@pytest.mark.parametrize("law", LAWS)
@given(eps=st.floats(0.03, 0.2), ends=st.tuples(UNIT, UNIT))
@example(eps=0.125, ends=(0.0, 0.5))  # it ends at a jump
def test_polygons_enclose_the_curve(law, share, eps, ends):
    curve = curve_of(law, eps, share)
    a, b = curve.lo + np.sort(ends) * (curve.hi - curve.lo)
    polygon, P = curve.enclosure(float(a), float(b)), np.linspace(a, b, 400)
    P = P[~np.isin(P, curve.jumps)]  # one that ends the part may belong to its neighbour
    assert P.size == 0 or beyond(polygon, curve.at(P)) < 1e-10


@pytest.mark.parametrize("law", LAWS)
def test_polygons_of_parts_become_the_curve(law):
    """Their width over the chord falls with the square of the part's, or it would be no use to branch."""
    curve = curve_of(law, 0.12)
    middle = 0.9 * curve.lo + 0.1 * curve.hi

    def width(part):
        polygon = curve.enclosure(middle, middle + part * (curve.hi - curve.lo))
        (x, y), corners = polygon[1] - polygon[0], polygon - polygon[0]
        return np.ptp((corners[:, 0] * y - corners[:, 1] * x) / np.hypot(x, y))

    assert width(0.01) < 1.5e-2 * width(0.1) + 1e-12


def test_a_jump_of_the_shut_stiffness_is_seen_and_enclosed():
    curve = curve_of("Wickramatunge2010", 0.1, 1.0)
    assert curve.jumps == pytest.approx([2.5 * BAR])
    below, above = curve.at(np.array([2.5 * BAR - 1.0, 2.5 * BAR + 1.0]))[:, 1]
    assert abs(above - below) > 0.01 * below
    polygon = curve.enclosure(2.4 * BAR, 2.6 * BAR)
    assert beyond(polygon, curve.at(np.linspace(2.4, 2.6, 4001) * BAR)) < 1e-10


# --- bounds ---------------------------------------------------------------------------------------------------------


def random_level(seed, rows=4, kept=0):
    """Return a level of three muscles, and polygons around parts of their curves, with points (S, 6) on these."""
    rng = np.random.default_rng(seed)
    curves = [curve_of(law, eps) for law, eps in zip(LAWS, rng.uniform(0.05, 0.2, 3), strict=False)]
    ends = [np.sort(rng.uniform(c.lo, c.hi, 2)) for c in curves]
    P = [rng.uniform(*e, 300) for e in ends]
    points = np.concatenate([c.at(p) for c, p in zip(curves, P, strict=True)], axis=1)
    size = np.abs(points).max(axis=0)
    G, E = rng.normal(size=(rows, 6)) / size, rng.normal(size=(kept, 6)) / size
    b = G @ points[0] + rng.normal(size=rows) * rng.choice([0.0, 0.1, 3.0])
    polygons = [c.enclosure(*map(float, e)) for c, e in zip(curves, ends, strict=True)]
    return polygons, Level(G, b, E, E @ points[1]), points


@given(seed=st.integers(0, 10_000))
def test_no_point_of_the_curves_is_below_the_bound(seed):
    polygons, level, points = random_level(seed)
    least = min(level.cost(v) for v in points)
    relaxed = relax(polygons, level)
    assert relaxed.bound <= least + 1e-12
    assert relaxed.bound == pytest.approx(level.cost(relaxed.v), abs=1e-6)  # so the solver has done its part


@given(seed=st.integers(0, 10_000), kept=st.integers(0, 2))
def test_the_bound_is_safe_whatever_the_solver_did(seed, kept):
    """Any x and any multipliers give a bound of what satisfies the equalities: here the second point of the curves."""
    polygons, level, points = random_level(seed, kept=kept)
    rng = np.random.default_rng(seed)
    x, multipliers = points[2] * rng.normal(1, 0.5, 6), rng.normal(size=kept) * 10
    assert _safe(polygons, level, x, multipliers) <= level.cost(points[1]) + 1e-9


def test_equalities_that_cannot_be_had_are_proved_to_be():
    polygons, level, _ = random_level(5, kept=1)
    assert np.isfinite(relax(polygons, level).bound)
    assert relax(polygons, level._replace(e=level.e + 100.0)).bound == np.inf


# --- answers --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("priority", ["torque", "stiffness", "weighted"])
@pytest.mark.parametrize("name", JOINTS_NOT_AFFINE)
def test_one_joint_has_the_pressures_of_allocate(joints, name, priority):
    joint, rng, weights = joints[name], np.random.default_rng(3), (1.0, 1.0) if priority == "weighted" else None
    theta, (P1, P2) = rng.uniform(*joint.angle_range, 10), rng.uniform(0, 5, (2, 10)) * BAR
    K = np.where(np.arange(10) % 2, np.abs(joint.stiffness(theta, P1, P2)) + 0.1, rng.uniform(0.5, 40, 10))
    T = joint.torque(theta, P1, P2) * np.where(np.arange(10) % 2, 1.0, 3.0)
    for limits in ({}, {"limits": Limits(min_force=40.0, max_force=900.0)}):
        one = allocate(theta, K, T, joint=joint, priority=priority, weights=weights, **limits)
        many = allocate(
            *(theta[:, None], K[:, None], T[:, None]),
            joint=Mechanism.from_joint(joint),
            **({"priority": priority, "weights": weights} | limits),
        )
        assert many.P == pytest.approx(np.stack([one.P1, one.P2], axis=-1), abs=1e-9 * 5 * BAR)
        holds = many.status != Status.UNSTABLE
        assert np.array_equal(many.status[holds], one.status[holds])
        assert many.gap.max() <= 1e-3
        assert many.kkt_residual.max() < 1e-9


def test_what_can_be_had_is_given_and_costs_nothing():
    t = random_targets(ARM, POSTURE, 12, seed=5)
    lo, hi = ARM.pressure_box(POSTURE)
    P = np.random.default_rng(1).uniform(lo, hi, (4, 6))
    a = allocate(POSTURE, ARM.stiffness(POSTURE, P), ARM.torque(POSTURE, P), joint=ARM)
    assert a.success.all()
    assert a.gap.max() < 1e-20
    assert a.kkt_residual.max() < 1e-9
    assert ((a.P**2).sum(axis=1) <= (P**2).sum(axis=1)).all()  # the least pressures nearby
    assert ARM.torque(POSTURE, a.P) == pytest.approx(ARM.torque(POSTURE, P), abs=1e-9)
    F, k, *_ = laws(P[0], 0.1375 + np.array(ARM.routes.arms) @ POSTURE / 0.4)
    assert t.mechanism is ARM
    assert F @ np.array(ARM.routes.arms) == pytest.approx(ARM.torque(POSTURE, P[0]))  # as the benchmark has it
    assert k == pytest.approx([side.own_stiffness(p) for side, p in zip(ARM.at(POSTURE), P[0], strict=True)])


def test_what_is_missed_has_a_bound_a_direction_and_the_limits_in_the_way():
    K, T = ARM.stiffness(POSTURE, np.full(6, 3 * BAR)), ARM.torque(POSTURE, np.full(6, 3 * BAR))
    a = allocate(POSTURE, K + np.diag([20.0, 0.0]), T, joint=ARM)
    assert a.status == Status.STIFFNESS_LIMITED
    assert a.torque_met
    assert a.holds
    assert 0 < a.gap <= 1e-3
    assert a.lower_bounds[0] == 0
    assert a.lower_bounds[1] == pytest.approx(a.costs[1], rel=2e-3)
    assert a.costs[1] == pytest.approx((a.K_error**2).sum())
    assert "shoulder flexor upper" in a.active
    d, reach, asked = a.separation
    P = np.random.default_rng(2).uniform(*a.box, (20_000, 6))
    y = ARM.stacked(ARM.torque(POSTURE, P), ARM.stiffness(POSTURE, P))
    assert (y @ d).max() <= reach < asked


def test_pressures_are_those_nearest_to_the_previous():
    P = np.array([3.0, 2.0, 2.5, 3.5, 4.0, 1.5]) * BAR
    K, T = ARM.stiffness(POSTURE, P), ARM.torque(POSTURE, P)
    now = P + 0.1 * BAR
    a = allocate(POSTURE, K, T, joint=ARM, limits=Limits(previous=now))
    assert a.success
    assert np.linalg.norm(a.P - now) <= np.linalg.norm(P - now)
    slow = allocate(POSTURE, K, T, joint=ARM, limits=Limits(previous=now, max_step=0.02 * BAR))
    assert np.abs(slow.P - now).max() <= 0.02 * BAR * (1 + 1e-9)
    assert not slow.success


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_every_law_of_the_catalogue_is_answered(law):
    """Mixed with affine muscles, with trapped gas, within the gap; what is given is what the mechanism says."""
    filled = replace(SAROSI_DMSP_20_400N, inner_radius=0.01)
    mixed = replace(ARM.with_muscles((LAWS[law], LAWS[law], filled, filled, LAWS[law], LAWS[law])), gas=Gas(1.2))
    P = np.full(6, 3 * BAR)
    for valves in ("open", (True, True, False, False, True, False)):
        K, T = mixed.stiffness(POSTURE, P, valves), mixed.torque(POSTURE, P)
        a = allocate(POSTURE, K, T, joint=mixed, stiffness=Stiffness(valves))
        assert a.success
        assert mixed.stiffness(POSTURE, a.P, valves) == pytest.approx(K, abs=1e-8)
        b = allocate(POSTURE, 0.8 * K, T, joint=mixed, stiffness=Stiffness(valves))
        assert b.torque_met
        assert b.gap <= 1e-3
        at_jump = np.abs(b.P - 2.5 * BAR) < 1.0  # of the shut stiffness, where no derivative vanishes
        assert b.kkt_residual < 1e-9 or (law == "Wickramatunge2010" and valves != "open" and at_jump.any())


def test_a_force_that_falls_with_the_pressure_is_refused_by_name():
    falls = Mechanism(Pulleys(0.4, [(0.02,), (-0.02,)], 0.13), LAWS["Andrikopoulos2016"])
    with pytest.raises(InvalidInput, match=r"the force of muscle 1 .Andrikopoulos2016. does not rise .*min_force"):
        allocate([0.0], 5.0, 0.0, joint=falls, limits=Limits(min_force=None))
    assert np.isfinite(allocate([0.0], 5.0, 0.0, joint=falls).P).all()


@pytest.mark.parametrize("gap", [0.0, 1.0, -1e-3, np.nan])
def test_a_gap_has_to_be_a_share(gap):
    with pytest.raises(InvalidInput, match="gap"):
        allocate(POSTURE, 9.0, 1.0, joint=machines.arm26(), method=Method(gap=gap))


def test_affine_muscles_have_no_gap():
    a = allocate(POSTURE, [[90.0, 4.0], [4.0, 9.0]], 1.0, joint=machines.arm26())
    assert a.status == Status.STIFFNESS_LIMITED
    assert a.gap == 0
    assert a.lower_bounds == pytest.approx(a.costs)
