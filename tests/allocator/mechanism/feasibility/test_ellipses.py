"""The ellipses over the workspace, against linear programmes of random directions, and the pictures of both."""

import matplotlib.colors
import numpy as np
import pytest
from scipy.optimize import linprog

from allocator import InvalidInput, Stiffness
from allocator.feasibility import endpoint_ellipses, feasible_targets, plot_arm
from allocator.mechanism import Endpoint, Link, Mechanism, Sites, from_function, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

ARM = machines.arm26()
HAND = Endpoint.planar([0.3, 0.25], at_zero=[0.0, 90 * DEG])
POSTURES = np.array([[0.3, -0.5], [0.1, 0.3], [-0.4, 0.6]])
FORCE = np.array([2.0, -1.0])


def extreme_stiffnesses(q, N):
    """Return K_x at corners of what the pressures that hold the torques can give, by random linear programmes."""
    (y0, M), (lo, hi) = ARM.targets_map(q), ARM.pressure_box(q)
    rng, bounds = np.random.default_rng(0), np.stack([lo, hi], axis=1) / BAR
    right = HAND.torque(q, FORCE) + np.array([1.0, 0.5]) - y0[:2]
    costs = rng.normal(size=(N, 3)) @ M[2:] * BAR
    P = np.array([linprog(cost, A_eq=M[:2] * BAR, b_eq=right, bounds=bounds).x for cost in costs]) * BAR
    return HAND.stiffness(q, ARM.stiffness(q, P), FORCE)


def tilt(K_x):
    """Return the angle of the eigenvector of the greatest eigenvalue."""
    vectors = np.linalg.eigh(K_x)[1][..., -1]
    return np.arctan2(vectors[..., 1], vectors[..., 0])


def test_softest_stiffest_and_tilts_enclose_what_pressures_give():
    found = endpoint_ellipses(ARM, HAND, POSTURES, [1.0, 0.5], force=FORCE)
    assert found.exists.all()
    assert found.x == pytest.approx(HAND.position(POSTURES))
    for i, q in enumerate(POSTURES):
        K = extreme_stiffnesses(q, 60)
        trace = np.trace(K, axis1=1, axis2=2)
        assert np.trace(found.softest[i]) <= trace.min() + 1e-6
        assert np.trace(found.stiffest[i]) >= trace.max() - 1e-6
        assert np.trace(found.stiffest[i]) == pytest.approx(trace.max(), rel=0.02)
        low, high = found.tilt[i]
        inside = (tilt(K) - low) % np.pi
        assert ((inside <= high - low + 1e-9) | (inside > np.pi - 1e-9)).all()
        if high - low < np.pi:
            assert inside[inside < np.pi - 1e-9].max() > 0.9 * (high - low)


def test_where_the_hand_can_be_round_all_tilts_exist():
    found = endpoint_ellipses(ARM, HAND, [0.1, 0.3])
    if found.tilt[1] - found.tilt[0] < np.pi - 1e-9:
        found = endpoint_ellipses(ARM, HAND, [0.1, 0.45])
    assert found.tilt[1] - found.tilt[0] == pytest.approx(np.pi)
    feasible = feasible_targets(ARM, found.q, stiffness=Stiffness(endpoint=HAND))
    difference = {"Kx11": 1.0, "Kx22": -1.0}
    low, high = feasible.interval(difference, {"T1": 0.0, "T2": 0.0, "Kx12": 0.0})
    assert low < 0 < high


def test_torques_that_do_not_exist_leave_no_ellipse():
    found = endpoint_ellipses(ARM, HAND, POSTURES[:2], [[0.0, 0.0], [90.0, 0.0]])
    assert found.exists.tolist() == [True, False]
    axes = found.plot()
    assert {"stiffest", "softest", "torques do not exist"} <= {t.get_text() for t in axes.get_legend().get_texts()}


