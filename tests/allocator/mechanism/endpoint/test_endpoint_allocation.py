"""Endpoint stiffness is allocated exactly where it can be had, and else nearest in its own measure."""

import numpy as np
import pytest
from scipy.linalg import sqrtm
from scipy.optimize import linprog, minimize

from allocator import InvalidInput, Status, Stiffness, allocate
from allocator.mechanism import Endpoint, Mechanism, Pulleys, machines
from allocator.muscles import SAROSI_DMSP_20_400N
from allocator.units import BAR

ARM, HAND = machines.arm26(), Endpoint.planar([0.3, 0.25])
LEG, FOOT = machines.leg37(), Endpoint.planar([0.3, 0.3, 0.1])
SINGLE = np.kron(np.diag([0.02, 0.02, 0.018, 0.015]), [[1], [-1]])  # [m], a pair of muscles a joint
PAIRS = [[0.02, 0.015, 0, 0], [-0.02, -0.015, 0, 0], [0, 0, 0.015, 0.012], [0, 0, -0.015, -0.012]]
ARM4 = Mechanism(Pulleys(0.4, [*SINGLE, *PAIRS], 0.1375), SAROSI_DMSP_20_400N)
HAND4 = Endpoint.planar([0.3, 0.25, 0.2, 0.1])
Q, Q3 = np.array([0.5, 0.8]), np.array([0.5, -0.4, 0.3])
FORCE = np.array([3.0, -5.0])


def made(mechanism, endpoint, q, N, seed=0):
    """Return N endpoint stiffnesses with their torques beside those of `FORCE`, made by pressures."""
    P = np.random.default_rng(seed).uniform(*mechanism.pressure_box(q), (N, mechanism.m))
    K_x = endpoint.stiffness(q, mechanism.stiffness(q, P), FORCE)
    return K_x, mechanism.torque(q, P) - endpoint.torque(q, FORCE)


def size(error, asked):
    """‖K*^(-1/2) error K*^(-1/2)‖_F, which is the root of the trace of (K*⁻¹ error)²."""
    ratio = np.linalg.solve(asked, error)
    return np.sqrt(np.trace(ratio @ ratio, axis1=-2, axis2=-1))


def test_what_pressures_give_is_given():
    K_x, T = made(ARM, HAND, Q, 60)
    a = allocate(Q, K_x, T, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=FORCE))
    assert a.success.all()
    assert a.K_x == pytest.approx(K_x, rel=1e-10)
    assert a.T == pytest.approx(T + HAND.torque(Q, FORCE), rel=1e-10)
    assert a.endpoint_error.max() < 1e-10
    assert np.abs(a.K_x_error).max() < 1e-6
    by_joints = allocate(Q, HAND.joint_stiffness(Q, K_x, FORCE), T + HAND.torque(Q, FORCE), joint=ARM)
    assert a.P == pytest.approx(by_joints.P, rel=1e-9)
    assert a.x == pytest.approx(np.broadcast_to(HAND.position(Q), (60, 2)))


def test_postures_forces_and_stiffnesses_broadcast():
    q, f = np.array([[0.5, 0.8], [0.3, 0.6], [0.2, 0.9]]), np.array([[3.0, 1.0], [0.0, 0.0], [-2.0, 4.0]])
    together = allocate(q, 400.0, 1.0, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=f))
    for i in range(3):
        alone = allocate(q[i], 400.0, 1.0, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=f[i]))
        assert together.P[i] == pytest.approx(alone.P, rel=1e-9)
        assert together.K_x[i] == pytest.approx(alone.K_x, rel=1e-9)


def test_beyond_reach_the_nearest_in_its_measure_is_given():
    import cvxpy  # a second that every worker would spend at collection

    K_x, T = made(ARM, HAND, Q, 4, seed=1)
    K_x = K_x * np.array([1.6, 2.2, 0.5, 3.0])[:, None, None]
    a = allocate(Q, K_x, T, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=FORCE))
    assert not a.stiffness_met.any()
    lo, hi = ARM.pressure_box(Q)
    inverse = np.linalg.inv(HAND.jacobian(Q))
    load = np.einsum("i,iab->ab", FORCE, HAND.hessian(Q))
    at_zero = ARM.torque(Q, np.zeros(6)), ARM.stiffness(Q, np.zeros(6))
    gains = [(ARM.torque(Q, e) - at_zero[0], ARM.stiffness(Q, e) - at_zero[1]) for e in BAR * np.eye(6)]
    for i in range(4):
        bar = cvxpy.Variable(6)
        K = at_zero[1] + load + sum(bar[j] * gain[1] for j, gain in enumerate(gains))
        root = np.linalg.cholesky(np.linalg.inv(K_x[i])).T  # another root than the library's
        error = root @ inverse.T @ K @ inverse @ root.T - np.eye(2)
        torque = at_zero[0] + sum(bar[j] * gain[0] for j, gain in enumerate(gains))
        kept = [torque == T[i] + HAND.torque(Q, FORCE), bar >= lo / BAR, bar <= hi / BAR]
        best = cvxpy.Problem(cvxpy.Minimize(cvxpy.norm(error, "fro")), kept).solve(solver="CLARABEL")
        assert a.endpoint_error[i] == pytest.approx(best, abs=1e-6)
        assert size(a.K_x_error[i], K_x[i]) == pytest.approx(best, abs=1e-6)
        assert (
            "N/m at the endpoint"
            in allocate(Q, K_x[i], T[i], joint=ARM, stiffness=Stiffness(endpoint=HAND, force=FORCE)).message
        )


