"""What a mechanism can do at a posture, against all corners of the box, SciPy's hulls and relieved limits."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from allocator import InvalidInput, Limits, Stiffness, allocate, report_joint, stiffness_interval, torque_interval
from allocator.allocation import allocate_at_least
from allocator.feasibility import feasible_targets
from allocator.feasibility.pictures import plot_polygon
from allocator.feasibility.polygon import Programme, outline
from allocator.mechanism import Endpoint, Mechanism, Pulleys, machines
from allocator.muscles import Hogan1984
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR

ARM, HAND, Q = machines.arm26(), Endpoint.planar([0.3, 0.25]), np.array([0.4, 0.7])
LEG = machines.leg37()
FORCE = np.array([3.0, -4.0])


def corners(mechanism, q):
    """Return the pressures of all 2ᵐ corners of the box."""
    return np.array(list(product(*zip(*mechanism.pressure_box(q), strict=True))))


def values(name, mechanism, q, P, endpoint=None, force=(0.0, 0.0)):
    """Return what stands behind a name, from the mechanism itself."""
    if name[0] == "T":
        return mechanism.torque(q, P)[:, int(name[1]) - 1]
    K = mechanism.stiffness(q, P)
    if name[:2] == "Kx":
        inverse = np.linalg.inv(endpoint.jacobian(q))
        K = inverse.T @ (K + np.einsum("i,iab->ab", force, endpoint.hessian(q))) @ inverse
    return K[:, int(name[-2]) - 1, int(name[-1]) - 1]


@pytest.mark.parametrize(
    ("mechanism", "q", "x", "y"),
    [
        (ARM, Q, "K11", "K22"),
        (ARM, Q, "T1", "T2"),
        (ARM, Q, "T1", "K12"),
        (ARM, Q, "Kx11", "Kx12"),
        (LEG, [0.3, -0.2, 0.1], "T2", "K23"),
        (LEG, [0.3, -0.2, 0.1], "T1", "K13"),
    ],
)
def test_the_polygon_is_the_hull_of_all_corners_of_the_box(mechanism, q, x, y):
    hand = {"stiffness": Stiffness(endpoint=HAND, force=FORCE)} if "x" in x else {}
    found = feasible_targets(mechanism, q, **hand)
    polygon, P = found.polygon(x, y), corners(mechanism, q)
    points = np.stack([values(name, mechanism, q, P, HAND, FORCE) for name in (x, y)], axis=1)
    if np.ptp(points, axis=0).min() < 1e-12:
        assert len(polygon.vertices) == 2
        return
    hull = ConvexHull(points)
    assert polygon.area == pytest.approx(hull.volume, rel=1e-9)
    hull_corners = points[hull.vertices]
    nearest = np.abs(polygon.vertices[:, None] - hull_corners[None]).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-9 * np.abs(points).max()
    given = np.stack([values(name, mechanism, q, polygon.P, HAND, FORCE) for name in (x, y)], axis=1)
    assert given == pytest.approx(polygon.vertices, rel=1e-9)


def test_pressures_at_random_stay_inside_and_reach_the_border():
    held = {"T1": 2.0, "T2": 1.0}
    found = feasible_targets(ARM, Q)
    polygon = found.polygon("K11", "K22", held)
    (y0, M), (lo, hi), rng = ARM.targets_map(Q), found.box, np.random.default_rng(0)
    farthest = np.full(len(polygon.edges), -np.inf)
    normals = np.array([[e.end[1] - e.start[1], e.start[0] - e.end[0]] for e in polygon.edges])
    normals /= np.hypot(*normals.T)[:, None]
    for cost in np.vstack([rng.normal(size=(60, 6)), normals @ M[[2, 4]] * BAR]):  # corners of the held set
        P = linprog(-cost / BAR, A_eq=M[:2], b_eq=[2.0, 1.0] - y0[:2], bounds=np.stack([lo, hi], axis=1)).x
        K = ARM.stiffness(Q, P)
        assert polygon.contains(K[0, 0], K[1, 1], 1e-7)
        reached = [n @ (np.diag(K) - e.start) for n, e in zip(normals, polygon.edges, strict=True)]
        farthest = np.maximum(farthest, reached)
    assert farthest == pytest.approx(np.zeros(len(farthest)), abs=1e-6)
    assert not polygon.contains(*(polygon.vertices.max(axis=0) + 0.1))


def test_allocate_gives_what_is_inside_and_not_what_is_outside():
    polygon = feasible_targets(ARM, Q).polygon("K11", "K22", {"T1": 2.0, "T2": 1.0, "K12": 4.5})
    middle = polygon.vertices.mean(axis=0)
    for factor, inside in ((0.999, True), (1.001, False)):
        for K11, K22 in middle + factor * (polygon.vertices - middle):
            a = allocate(Q, [[K11, 4.5], [4.5, K22]], [2.0, 1.0], joint=ARM)
            assert a.success == inside


def test_the_limits_on_an_edge_are_those_that_move_it():
    """Relieved, a limit that stands on an edge lets it move outward; the others do not."""
    held = {"T1": 2.0, "T2": 1.0}
    found = feasible_targets(ARM, Q)
    polygon = found.polygon("K11", "K22", held)
    (y0, M), (lo, hi) = ARM.targets_map(Q), found.box

    def farthest(outward, lo, hi):
        bounds = np.stack([lo, hi], axis=1) / BAR
        best = linprog(-outward @ M[[2, 4]] * BAR, A_eq=M[:2] * BAR, b_eq=[2.0, 1.0] - y0[:2], bounds=bounds)
        return -best.fun

    names = [f"{name} {end}" for name in ARM.muscle_names for end in ("slack", "upper")]
    for edge in polygon.edges:
        outward = np.array([edge.end[1] - edge.start[1], edge.start[0] - edge.end[0]])
        outward /= np.hypot(*outward)
        before = farthest(outward, lo, hi)
        for i, name in enumerate(names):
            step = 0.01 * BAR * np.eye(6)[i // 2]
            after = farthest(outward, lo - step, hi) if i % 2 == 0 else farthest(outward, lo, hi + step)
            assert (after - before > 1e-6) == (name in edge.active)


def test_intervals_are_the_ends_of_polygons():
    found = feasible_targets(ARM, Q, stiffness=Stiffness(endpoint=HAND))
    held = {"T1": 2.0, "T2": 1.0}
    polygon = found.polygon("K12", "Kx11", held)
    assert found.interval("K12", held) == pytest.approx((polygon.vertices[:, 0].min(), polygon.vertices[:, 0].max()))
    low, high = found.interval("K12", held | {"K11": 100.0})
    assert np.isnan(low)
    assert np.isnan(high)


def test_sums_of_targets_and_lines():
    found = feasible_targets(ARM, Q)
    trace = found.polygon({"K11": 1.0, "K22": 1.0}, "K12")
    assert trace.axes[0].name == "1 K11 + 1 K22"
    line = found.polygon("K11", "K22", {"T1": 2.0, "T2": 1.0, "K12": found.interval("K12", {"T1": 2.0, "T2": 1.0})[1]})
    assert line.area == pytest.approx(0.0, abs=1e-3)


def test_a_line_and_a_point_are_polygons_too():
    lo, hi = np.zeros(3), np.ones(3)
    free = Programme(np.zeros((0, 3)), np.zeros(0), lo, hi, True)
    line, sides = outline(free, np.zeros(2), np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]]))
    assert len(line) == len(sides) == 2
    assert sorted(point[0] for point, _ in line) == pytest.approx([0.0, 3.0])
    point, sides = outline(free._replace(hi=lo), np.array([1.0, 2.0]), np.ones((2, 3)))
    assert len(point) == 1
    assert sides == []
    nothing, _ = outline(Programme(np.ones((1, 3)), np.array([5.0]), lo, hi, True), np.zeros(2), np.ones((2, 3)))
    assert nothing == []


def test_a_picture_names_a_muscle_once_on_an_edge():
    """A muscle of Hogan's law goes slack where its supply ends: both limits have one mark."""
    law = Hogan1984(F_max=800.0, eps_max=0.28, P_max=6e5)
    arm = Mechanism(Pulleys(0.3, [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.018), (0.0, -0.018)], 0.12), (law,) * 4)
    polygon = feasible_targets(arm, [0.1, 0.2]).polygon("K11", "K22")
    for text in plot_polygon(polygon).texts[:-1]:
        marks = text.get_text().split()
        assert len(marks) == len(set(marks))