def test_axes_have_the_names_of_the_hand_s_coordinates_and_numbers_do_not_overlap():
    links = [Link(axis=(0.0, -1.0, 0.0)), Link(0, (0.3, 0.0), axis=(0.0, -1.0, 0.0))]
    hand = Endpoint.on_link(links, 1, (0.25, 0.0), axes="xz")
    crowd = POSTURES[0] + np.linspace(0, 0.02, 5)[:, None]
    axes = endpoint_ellipses(ARM, hand, np.vstack([crowd, POSTURES])).plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x of the hand [m]", "z of the hand [m]")
    axes.figure.draw_without_rendering()
    places = [text.get_window_extent() for text in axes.texts]
    assert 1 < len(places) < 5 + len(POSTURES)
    assert not any(one.overlaps(other) for i, one in enumerate(places) for other in places[:i])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda: endpoint_ellipses(machines.leg37(), Endpoint.planar([0.3, 0.3, 0.1]), np.zeros(3)),
            "dim = 2 .* n = 2 ",
        ),
        (lambda: endpoint_ellipses(ARM, [0.3, 0.3], np.zeros(2)), "not a list"),
        (lambda: endpoint_ellipses(ARM, HAND, np.zeros(3)), r"q has the shape \(3,\); expected \(…, 2\)"),
        (lambda: plot_arm(ARM, HAND, POSTURES, np.full(6, 3e5)), "one posture is drawn at a time"),
        (lambda: plot_arm(ARM, Endpoint.from_function(2, lambda q: q), POSTURES[0], np.full(6, 3e5)), "on links"),
        (
            lambda: plot_arm(ARM, Endpoint.on_link([Link(), Link(0)], 1, (0.2, 0)), POSTURES[0], np.full(6, 3e5)),
            "only an arm in the plane xy",
        ),
        (lambda: plot_arm(ARM, HAND, POSTURES[0], np.full(5, 3e5)), r"P has the shape \(5,\)"),
    ],
)
def test_wrong_questions(call, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        call()


def test_an_arm_is_drawn_with_its_muscles_and_its_ellipse():
    q, P = np.array([0.3, 0.1]), np.array([3, 3, 2, 2, 5, 1.5]) * BAR
    axes = plot_arm(ARM, HAND, q, P)
    _, _, *muscles, curve = axes.lines
    assert len(muscles) == 6
    assert len({matplotlib.colors.to_hex(line.get_color()) for line in muscles}) == 4  # pressures
    points = np.array(curve.get_data()).T - HAND.position(q)
    longest = points[np.hypot(*points.T).argmax()]
    K_x = HAND.stiffness(q, ARM.stiffness(q, P))
    assert abs(np.sin(np.arctan2(longest[1], longest[0]) - tilt(K_x))) < 0.05
    reaches = {tuple(line.get_data()[1][[0, -1]].round(6)) for line in muscles}
    assert len(reaches) == 6  # none hides another


def test_muscles_between_sites_are_drawn_where_they_run():
    links = [Link(), Link(0, (0.3, 0.0))]
    paths = [[(-1, (-0.05, side)), (0, (0.1, 0.6 * side))] for side in (0.06, -0.06)]
    paths += [[(0, (0.05, side)), (1, (0.08, 0.5 * side))] for side in (0.05, -0.05)]
    mechanism = Mechanism(Sites(0.4, links, paths, cable=[-0.2, -0.2, -0.05, -0.05]), SAROSI_DMSP_20_400N)
    hand = Endpoint.on_link(links, 1, (0.25, 0.0), axes="xy")
    q = np.array([0.1, 0.4])
    axes = plot_arm(mechanism, hand, q, np.full(4, 3 * BAR))
    assert np.array(axes.lines[2].get_data()).T == pytest.approx(mechanism.routes.positions(q)[0][:, :2])
    hidden = Mechanism(from_function(0.4, 2, lambda q: [0.35 - 0.02 * q[0], 0.35 - 0.02 * q[1]]), SAROSI_DMSP_20_400N)
    with pytest.raises(InvalidInput, match="Pulleys and Sites"):
        plot_arm(hidden, hand, q, np.full(2, 3 * BAR))


def test_edges_carry_the_letters_of_the_muscles():
    axes = feasible_targets(ARM, [0.4, -0.3]).polygon("K11", "K22", {"T1": 2.0, "T2": 1.0}).plot()
    texts = [text.get_text() for text in axes.texts]
    assert any("SF↑" in text for text in texts)
    assert any("shoulder flexor" in text for text in texts)
    assert axes.get_xlabel() == "stiffness K11 [N·m/rad]"
    assert axes.get_title(loc="left") == "feasible at T1 = 2 N·m, T2 = 1 N·m"
    empty = feasible_targets(ARM, [0.4, -0.3]).polygon("K11", "K22", {"T1": 90.0}).plot()
    assert empty.get_title(loc="left") == "nothing exists at T1 = 90 N·m"