def test_a_direction_proves_what_is_beyond_reach_by_joint_quantities():
    K_x, T = made(ARM, HAND, Q, 30, seed=2)
    a = allocate(Q, 2.5 * K_x, T, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=FORCE))
    (y0, M), (lo, hi) = ARM.targets_map(Q), ARM.pressure_box(Q)
    K = HAND.joint_stiffness(Q, 2.5 * K_x, FORCE)
    asked = np.concatenate([T + HAND.torque(Q, FORCE), K[:, [0, 0, 1], [0, 1, 1]]], axis=1)
    for d, reach, said, y in zip(*a.separation, asked, strict=True):
        assert d @ y0 + np.maximum(d @ M * lo, d @ M * hi).sum() == pytest.approx(reach, rel=1e-9)
        assert d @ y == pytest.approx(said, rel=1e-9)
        assert reach < said


def test_only_the_diagonal_may_be_asked_for():
    a = allocate(Q, [350.0, 500.0], joint=ARM, stiffness=Stiffness(endpoint=HAND))
    assert a.success
    assert np.diag(a.K_x) == pytest.approx([350.0, 500.0])
    assert np.isnan(a.K_x_error[0, 1])
    assert a.endpoint_error < 1e-10


def test_both_methods_and_the_other_priorities():
    K_x, T = made(ARM, HAND, Q, 3, seed=3)
    for options in ({}, {"priority": "stiffness"}, {"priority": "weighted", "weights": (1.0, 50.0)}):
        a = allocate(Q, 2 * K_x, T, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=FORCE), **options)
        b = allocate(Q, 2 * K_x, T, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=FORCE), method="qp", **options)
        assert a.P == pytest.approx(b.P, rel=1e-5)
        assert a.kkt_residual.max() < 1e-9


def test_more_joints_than_coordinates():
    K_x, T = made(LEG, FOOT, Q3, 12)
    a = allocate(Q3, K_x, T, joint=LEG, stiffness=Stiffness(endpoint=FOOT, force=FORCE))
    met = a.status == Status.EXACT
    assert met.sum() >= 10
    assert FOOT.stiffness(Q3, a.K, FORCE)[met] == pytest.approx(K_x[met], rel=1e-9)
    assert a.T == pytest.approx(T + FOOT.torque(Q3, FORCE), abs=1e-9)


def test_with_more_joints_only_a_hand_too_soft_is_proved_nearest():
    K_x, T = made(LEG, FOOT, Q3, 1, seed=1)
    for times, proved in ((1.0, True), (4.0, True), (0.2, False)):
        a = allocate(Q3, times * K_x[0], T[0], joint=LEG, stiffness=Stiffness(endpoint=FOOT, force=FORCE))
        cost = a.endpoint_error**2
        assert a.gap == (pytest.approx(0.0, abs=1e-12) if proved else pytest.approx(cost / (1 + cost)))
        assert a.lower_bounds[-1] == pytest.approx(cost if proved else 0.0, abs=1e-12)
        assert ("a local optimum, which does not exclude a nearer one" in a.message) == (not proved)
        assert np.isnan(a.separation.reach) == (a.success or not proved)


@pytest.mark.parametrize(
    ("q", "K_x", "T"),
    [
        ([0.7, -0.21, -0.04, -0.71], [[2210.0, 480.0], [480.0, 4370.0]], [-0.8, -2.9, 3.0, -2.2]),
        ([0.67, -0.7, -0.58, 0.43], [[6740.0, -490.0], [-490.0, 9180.0]], [1.7, -1.0, -2.8, -3.0]),
        ([-0.2, -0.32, 0.95, 0.79], [[20720.0, 10620.0], [10620.0, 5630.0]], [1.7, 1.9, 1.3, -2.9]),
    ],
)
def test_a_redundant_hand_far_too_soft_is_proved_nearest_by_a_linear_programme(q, K_x, T):
    a = allocate(q, K_x, T, joint=ARM4, stiffness=Stiffness(endpoint=HAND4))
    assert (a.status, a.gap) == (Status.STIFFNESS_LIMITED, pytest.approx(0.0, abs=1e-9))
    J, root = HAND4.jacobian(q), np.linalg.inv(sqrtm(K_x).real)
    G = np.linalg.solve(a.K, J.T) @ np.linalg.inv(J @ np.linalg.solve(a.K, J.T))
    short = np.eye(2) - root @ G.T @ a.K @ G @ root
    d = G @ root @ short @ root @ G.T  # ⟨short, E⟩ ≤ ⟨d, K⟩ for all K, since K_x is concave
    (y0, M), box = ARM4.targets_map(q), np.stack(ARM4.pressure_box(q), axis=-1)
    along = 2 * (d - np.diag(np.diag(d)) / 2)[np.triu_indices(4)]
    most = linprog(-along @ M[4:] * BAR, A_eq=M[:4] * BAR, b_eq=a.T - y0[:4], bounds=box / BAR)
    reach = along @ y0[4:] - most.fun
    assert np.linalg.norm(short) == pytest.approx(a.endpoint_error) == pytest.approx(np.sqrt(a.costs[1]))
    assert (np.trace(short) - reach) / np.linalg.norm(short) == pytest.approx(a.endpoint_error, abs=1e-6)


