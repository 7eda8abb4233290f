"""Arms and bends are derivatives of the lengths; K is the derivative of the torque."""

import casadi
import numpy as np
import pytest

from allocator import InvalidInput, allocate
from allocator.mechanism import Link, Mechanism, Pulleys, Sites, Tables, from_function, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR

ARMS = [(0.02, 0), (-0.02, 0), (0, 0.02), (0, -0.02), (0.02, 0.015), (-0.02, -0.015)]


def links():
    """A hinge, a slide on it, and a hinge with another axis, in space."""
    c, s = np.cos(0.4), np.sin(0.4)
    return [
        Link(axis=(0.2, -0.1, 1.0)),
        Link(0, origin=(0.3, 0.0, 0.05), axis=(1.0, 0.3, 0.0), kind="slide", zero=0.02),
        Link(
            1, origin=(0.1, 0.02, 0.0), axis=(0.0, 1.0, 0.4), orientation=((1, 0, 0), (0, c, -s), (0, s, c)), zero=0.1
        ),
    ]


def sites():
    paths = [
        [(-1, (0.05, 0.06, 0.0)), (0, (0.1, 0.05, 0.02))],
        [(-1, (-0.02, -0.05, 0.01)), (0, (0.15, -0.04, 0.0)), (2, (0.2, -0.03, 0.05))],
        [(0, (0.02, 0.04)), (1, (0.02, 0.05, -0.02)), (2, (0.15, 0.04, 0.03))],
        [(-1, (0.0, 0.08, -0.03)), (2, (0.25, 0.02, 0.0))],
    ]
    return Sites(0.4, links(), paths, cable=[0.0, 0.05, 0.0, 0.1])


def lengths(q):
    return casadi.vertcat(0.35 - 0.02 * q[0] + 0.01 * q[0] * q[1], 0.3 + 0.03 * casadi.sin(q[1]) + 0.01 * q[0] ** 2)


def table():
    grid = np.linspace(-1.2, 1.2, 25), np.linspace(-1.0, 1.0, 21)
    a, b = np.meshgrid(*grid, indexing="ij")
    return Tables(0.4, grid, np.stack([0.35 - 0.02 * a + 0.01 * a * b, 0.3 + 0.03 * np.sin(b) + 0.01 * a**2], -1))


ROUTES = {
    "pulleys": Pulleys(0.4, ARMS, 0.1375),
    "sites": sites(),
    "tables": table(),
    "function": from_function(0.4, 2, lengths),
}


@pytest.fixture(params=ROUTES.values(), ids=ROUTES.keys())
def routes(request):
    return request.param


def differences(f, q, h=1e-5):
    """∂f/∂q by central differences, the derivatives last."""
    return np.stack([(f(q + h * e) - f(q - h * e)) / (2 * h) for e in np.eye(q.shape[-1])], axis=-1)


def test_arms_and_bends_are_derivatives_of_the_lengths(routes):
    q = np.random.default_rng(0).uniform(-0.1, 0.1, (5, routes.n))
    at = routes.at(q)
    assert at.arm == pytest.approx(-differences(lambda x: routes.at(x).length, q), abs=1e-9)
    assert at.bend == pytest.approx(-differences(lambda x: routes.at(x).arm, q), abs=1e-8)
    assert np.array_equal(at.bend, at.bend.swapaxes(-1, -2))


@pytest.mark.parametrize("muscle", [SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N], ids=["affine", "not affine"])
def test_the_stiffness_is_the_derivative_of_the_torque(routes, muscle):
    mechanism = Mechanism(routes, muscle)
    rng = np.random.default_rng(1)
    q, P = rng.uniform(-0.1, 0.1, (4, routes.n)), rng.uniform(1, 5, (4, routes.m)) * BAR
    K = mechanism.stiffness(q, P)
    assert K == pytest.approx(-differences(lambda x: mechanism.torque(x, P), q), rel=1e-6, abs=1e-5)
    assert np.array_equal(K, K.swapaxes(-1, -2))


def test_a_single_posture_is_a_row_of_the_batch(routes):
    mechanism = Mechanism(routes, SAROSI_DMSP_20_400N)
    q, P = np.full((3, routes.n), 0.2) * [[1], [2], [3]], np.full(routes.m, 3 * BAR)
    assert mechanism.torque(q, P)[1] == pytest.approx(mechanism.torque(q[1], P), rel=1e-14)
    assert mechanism.stiffness(q, P).shape == (3, routes.n, routes.n)
    assert mechanism.torque(q[0], np.tile(P, (2, 4, 1))).shape == (2, 4, routes.n)


