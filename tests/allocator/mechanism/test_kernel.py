"""The kernel by itself: one-sided rows, the QP with a weight on the pressures, and the first guess."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from allocator import allocate
from allocator.allocation.box import kernel
from allocator.allocation.box.kernel.data import workspace
from allocator.errors import InvalidInput
from allocator.mechanism import machines
from allocator.muscles.catalogue import TONDU_DMSP_20_400N

from ...rigs.certificates import unexplained

ARM = machines.arm26()
POSTURE = np.array([0.4, -0.3])


def targets(N, seed=0):
    """Torques and stiffness of taut pressures, half of them twice that much."""
    rng = np.random.default_rng(seed)
    P = rng.uniform(*ARM.pressure_box(POSTURE), (N, 6))
    far = np.where(np.arange(N) % 2, 2.0, 1.0)
    return far[:, None] * ARM.torque(POSTURE, P), far[:, None, None] * ARM.stiffness(POSTURE, P)


def solved(A, b, onesided, ends, lo, hi, centre):
    """x, and the residual of optimality, of N targets with the same rows."""
    (N, p), m, K = b.shape, A.shape[1], len(ends)
    x, mu, rounds, out = np.empty((N, m)), np.empty((N, K + 1, p)), np.zeros(N, np.int64), np.empty(N)
    bounds = [np.broadcast_to(a, (N, m)) for a in (lo, hi, centre)]
    rows = A[None], b, np.array(onesided), np.array(ends), *bounds, np.zeros(N, np.int64)
    work = workspace(p, m, K)
    kernel.allocate_batch(*rows, False, x, np.zeros((N, m + p), np.int8), mu, rounds, work)
    kernel.residual_batch(*rows, x, mu, 0.0, 1e-9, out, np.empty(m + p, bool), work)
    assert (rounds > 0).all()
    return x, out


def test_one_sided_rows_give_the_nearest_point_of_a_polytope():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 6))
    lo, hi = np.zeros(6), np.ones(6)
    b = A @ rng.uniform(0.2, 0.8, 6) + rng.uniform(0, 0.3, (40, 4))  # a point inside there is
    centre = rng.uniform(-1, 2, (40, 6))
    x, left = solved(A, b, [True] * 4, [4], lo, hi, centre)
    assert left.max() < 1e-9
    assert (x @ A.T <= b + 1e-12).all()
    assert ((lo <= x) & (x <= hi)).all()
    for i in range(40):
        assert unexplained(x[i], centre[i] - x[i], lo, hi, A, b[i]) < 1e-9


def test_one_sided_rows_that_contradict_are_missed_by_as_little_as_can_be():
    rng = np.random.default_rng(1)
    row = rng.normal(size=6)
    A = np.stack([row, -row, rng.normal(size=6)])
    lo, hi = np.zeros(6), np.ones(6)
    b = np.array([[0.1, -0.3, 0.4], [0.0, -0.1, 5.0]])  # a x ≤ 0.1 and a x ≥ 0.3
    x, left = solved(A, b, [True] * 3, [3], lo, hi, np.zeros(6))
    assert left.max() < 1e-9
    for i in range(2):
        missed = np.maximum(A @ x[i] - b[i], 0.0)
        assert unexplained(x[i], -A.T @ missed, lo, hi, A[:0], b[i][:0]) < 1e-9  # convex: the least of all
        assert missed.max() > 0


def test_rows_of_both_kinds_go_together():
    """A row asked for from both sides is two of one side, and one that cannot bind is none."""
    rng = np.random.default_rng(2)
    A, lo, hi = rng.normal(size=(2, 5)), np.zeros(5), np.ones(5)
    b, centre = (A @ rng.uniform(0, 1, (5, 30))).T, rng.uniform(-1, 2, (30, 5))
    plain, _ = solved(A, b, [False] * 2, [2], lo, hi, centre)
    twice, left = solved(np.concatenate([A, -A]), np.concatenate([b, -b], axis=1), [True] * 4, [4], lo, hi, centre)
    assert left.max() < 1e-9
    assert twice == pytest.approx(plain, abs=1e-9)
    idle = np.concatenate([b, np.full((30, 1), 1e3)], axis=1)
    never, left = solved(np.concatenate([A, np.ones((1, 5))]), idle, [False, False, True], [2, 3], lo, hi, centre)
    assert left.max() < 1e-9
    assert never == pytest.approx(plain, abs=1e-12)


def test_a_weight_on_the_pressures_is_one_qp():
    T, K = targets(30)
    previous = np.full(6, 2e5)
    asked = {"priority": "weighted", "weights": (1e3, 2.0), "pull": (1e-12, previous)}
    a = allocate(POSTURE, K, T, joint=ARM, **asked)
    assert a.kkt_residual.max() < 1e-9
    y0, M = ARM.targets_map(POSTURE)
    root = np.sqrt([1e3, 1e3, 2, 4, 2])
    A = np.concatenate([root[:, None] * M * 1e5, np.sqrt(1e-12) * 1e5 * np.eye(6)])  # of P in bar
    lo, hi = (end / 1e5 for end in ARM.pressure_box(POSTURE))
    for i, y in enumerate(ARM.stacked(T, K)):
        b = np.concatenate([root * (y - y0), np.sqrt(1e-12) * previous])
        bvls = lsq_linear(A, b, (lo, hi), method="bvls", tol=1e-12)
        ours = np.sum((A @ (a.P[i] / 1e5) - b) ** 2)
        assert ours <= 2 * bvls.cost * (1 + 1e-12)
        assert a.P[i] / 1e5 == pytest.approx(bvls.x, abs=1e-5)
    daqp = allocate(POSTURE, K, T, joint=ARM, method="qp", **asked)
    assert daqp.P == pytest.approx(a.P, abs=1e-8 * 5e5)
    assert daqp.kkt_residual.max() < 1e-9


def test_a_weight_on_the_pressures_that_goes_to_nothing_is_least_pressure():
    T, K = targets(30, seed=1)
    exact = allocate(POSTURE, K, T, joint=ARM, priority="weighted", weights=(1.0, 1.0))
    nearly = allocate(POSTURE, K, T, joint=ARM, priority="weighted", weights=(1.0, 1.0), pull=(1e-19, np.zeros(6)))
    assert nearly.P == pytest.approx(exact.P, abs=1e-5 * 5e5)


def test_a_weight_on_the_pressures_is_refused_for_muscles_that_are_not_affine():
    bent = ARM.with_muscles(TONDU_DMSP_20_400N)
    with pytest.raises(InvalidInput, match="a pull is for affine muscles only"):
        allocate(POSTURE, 8.0, 0.0, joint=bent, priority="weighted", weights=(1.0, 1.0), pull=(1e-12, np.zeros(6)))


@pytest.mark.parametrize(
    ("priority", "weights", "pull", "said"),
    [
        ("weighted", (1.0, 1.0), (0.0, np.zeros(6)), "has to have ρ > 0"),
        ("weighted", (1.0, 1.0), (1.0, np.zeros(5)), r"pull\[1\] has the shape \(5,\)"),
        ("torque", (1.0, 1.0), (1.0, np.zeros(6)), "belongs to priority='weighted'"),
        ("weighted", (1.0, 1.0, 1.0), None, "two, "),
        ("weighted", (1.0,), None, "two, "),
    ],
)
def test_weights_that_make_no_sense_are_refused(priority, weights, pull, said):
    T, K = targets(1)
    with pytest.raises(InvalidInput, match=said):
        allocate(POSTURE, K, T, joint=ARM, priority=priority, weights=weights, pull=pull)