def test_no_arrow_of_a_polygon_points_sideways():
    texts = plot_polygon(feasible_targets(ARM, Q).polygon("K11", "K22", {"T1": 0.0, "T2": 0.0})).texts[:-1]
    assert any("\n" in text.get_text() for text in texts)
    assert all(np.cos(np.radians(text.get_rotation())) > 0.49 for text in texts)


def test_where_nothing_exists_polygons_are_empty():
    found = feasible_targets(ARM, Q, limits=Limits(min_force=3000.0))
    assert not found.exists
    polygon = found.polygon("K11", "K22")
    assert polygon.vertices.shape == (0, 2)
    assert polygon.area == 0.0
    assert not polygon.contains(9.0, 9.0)


def test_tighter_limits_leave_less():
    now = np.full(6, 2.5 * BAR)
    area = [
        feasible_targets(ARM, Q, **options).polygon("K11", "K22").area
        for options in (
            {},
            {"limits": Limits(min_force=60.0)},
            {"limits": Limits(previous=now, max_step=0.5 * BAR)},
            {"limits": Limits(max_force=200.0)},
        )
    ]
    assert area[0] > max(area[1:]) > 0


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: feasible_targets("arm26", Q), "mechanism is a str"),
        (lambda: feasible_targets(ARM, np.zeros((3, 2))), r"q has the shape \(3, 2\); .* one posture \(2,\)"),
        (lambda: feasible_targets(ARM, [1.5, 0.0]), "beyond the range of shoulder"),
        (
            lambda: feasible_targets(
                LEG, [0.3, -0.2, 0.1], stiffness=Stiffness(endpoint=Endpoint.planar([0.3, 0.3, 0.1]))
            ),
            "no affine function",
        ),
        (lambda: feasible_targets(ARM, [0.3, 0.0], stiffness=Stiffness(endpoint=HAND)), "Jacobian is singular"),
        (lambda: feasible_targets(ARM, Q).polygon("K13", "K22"), "no target 'K13'; .* T1 … T2, K11 … K22 .*Kx needs"),
        (lambda: feasible_targets(ARM, Q).polygon("K1", "K22"), "no target 'K1'"),
        (lambda: feasible_targets(ARM, Q).polygon("K12", "K21"), "K12 and K21 are the same"),
        (lambda: feasible_targets(ARM, Q).polygon({"K11": 1, "T1": 1}, "K22"), "different units"),
        (lambda: feasible_targets(ARM, Q).polygon({}, "K22"), "a mapping of names to weights"),
        (lambda: feasible_targets(ARM, Q).polygon("K11", "K22", {"T9": 0}), "no target 'T9'"),
        (lambda: feasible_targets(ARM, Q).polygon("K11", "K22", {"T1": np.nan}), "not finite"),
        (lambda: feasible_targets(ARM, Q).polygon("K11", "K22", [0.0]), "held = .* mapping"),
        (lambda: feasible_targets(ARM, Q).endpoint_stiffness(np.zeros(6)), "no endpoint was given"),
    ],
)
def test_wrong_questions(call, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        call()


def test_a_mechanism_with_many_joints_separates_its_indices():
    arms = np.zeros((22, 11))
    arms[np.arange(22), np.arange(22) // 2] = np.where(np.arange(22) % 2, -0.02, 0.02)
    many = replace(machines.arm26(), routes=machines.Pulleys(0.4, arms, 0.1375), muscles=ARM.muscles[:1] * 22,
                   angle_limits=None, muscle_names=(), joint_names=())  # fmt: skip
    found = feasible_targets(many, np.zeros(11))
    low, high = found.interval("K11,11")
    assert 0 < low < high
    assert found.interval("K1,11") == (0.0, 0.0)


@pytest.mark.parametrize("theta", [-0.6, 0.0, 0.3])
def test_one_joint_can_do_what_its_intervals_say(theta):
    joint = report_joint(SAROSI_DMSP_20_400N)
    found = feasible_targets(Mechanism.from_joint(joint), [theta])
    assert found.interval("T1") == pytest.approx(torque_interval(theta, joint=joint), rel=1e-9)
    low, high = stiffness_interval(theta, 1.0, joint=joint)
    assert found.interval("K11", {"T1": 1.0}) == pytest.approx((low, high), rel=1e-9)
    for K, exists in ((high - 1e-4, True), (high + 1e-4, False)):
        assert allocate_at_least(found.mechanism, [theta], K, 1.0).success == exists