def test_the_targets_map_is_the_torque_and_the_stiffness():
    mechanism = Mechanism(sites(), SAROSI_DMSP_20_400N)
    rng = np.random.default_rng(2)
    q, P = rng.uniform(-0.4, 0.4, (6, 3)), rng.uniform(0, 5, (6, 4)) * BAR
    y0, M = mechanism.targets_map(q)
    y = y0 + (M @ P[..., None])[..., 0]
    assert y == pytest.approx(
        mechanism.stacked(mechanism.torque(q, P), mechanism.stiffness(q, P)), rel=1e-12, abs=1e-12
    )


def test_tables_and_a_function_of_the_same_lengths_agree():
    q = np.random.default_rng(3).uniform(-0.6, 0.6, (20, 2))
    one, two = ROUTES["tables"].at(q), ROUTES["function"].at(q)
    assert one.length == pytest.approx(two.length, abs=1e-7)
    assert one.arm == pytest.approx(two.arm, abs=1e-6)


def test_a_lever_routed_by_sites_is_the_lever_of_a_joint():
    from allocator import AntagonistJoint, Lever

    lever = Lever(0.4, anchor=0.30, lever=0.03, offset=0.0435)
    joint = AntagonistJoint(lever, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    # the anchors below, the lever's arms level: l² = R² + r² ∓ 2 R r sin θ
    paths = [[(-1, (0.0, -0.30)), (0, (-0.03, 0.0))], [(-1, (0.0, -0.30)), (0, (0.03, 0.0))]]
    mechanism = Mechanism(Sites(0.4, [Link()], paths, cable=-0.0435), SAROSI_DMSP_20_400N)
    theta, P = np.linspace(-0.8, 0.8, 9), np.array([3.0, 2.0]) * BAR
    assert mechanism.torque(theta[:, None], P)[:, 0] == pytest.approx(joint.torque(theta, *P), rel=1e-12)
    assert mechanism.stiffness(theta[:, None], P)[:, 0, 0] == pytest.approx(joint.stiffness(theta, *P), rel=1e-10)


def test_off_diagonal_stiffness_comes_from_biarticular_muscles_alone():
    arm, P = machines.arm26(), np.array([3, 2, 2.5, 3.5, 4, 1.5]) * BAR
    single = Mechanism(Pulleys(0.4, ARMS[:4], 0.1375), SAROSI_DMSP_20_400N)
    assert single.stiffness([0.4, -0.3], P[:4])[0, 1] == 0
    assert arm.stiffness([0.4, -0.3], P)[0, 1] > 1


def test_a_joint_that_moves_both_ends_of_a_muscle_has_exactly_no_arm():
    """Rounding errors there were stiffness between joints, which no pressures could take away."""
    links = [Link(axis=(0.0, -1.0, 0.0)), Link(0, (0.3, 0.0, 0.0), axis=(0.0, -1.0, 0.0))]
    upper = [[(-1, (-0.3, 0.0, z)), (0, (0.005, 0.0, z))] for z in (0.04, -0.04)]
    lower = [[(0, (0.0, 0.0, z)), (1, (0.005, 0.0, z))] for z in (0.035, -0.035)]
    arm = Mechanism(Sites(0.2, links, upper + lower, cable=0.133), SAROSI_DMSP_20_400N)
    q = np.array([0.1, -0.15])
    routed = arm.routes.at(q)
    assert (routed.arm[:2, 1] == 0).all()
    assert (routed.arm[2:, 0] == 0).all()
    assert (routed.bend[:2, :, 1] == 0).all()
    assert (routed.bend[2:, 0] == 0).all()
    P = np.array([3.0, 2.5, 3.0, 3.5]) * BAR
    found = allocate(q, np.diag(np.diag(arm.stiffness(q, P))), arm.torque(q, P), joint=arm)
    assert found.status.name == "EXACT"


def test_sites_that_meet_are_told():
    meeting = Sites(0.4, [Link()], [[(-1, (0.1, 0.0)), (0, (0.0, 0.1))], [(-1, (0.2, 0.1)), (0, (0.1, 0.1))]])
    with pytest.raises(InvalidInput, match="neighbouring sites of muscle 1 meet"):
        meeting.at(np.array([-np.pi / 2]))
