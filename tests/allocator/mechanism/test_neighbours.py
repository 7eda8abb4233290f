"""Targets that share their binding limits, solved together, against a solver of QPs and against the kernel."""

import numpy as np
import pytest

from allocator import allocate
from allocator.allocation.box import pivoting
from allocator.allocation.box.arguments import problem_from
from allocator.joint.limits import Limits
from allocator.mechanism import machines
from allocator.units import BAR

MACHINES = {"arm26": machines.arm26(), "arm48": machines.arm48()}
N = 40


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """No compiled loops, whatever other tests have compiled."""
    monkeypatch.setattr(pivoting, "_ready", [])


def drifting(mechanism, seed):
    """Postures (N, n), stiffness and torques of pressures near a limit, which binds in some of them."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.3, 0.3, mechanism.n) + np.cumsum(rng.normal(0, 0.01, (N, mechanism.n)), axis=0)
    lo, hi = mechanism.pressure_box(q)
    share = rng.uniform(0.05, 0.3, mechanism.m) + np.cumsum(rng.normal(0, 0.005, (N, mechanism.m)), axis=0)
    share[N // 2 :, 0] = 0.0
    P = lo + np.clip(share, 0, 1) * (hi - lo)
    return q, mechanism.stiffness(q, P), mechanism.torque(q, P)


@pytest.mark.parametrize("mechanism", MACHINES.values(), ids=MACHINES.keys())
@pytest.mark.parametrize("seed", range(4))
def test_a_trajectory_in_plain_python_has_the_pressures_of_a_qp_solver(mechanism, seed):
    q, K, T = drifting(mechanism, seed)
    found, wanted = allocate(q, K, T, joint=mechanism, along=0), allocate(q, K, T, joint=mechanism, method="qp")
    np.testing.assert_array_equal(found.status, wanted.status)
    np.testing.assert_allclose(found.P, wanted.P, atol=1e-6 * BAR)
    assert found.kkt_residual.max() < 1e-9


def test_right_sides_are_proved_and_whatever_is_proved_is_the_kernel_s_answer():
    mechanism, proved = MACHINES["arm26"], 0
    for seed in range(20):
        q, K, T = drifting(mechanism, seed)
        nearest = np.full(mechanism.m, BAR) * (np.arange(mechanism.m) > 0)  # draws the first muscle to its lower limit
        problem, _ = problem_from(mechanism, q, K, T, limits=Limits(previous=nearest))
        (kernel_s, sides), m = pivoting._pivoted(problem, slice(N), False), mechanism.m
        met = np.abs((problem.A @ kernel_s.x[:, :, None])[:, :, 0] - problem.b).max(axis=1) < 1e-12
        for side in np.unique(sides[:, :m], axis=0):
            given = pivoting.by_sides(problem.A, problem.b, *problem.x_bounds, side)
            right = (sides[:, :m] == side).all(axis=1) & met & ((side == 0).sum() >= problem.b.shape[1])
            assert given.proved[right].all()
            np.testing.assert_allclose(given.x[given.proved], kernel_s.x[given.proved], atol=1e-9)
            np.testing.assert_allclose(given.mu[right], kernel_s.mu[right, -1], atol=1e-7)
            proved += given.proved.sum() * bool(side.any())
    assert proved > 20  # with binding limits


def test_rows_that_depend_on_each_other_or_cannot_be_met_are_left_to_the_kernel():
    mechanism = MACHINES["arm26"]
    q, K, T = drifting(mechanism, 0)
    problem, _ = problem_from(mechanism, q, 3 * K, T)
    A, b, box, free = problem.A, problem.b, problem.x_bounds, np.zeros(mechanism.m, np.int8)
    assert not pivoting.by_sides(A, b, *box, free).proved.any()
    assert not pivoting.by_sides(A[:, [0, 0, 1]], b[:, [0, 0, 1]], *box, free).proved.any()
    assert not pivoting.by_sides(A, b, *box, free - 1).proved.any()


@pytest.mark.parametrize("along", [None, 0])
@pytest.mark.parametrize("pulled", [{}, {"priority": "weighted", "weights": (1, 1), "pull": (1e-12, np.full(6, BAR))}])
def test_no_targets_have_no_answers(along, pulled):
    none = np.zeros((0, 2))
    found = allocate(none, none, joint=MACHINES["arm26"], along=along, **pulled)
    assert (found.P.shape, found.status.shape) == ((0, 6), (0,))