@pytest.mark.slow
def test_with_more_joints_nearly_all_targets_are_answered():
    rng, N = np.random.default_rng(6), 30
    q, turn = rng.uniform(-1, 1, (N, 4)), np.linalg.qr(rng.normal(size=(N, 2, 2)))[0]
    K_x = (turn * 10 ** rng.uniform(0.5, 4.5, (N, 1, 2))) @ turn.swapaxes(1, 2)
    K_x = (K_x + K_x.swapaxes(1, 2)) / 2
    for options in ({}, {"priority": "stiffness"}, {"priority": "weighted", "weights": (1.0, 50.0)}):
        a = allocate(q, K_x, rng.uniform(-3, 3, (N, 4)), joint=ARM4, stiffness=Stiffness(endpoint=HAND4), **options)
        assert (a.status == Status.SOLVER_FAILED).sum() == 0


@pytest.mark.slow
def test_with_more_joints_no_local_search_improves_the_answer():
    K_x, T = made(LEG, FOOT, Q3, 6, seed=1)
    K_x[3:] *= 1.5
    a = allocate(Q3, K_x, T, joint=LEG, stiffness=Stiffness(endpoint=FOOT, force=FORCE))
    settled = a.kkt_residual < 1e-9
    assert settled.sum() >= 5
    bounds = np.stack(LEG.pressure_box(Q3), axis=-1) / BAR
    searched = 0
    for i in np.flatnonzero(settled):
        torque = {"type": "eq", "fun": lambda bar, i=i: LEG.torque(Q3, bar * BAR) - a.T[i]}

        def error(bar, i=i):
            return size(FOOT.stiffness(Q3, LEG.stiffness(Q3, bar * BAR), FORCE) - K_x[i], K_x[i]) ** 2

        start = np.clip(a.P[i] / BAR + 1e-3 * np.sin(np.arange(7)), *bounds.T)
        found = minimize(error, start, method="SLSQP", bounds=bounds, constraints=[torque], options={"ftol": 1e-14})
        if np.abs(torque["fun"](found.x)).max() < 1e-9:  # else the search has found nothing
            searched += 1
            assert a.endpoint_error[i] ** 2 <= found.fun + 1e-7
    assert searched >= 4


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"K": np.eye(3)}, r"K has the shape \(3, 3\); expected matrices \(…, 2, 2\).*N/m.* dim = 2 .* n = 2"),
        ({"K": [[300.0, 10.0], [20.0, 300.0]]}, "K is not symmetric.*N/m"),
        ({"K": [[300.0, 400.0], [400.0, 300.0]]}, "eigenvalue -100 N/m"),
        ({"K": -300.0}, r"K\[0\] = -300 N/m has to be positive"),
        (
            {"stiffness": Stiffness(endpoint=HAND, force=[1.0, 2.0, 3.0])},
            r"force has the shape \(3,\); expected \(…, 2\)",
        ),
        ({"stiffness": Stiffness(endpoint=HAND, force=5.0)}, r"force has the shape \(\); expected \(…, 2\)"),
        ({"theta": [0.3, 0.0]}, "Jacobian is singular"),
        ({"stiffness": Stiffness(endpoint=FOOT)}, "the endpoint has n = 3 joints, the mechanism n = 2"),
        ({"stiffness": Stiffness(endpoint=[0.3, 0.3])}, "endpoint is a list; expected an Endpoint"),
        ({"stiffness": Stiffness(endpoint=None, force=[1.0, 0.0])}, "force is that of an endpoint; give endpoint, too"),
        ({"weights": (1.0, np.eye(3))}, r"w_K \(2, 2\)"),
    ],
)
def test_wrong_arguments(changed, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        allocate(joint=ARM, **{"theta": Q, "K": 300.0, "stiffness": Stiffness(endpoint=HAND)} | changed)


def test_only_an_answer_for_an_endpoint_has_its_stiffness():
    with pytest.raises(InvalidInput, match="no endpoint was given"):
        _ = allocate(Q, 9.0, joint=ARM).K_x


def test_several_forces_at_one_posture_are_answered_as_one_after_the_other():
    forces, K = np.array([[5.0, 0.0], [0.0, 5.0], [-3.0, 4.0]]), [[290.0, 290.0], [290.0, 380.0]]
    together = allocate(Q, K, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=forces))
    for force, P in zip(forces, together.P, strict=True):
        alone = allocate(Q, K, joint=ARM, stiffness=Stiffness(endpoint=HAND, force=force))
        np.testing.assert_allclose(P, alone.P, rtol=1e-6)
