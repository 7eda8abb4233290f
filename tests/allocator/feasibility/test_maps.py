"""Maps are what `allocate` answers, their edges what ends it."""

import numpy as np
import pytest

from allocator import InvalidInput, Limit, Limits, Status, allocate, report_joint
from allocator.feasibility import feasibility_map, stiffness_interval, torque_interval
from allocator.joint.gravity import Gravity
from allocator.units import BAR, DEG

REPORT = report_joint()


@pytest.mark.parametrize(
    "options", [{}, {"min_force": 50.0, "max_force": 600.0}, {"min_cocontraction": 3 * BAR}, {"min_force": None}]
)
def test_a_cell_is_feasible_within_the_stiffness_interval_of_its_angle_and_torque(joint, options):
    left, right = joint.angle_range
    theta = np.linspace(left - 0.1, right + 0.1, 13)  # beyond the joint range too
    K, T = np.linspace(1.5, 12, 17), np.linspace(-12, 12, 7)
    found = feasibility_map(theta, K, T, joint=joint, limits=Limits(**options))
    K_min, K_max = (
        end[:, None] for end in stiffness_interval(theta[:, None], T, joint=joint, limits=Limits(**options))
    )
    assert (found.feasible == ((K_min <= K[:, None]) & (K[:, None] <= K_max))).all()
    assert found.feasible.any()
    assert not found.feasible.all()


def test_where_no_pressure_keeps_a_cable_taut_the_map_says_slack():
    found = feasibility_map(np.linspace(-125, 125, 21) * DEG, np.linspace(5, 12, 7), limits=Limits(500.0))
    assert (found.status == Status.SLACK).any()


def test_a_million_cells_are_answered_in_a_few_passes_over_arrays():
    chunks = []

    def counted(steps):
        for step in steps:
            chunks.append(step)
            yield step

    feasibility_map(np.linspace(*REPORT.angle_range, 1000), np.linspace(5, 12, 1000), progress=counted)
    assert 1 <= len(chunks) <= 32


@pytest.mark.parametrize("T", [0.0, 4.0])
def test_edges_at_a_torque_are_the_ends_of_the_stiffness_interval(joint, T):
    edges = feasibility_map(None, np.linspace(1, 12, 11), T, joint=joint).edges
    assert edges
    for edge in edges:
        assert edge.T == pytest.approx(T, abs=1e-6)
        K_min, K_max = stiffness_interval(edge.theta, T, joint=joint)
        if edge.limits & (Limit.JOINT_RANGE | Limit.CONTRACTION_THRESHOLD):
            assert (edge.K[0], edge.K[-1]) == pytest.approx((K_min[0], K_max[0]), rel=1e-6)
        else:
            there = np.isfinite(K_min)  # the last point may be beyond the reach of the torque by rounding
            ends = np.abs([edge.K - K_min, edge.K - K_max])[:, there]
            assert (ends.min(axis=0) <= 1e-6 * np.abs(edge.K[there])).all()


