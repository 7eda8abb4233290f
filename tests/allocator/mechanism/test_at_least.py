"""At least a stiffness: the least pressures, and proofs of what cannot be had, checked without the library's solver."""

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from allocator import InvalidInput, Limits, Status, Stiffness
from allocator.allocation import allocate_at_least
from allocator.mechanism import Endpoint, machines
from allocator.units import BAR

ARM, HAND, Q = machines.arm26(), Endpoint.planar([0.3, 0.25]), np.array([0.4, 0.9])
LEG, FOOT, Q3 = machines.leg37(), Endpoint.planar([0.3, 0.3, 0.1]), np.array([0.5, -0.4, 0.3])
FORCE = np.array([3.0, -5.0])


def targets(mechanism, q, N, seed=0):
    """Return N torques and stiffnesses that pressures give, the stiffnesses turned a little away from these."""
    rng = np.random.default_rng(seed)
    P = rng.uniform(*mechanism.pressure_box(q), (N, mechanism.m))
    skew = np.eye(mechanism.n) + 0.1 * rng.uniform(-1, 1, (N, mechanism.n, mechanism.n))
    return mechanism.torque(q, P), skew @ mechanism.stiffness(q, P) @ skew.swapaxes(-1, -2)


def greatest_share(mechanism, q, T, floor, base):
    """Return the greatest s for which pressures give T and K ⪰ base + s floor: linear programmes with cutting planes.

    Of the reachable set, an affine image of a box, every direction v gives the half-space vᵀ(K - base - s floor)v ≥ 0.
    """
    lo, hi = (bound / BAR for bound in mechanism.pressure_box(q))
    zero = mechanism.torque(q, 0 * lo), mechanism.stiffness(q, 0 * lo)
    steps = [(mechanism.torque(q, e) - zero[0], mechanism.stiffness(q, e) - zero[1]) for e in BAR * np.eye(len(lo))]
    A = np.array([torque for torque, _ in steps]).T
    cuts = list(np.eye(mechanism.n))
    for _ in range(60):
        rows = [[-v @ K @ v for _, K in steps] + [v @ floor @ v] for v in cuts]
        right = [v @ (zero[1] - base) @ v for v in cuts]
        found = linprog(
            np.append(np.zeros(len(lo)), -1.0),
            A_ub=rows,
            b_ub=right,
            A_eq=np.column_stack([A, np.zeros(len(A))]),
            b_eq=T - zero[0],
            bounds=[*zip(lo, hi, strict=True), (-100, 100)],
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        K, s = zero[1] + np.tensordot(found.x[:-1], [K for _, K in steps], 1), found.x[-1]
        values, vectors = np.linalg.eigh(K - base - s * floor)
        if values[0] > -1e-7:
            return s
        cuts.append(vectors[:, 0])
    raise AssertionError("the cutting planes do not end")


def verified(a, q, T, floors):
    """Check a proof with nothing but the mechanism's map: its box never has what is asked for."""
    (y0, M), (lo, hi) = a.mechanism.targets_map(q), a.box
    proof, n = a.certificate, a.mechanism.n
    d = np.concatenate([proof.torque, (sum(proof.matrices) * (2 - np.eye(n)))[np.triu_indices(n)]])
    assert d == pytest.approx(proof.direction, abs=1e-12)
    assert min(np.linalg.eigvalsh(Z)[0] for Z in proof.matrices) > -1e-12
    reach = d @ y0 + np.maximum(d @ M * lo, d @ M * hi).sum()
    asked = proof.torque @ T + sum((Z * B).sum() for Z, B in zip(proof.matrices, floors, strict=True))
    assert (reach, asked) == pytest.approx((proof.reach, proof.asked), rel=1e-9)
    return reach < asked - 1e-12


@pytest.mark.parametrize("i", range(6))
def test_feasible_and_infeasible_are_told_apart_at_the_edge(i):
    T, K = (x[i] for x in targets(ARM, Q, 6))
    share = greatest_share(ARM, Q, T, K, np.zeros((2, 2)))
    a = allocate_at_least(ARM, Q, (share - 1e-5) * K, T)
    assert a.status == Status.EXACT
    assert np.linalg.eigvalsh(a.K - (share - 1e-5) * K)[0] > -1e-7
    assert a.T == pytest.approx(T, abs=1e-9)
    b = allocate_at_least(ARM, Q, (share + 1e-5) * K, T)
    assert b.status == Status.STIFFNESS_LIMITED
    assert verified(b, Q, T, [(share + 1e-5) * K])
    assert (share + 1e-5) * (1 + b.excess[0]) == pytest.approx(share, rel=1e-6)


@pytest.mark.parametrize(("mechanism", "endpoint", "q"), [(ARM, HAND, Q), (LEG, FOOT, Q3)], ids=["arm", "leg"])
@pytest.mark.parametrize("i", range(3))
def test_an_ellipse_of_the_endpoint_too(mechanism, endpoint, q, i):
    P = np.random.default_rng(i).uniform(*mechanism.pressure_box(q))
    T, K_x = mechanism.torque(q, P), endpoint.stiffness(q, mechanism.stiffness(q, P), FORCE)
    J, load = endpoint.jacobian(q), np.einsum("i,iab->ab", FORCE, endpoint.hessian(q))
    share = greatest_share(mechanism, q, T, J.T @ K_x @ J, -load)
    assert share > 0.99
    asked = {"stiffness": Stiffness(endpoint=endpoint, force=FORCE), "T": T - J.T @ FORCE}
    a = allocate_at_least(mechanism, q, (share - 1e-4) * K_x, **asked)
    assert a.status == Status.EXACT
    assert np.linalg.eigvalsh(a.K_x - (share - 1e-4) * K_x)[0] > -1e-5
    b = allocate_at_least(mechanism, q, (share + 1e-4) * K_x, **asked)
    assert b.status == Status.STIFFNESS_LIMITED
    assert verified(b, q, T, [J.T @ ((share + 1e-4) * K_x) @ J - load])


@pytest.mark.slow
@pytest.mark.parametrize("near", [False, True], ids=["least", "nearest to the previous"])
def test_no_local_search_finds_lower_pressures(near):
    T, K = targets(ARM, Q, 5, seed=3)
    bounds = np.stack(ARM.pressure_box(Q), axis=-1) / BAR
    previous = np.array([2.0, 3, 2, 4, 3, 1]) * BAR if near else None
    centre = previous / BAR if near else np.zeros(6)
    searched = 0
    for i in range(5):
        a = allocate_at_least(ARM, Q, 0.8 * K[i], T[i], limits=Limits(previous=previous))
        if not a.success:
            continue
        rules = [
            {"type": "eq", "fun": lambda bar, i=i: ARM.torque(Q, bar * BAR) - T[i]},
            {"type": "ineq", "fun": lambda bar, i=i: np.linalg.det(ARM.stiffness(Q, bar * BAR) - 0.8 * K[i])},
            {"type": "ineq", "fun": lambda bar, i=i: np.trace(ARM.stiffness(Q, bar * BAR) - 0.8 * K[i])},
        ]
        start = np.clip(a.P / BAR + 0.1 * np.sin(np.arange(6)), *bounds.T)
        found = minimize(
            lambda bar: ((bar - centre) ** 2).sum(), start, method="SLSQP", bounds=bounds, constraints=rules
        )
        apart = [abs(rules[0]["fun"](found.x)).max(), *(-rule["fun"](found.x) for rule in rules[1:])]
        if max(apart) < 1e-6:  # else the search has found nothing
            searched += 1
            assert ((a.P / BAR - centre) ** 2).sum() <= found.fun + 1e-5
        assert a.gap < 1e-8
    assert searched >= 3


def test_half_of_many_targets_are_had_and_the_rest_disproved():
    T, K = targets(ARM, Q, 24, seed=5)
    outcomes = []
    for i, factor in enumerate(np.linspace(0.5, 1.6, 24)):
        a = allocate_at_least(ARM, Q, factor * K[i], T[i])
        outcomes.append(a.success)
        if a.success:
            assert np.linalg.eigvalsh(a.K - factor * K[i])[0] > -1e-6
        else:
            assert a.status == Status.STIFFNESS_LIMITED
            assert verified(a, Q, T[i], [factor * K[i]])
    assert 5 < sum(outcomes) < 20


def test_a_margin_of_stability_is_kept():
    plain = allocate_at_least(ARM, Q, [3.0, 3.0], [5.0, 0.0])
    assert np.linalg.eigvalsh(plain.K)[0] < 4
    a = allocate_at_least(ARM, Q, 3.0, [5.0, 0.0], margin=4.5)
    assert a.success
    assert np.linalg.eigvalsh(a.K)[0] == pytest.approx(4.5, abs=1e-6)
    assert (a.P**2).sum() > (plain.P**2).sum()
    b = allocate_at_least(ARM, Q, 3.0, [5.0, 0.0], margin=12.0)
    assert verified(b, Q, [5.0, 0.0], [3 * np.eye(2), 12 * np.eye(2)])
    assert "the margin of stability cannot be had" in b.message


def test_torques_beyond_reach_are_disproved_without_stiffness():
    a = allocate_at_least(ARM, Q, 3.0, [100.0, 0.0])
    assert a.status == Status.TORQUE_LIMITED
    assert verified(a, Q, [100.0, 0.0], [3 * np.eye(2)])
    assert not np.any(a.certificate.matrices)


def test_contradicting_limits_keep_their_status():
    assert allocate_at_least(ARM, Q, 3.0, limits=Limits(min_force=3000.0)).status == Status.SLACK
    assert allocate_at_least(ARM, [1.5, 0.0], 3.0).status == Status.OUTSIDE_JOINT_RANGE


def test_beyond_the_joint_range_the_least_pressures_are_those_of_its_end():
    end, beyond = (allocate_at_least(ARM, [q, 0.0], 3.0) for q in (ARM.angle_limits[0][1], 1.5))
    assert end.status == Status.EXACT
    np.testing.assert_allclose(beyond.P, end.P, atol=1e-6)
    assert beyond.status == Status.OUTSIDE_JOINT_RANGE


def test_the_answer_shows_itself():
    a = allocate_at_least(ARM, Q, 300.0, stiffness=Stiffness(endpoint=HAND))
    assert "N/m at the endpoint" in repr(a)
    assert "short by" in repr(a)
    assert a.to_dict()["status"] == "STIFFNESS_LIMITED"
    with pytest.raises(ValueError, match="read-only"):
        a.P[0] = 0.0


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"K": [[10.0, 4.0], [3.0, 9.0]]}, "K is not symmetric"),
        ({"K": np.eye(3)}, r"K has the shape \(3, 3\); expected matrices \(…, 2, 2\).* n = 2 .* m = 6"),
        ({"K": [1.0, 2.0, 3.0]}, r"K has the shape \(3,\)"),
        ({"K": -1.0}, "eigenvalue -1 N·m/rad"),
        ({"theta": np.zeros((3, 2))}, r"one posture and one target at a time, not for \(3,\)"),
        ({"margin": -1.0}, "margin = -1.0 .* not negative"),
        ({"margin": [1.0, 2.0]}, "margin = .* one number"),
        ({"theta": [0.3, 0.0], "stiffness": Stiffness(endpoint=HAND)}, "Jacobian is singular"),
        ({"K": np.eye(3), "stiffness": Stiffness(endpoint=HAND)}, r"\(…, 2, 2\).*N/m.*dim = 2"),
        ({"mechanism": "arm26"}, "mechanism is a str"),
    ],
)
def test_wrong_arguments(changed, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        allocate_at_least(**({"mechanism": ARM, "theta": Q, "K": 3.0} | changed))