def test_along_every_edge_its_limit_binds_and_no_other(joint):
    K = float(np.mean(stiffness_interval(0.3, joint=joint)))
    for held in ({"T": 1.0}, {"K": K}, {"theta": 0.3}):
        axes = {"theta": None, "K": np.linspace(1, 12, 5), "T": np.linspace(-9, 9, 5)} | held
        edges = feasibility_map(**axes, joint=joint).edges
        assert edges
        for edge in edges:
            if edge.limits & (Limit.JOINT_RANGE | Limit.CONTRACTION_THRESHOLD) or len(edge.theta) < 3:
                continue
            middle = slice(1, -1)  # the ends belong to two edges
            box = joint.pressure_box(edge.theta[middle])
            binding = box.binding(edge.P1[middle], edge.P2[middle], 1.0)
            assert ((binding & edge.limits) == edge.limits).all()
            assert (binding == edge.limits).mean() > 0.8
            assert box.contains(edge.P1[middle], edge.P2[middle], 1.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("held", [{"T": 0.0}, {"T": 5.0}, {"K": 8.0}, {"theta": 0.6}], ids=str)
def test_edges_meet_where_one_limit_hands_over_to_another(joint, held):
    """Every end of an edge is an end of another, or of the feasible set as a whole."""
    axes = {"theta": None, "K": np.linspace(1, 12, 5), "T": np.linspace(-9, 9, 5)} | held
    edges = feasibility_map(**axes, joint=joint).edges
    points = [np.array([e.theta[i], e.K[i], e.T[i]]) for e in edges for i in (0, -1)]
    size = np.maximum(np.ptp(points, axis=0), 1e-9) if points else 1.0
    for i, point in enumerate(points):
        gaps = [np.abs((point - other) / size).max() for j, other in enumerate(points) if j != i]
        assert min(gaps) < 1e-4


def test_the_corners_of_the_report_s_map_are_where_two_limits_bind():
    edges = {edge.active: edge for edge in feasibility_map().edges if edge.theta[0] < 0}
    assert edges["P2 upper",].K[[0, -1]] == pytest.approx([8.288, 10.575], abs=1e-3)
    assert edges["agonist slack", "antagonist slack"].K.min() == pytest.approx(6.486, abs=1e-3)
    wall = edges["joint range",]
    assert wall.theta / DEG == pytest.approx([-125, -125])
    assert wall.K == pytest.approx([7.027, 8.288], abs=1e-3)


def test_edges_at_an_angle_enclose_its_feasible_torques():
    edges = feasibility_map(0.3, np.linspace(5, 11, 5), np.linspace(-20, 20, 5)).edges
    T = np.concatenate([edge.T for edge in edges])
    assert (T.min(), T.max()) == pytest.approx(torque_interval(0.3), rel=1e-9)
    assert {edge.active for edge in edges} == {
        ("P1 upper",),
        ("P2 upper",),
        ("agonist slack",),
        ("antagonist slack",),
    }


def test_the_joint_range_ends_at_the_threshold_without_stops():
    free = type(REPORT)(REPORT.geometry, REPORT.agonist, REPORT.antagonist)
    walls = [e for e in feasibility_map(joint=free).edges if e.limits & Limit.CONTRACTION_THRESHOLD]
    assert len(walls) == 2
    assert np.abs([wall.theta[0] for wall in walls]) / DEG == pytest.approx(128.9, abs=0.05)


@pytest.mark.slow
def test_without_ranges_the_map_shows_all_that_exists():
    for axes in ({}, {"theta": 0.5, "T": None}, {"K": 8.0, "T": None}, {"T": None}):
        found = feasibility_map(**axes) if len(axes) else feasibility_map(None, None)
        status = found.status if found.status.ndim == 2 else found.status[:, :, 100]
        assert (status == Status.EXACT).any()
        if found.K.ndim and not found.T.ndim:
            assert not (status[:, [0, -1]] == Status.EXACT).any()
        if not found.theta.ndim:
            assert not (status[:, [0, -1]] == Status.EXACT).any()


@pytest.mark.slow
def test_a_map_with_three_axes_is_its_slices():
    T = np.array([0.0, 2.0, 4.0])
    whole = feasibility_map(np.linspace(-1, 1, 5), np.linspace(6, 10, 7), T)
    assert whole.varied == ("theta", "K", "T")
    for part, torque in zip(whole.slices, T, strict=True):
        alone = feasibility_map(np.linspace(-1, 1, 5), np.linspace(6, 10, 7), torque)
        assert (part.status == alone.status).all()
        assert part.P1 == pytest.approx(alone.P1)
    assert len(whole.edges) == sum(len(part.edges) for part in whole.slices)


def test_csv_has_one_row_a_cell_in_the_units_of_people(tmp_path):
    found = feasibility_map(np.array([0.0, 60.0]) * DEG, np.array([6.0, 8.0, 12.0]), 1.0)
    found.to_csv(tmp_path / "map.csv")
    head, *rows = (tmp_path / "map.csv").read_text(encoding="utf-8").splitlines()
    assert head == "theta_deg,stiffness_Nm_per_rad,torque_Nm,status,limits,P1_bar,P2_bar"
    assert len(rows) == 6
    answer = allocate(60 * DEG, 8.0, 1.0)
    theta, K, T, status, limits, P1, P2 = rows[4].split(",")
    assert (float(theta), float(K), float(T), status, limits) == (pytest.approx(60), 8.0, 1.0, "EXACT", "")
    assert (float(P1), float(P2)) == pytest.approx((answer.P1 / BAR, answer.P2 / BAR))
    assert rows[5].split(",")[3:5] == ["STIFFNESS_LIMITED", "P1 upper"]


def test_npz_holds_cells_and_edges_in_si(tmp_path):
    found = feasibility_map(np.linspace(-1, 1, 11), np.linspace(6, 11, 5))
    found.to_npz(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as stored:
        assert (stored["status"] == found.status).all()
        assert stored["P1"] == pytest.approx(found.P1)
        parts = np.split(stored["edge_points"], stored["edge_starts"][1:])
        assert len(parts) == len(found.edges)
        for points, flags, edge in zip(parts, stored["edge_limits"], found.edges, strict=True):
            assert flags == edge.limits
            assert points[:, list(stored["edge_columns"]).index("K")] == pytest.approx(edge.K)
        assert stored["status_names"][Status.SLACK] == "SLACK"


def test_long_maps_report_their_progress():
    seen = []

    def progress(chunks):
        for chunk in chunks:
            seen.append(chunk)
            yield chunk

    feasibility_map(np.linspace(-1, 1, 800), np.linspace(6, 11, 1000), progress=progress)
    assert len(seen) > 2


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: feasibility_map([], [7.0, 8.0]), "theta = .* is an empty range"),
        (lambda: feasibility_map([0.0], [7.0, 8.0]), "empty range"),
        (
            lambda: feasibility_map([1.0, 0.0], [7.0, 8.0]),
            r"theta has to increase, but theta\[0\] = 1 and theta\[1\] = 0",
        ),
        (lambda: feasibility_map([0.0, 1.0], [7.0, 7.0]), "K has to increase"),
        (lambda: feasibility_map([[0.0, 1.0]], [7.0, 8.0]), "theta has the shape"),
        (lambda: feasibility_map([-90, 90], [7.0, 8.0]), "if degrees were meant"),
        (lambda: feasibility_map([0.0, 1.0], [-1.0, 8.0]), "has to be positive"),
        (lambda: feasibility_map([0.0, 1.0], 8.0), "two or three of theta, K and T"),
        (lambda: feasibility_map([0.0, 1.0], None, 50.0), "none of these angles and torques exist"),
        (lambda: feasibility_map(max_bytes=1e6), r"201 theta × 201 K needs .* GB, max_bytes = 0.001 GB"),
        (lambda: feasibility_map(T=np.linspace(-1, 1, 10**6)), "10{6} T needs .* max_bytes = 1 GB"),
    ],
)
def test_wrong_input_is_one_sentence(call, said):
    with pytest.raises(InvalidInput, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_torques_are_beyond_gravity():
    gravity, theta, K = Gravity(2.0, 0.3), np.linspace(-1.5, 1.5, 9), np.linspace(3, 11, 7)
    found = feasibility_map(theta, K, 0.5, gravity=gravity)
    held = allocate(theta[:, None], K, 0.5 + gravity.moment(theta)[:, None])
    np.testing.assert_array_equal(found.P1, held.P1)
    np.testing.assert_array_equal(found.status, held.status)
    for edge in found.edges:
        np.testing.assert_allclose(edge.T, 0.5, atol=1e-8)
        np.testing.assert_allclose(REPORT.torque(edge.theta, edge.P1, edge.P2), 0.5 + gravity.moment(edge.theta))
    across, at = feasibility_map(0.4, K, None, gravity=gravity), gravity.moment(0.4)
    bare = feasibility_map(0.4, K, None)
    np.testing.assert_allclose(across.T + at, bare.T, atol=1e-9)
    np.testing.assert_array_equal(across.feasible, bare.feasible)
    for edge, other in zip(across.edges, bare.edges, strict=True):
        np.testing.assert_allclose(edge.T + at, other.T, atol=1e-8)
        np.testing.assert_allclose(edge.K, other.K, rtol=1e-7)
