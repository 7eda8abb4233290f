"""The QP solvers agree with one another, and a wrong answer is recognised whoever gives it."""

import numpy as np
import pytest
import qpsolvers

from allocator import MissingBackend
from mpc import PlanStatus, Rung, TrackingMPC
from mpc.model.plant import Plant
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver

from ...rigs.certificates import unexplained

SOLVERS = ["daqp", *sorted(set(qpsolvers.available_solvers) - {"daqp"})]


def random_qp(seed, n=12, m=8):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(2 * n, n))
    one_sided = np.where(rng.random(m) < 0.3, np.inf, 0.3)
    return QP(
        M.T @ M, 30 * rng.normal(size=n), np.full(n, -0.4), np.append(np.full(n - 1, 0.4), np.inf),
        rng.normal(size=(m, n)), -0.3 - rng.random(m), one_sided,
    )  # fmt: skip


def mpc_qp():
    """The QP of a real step in which slew and joint range bind."""
    plant = Plant(gas=False)
    controller, seen = TrackingMPC(plant), []
    solve = controller._solve
    controller._solve = lambda qp, limit: (seen.append(qp), solve(qp, limit))[1]
    controller.step(plant.at_rest(2.1, 7.6) + np.array([0, 1.5, 0, 0]), 2.1, 7.6)
    return seen[-1]  # the last try, with the rows that bind


@pytest.fixture(
    scope="module",
    params=[1, 2, 3, pytest.param(None, marks=pytest.mark.compiles)],
    ids=["random 1", "random 2", "random 3", "mpc"],
)
def qp(request):
    return random_qp(request.param) if request.param else mpc_qp()


def test_limits_bind_in_the_problems_that_follow(qp):
    _, multipliers = solver("daqp")(qp)
    n = qp.f.size
    assert np.any(multipliers[:n])
    assert np.any(multipliers[n:])


def test_daqp_meets_the_optimality_conditions(qp):
    z, multipliers = solver("daqp")(qp)
    assert qp.certify(z, multipliers).within(1e-6, 1e-8 * abs(qp.cost(z)))


@pytest.mark.parametrize("name", [n for n in SOLVERS if n != "daqp"])
def test_every_solver_gives_the_right_answer_or_is_refused(name, qp):
    z, _ = solver("daqp")(qp)
    found = solver(name)(qp)
    accepted = found is not None and qp.certify(*found).within(1e-4, 1e-3 * abs(qp.cost(z)))
    if accepted:
        assert qp.cost(found[0]) == pytest.approx(qp.cost(z), rel=2e-3)
    if name in ("osqp", "clarabel"):
        assert accepted
        np.testing.assert_allclose(found[0], z, atol=5e-3 * np.abs(z).max())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_multipliers_that_scipy_finds_prove_the_point(seed):
    qp = random_qp(seed)
    z, _ = solver("daqp")(qp)
    assert qp.violation(z) < 1e-9
    two_sided = np.isfinite(qp.rows_upper)
    A = np.concatenate([qp.R[two_sided], -qp.R])
    b = np.concatenate([qp.rows_upper[two_sided], -qp.rows_lower])
    gradient = qp.H @ z + qp.f
    assert unexplained(z, -gradient, qp.lower, qp.upper, A, b) < 1e-6 * np.linalg.norm(gradient)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda z, m: (z * 1.08, m),
        lambda z, m: (z + 0.01, m),
        lambda z, m: (0 * z, m),
        lambda z, m: (z, 0 * m),
        lambda z, m: (z, -m),
        lambda z, m: (np.full_like(z, np.nan), m),
        lambda z, m: (z, np.full_like(m, np.nan)),
    ],
    ids=["8 % off", "shifted", "zero", "no multipliers", "wrong signs", "nan", "nan multipliers"],
)
def test_a_spoilt_answer_is_refused(qp, spoil):
    z, multipliers = solver("daqp")(qp)
    assert not qp.certify(*spoil(z, multipliers)).within(1e-4, 1e-3 * abs(qp.cost(z)))


def test_an_unknown_solver_is_answered_with_those_there_are():
    with pytest.raises(MissingBackend, match=r"unknown QP solver 'magic'; available: .*daqp.*osqp"):
        TrackingMPC(Plant(), solver="magic")


@pytest.mark.parametrize("seed", range(5))
def test_the_gap_is_never_less_than_what_a_point_costs_too_much(seed):
    qp, rng = random_qp(1), np.random.default_rng(seed)
    best, multipliers = solver("daqp")(qp)
    inside = best + rng.random() * (rng.uniform(-0.05, 0.05, best.size) - best)  # a feasible point nearby
    assert qp.violation(inside) == 0
    excess = qp.cost(inside) - qp.cost(best)
    assert excess > 0
    assert qp.certify(inside, multipliers).gap == pytest.approx(excess, rel=1e-9)
    assert qp.certify(inside, multipliers * rng.random(multipliers.size)).gap >= excess


# --- solvers that fail ------------------------------------------------------------------------------------------------


def raising(fault):
    def solve(qp, limit):
        raise fault

    return solve


FAULTS = {
    "an exception": raising(ArithmeticError("singular")),
    "no memory": raising(MemoryError()),
    "no numbers": lambda qp, limit: (np.full(qp.f.size, np.nan), np.zeros(qp.f.size + len(qp.R))),
    "infinite multipliers": lambda qp, limit: (np.zeros(qp.f.size), np.full(qp.f.size + len(qp.R), np.inf)),
    "too few": lambda qp, limit: (np.zeros(1), np.zeros(1)),
    "no multipliers": lambda qp, limit: (np.zeros(qp.f.size), None),
    "a matrix": lambda qp, limit: (np.zeros((qp.f.size, 1)), np.zeros(qp.f.size + len(qp.R))),
    "words": lambda qp, limit: ("solved", "optimal"),
    "a point alone": lambda qp, limit: np.zeros(qp.f.size),
    "nothing": lambda qp, limit: None,
}


@pytest.mark.compiles
@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_a_solver_that_fails_is_unsolved_and_the_next_rung_answers(fault):
    plant = Plant()
    controller, rest = TrackingMPC(plant, N=5, solver=fault), plant.at_rest(0.0, 7.6)
    for _ in range(3):
        plan = controller.step(rest, 0.3, 7.6)
        assert plan.status is PlanStatus.UNSOLVED
        assert plan.rung is not Rung.QP
        assert np.isfinite(plan.u).all()


@pytest.mark.compiles
@pytest.mark.parametrize("name", [n for n in SOLVERS if n != "daqp"])
def test_whatever_comes_out_of_qpsolvers_is_unsolved(name, monkeypatch):
    controller, rest = TrackingMPC(Plant(), N=5, solver=name), Plant().at_rest(0.0, 7.6)
    assert controller.step(rest, 0.0, 7.6).rung is Rung.QP
    monkeypatch.setattr(qpsolvers, "solve_problem", raising_anything)
    plan = controller.step(rest, 0.3, 7.6)
    assert (plan.status, plan.rung) == (PlanStatus.UNSOLVED, Rung.SOFTENED)


def raising_anything(*args, **settings):
    raise TypeError("no such setting")


@pytest.mark.compiles
@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_who_wants_to_stop_is_not_held_up_by_a_solver(stop):
    with pytest.raises(stop):
        TrackingMPC(Plant(), N=5, solver=raising(stop()))  # which tries a step


@pytest.mark.parametrize("rounding", [-1e-17, 0.0], ids=["indefinite by rounding", "singular"])
def test_a_cost_that_is_not_definite_proves_nothing(rounding):
    """Along (1, -1) the cost falls for ever: no gap bounds it, however small the number that a solution of H gives."""
    H = np.array([[1.0, 1.0], [1.0, 1.0 + rounding]])
    free = np.full(2, 1e6)
    qp = QP(H, np.array([1.0, -1.0]), -free, free, np.empty((0, 2)), np.empty(0), np.empty(0))
    assert not qp.certify(np.zeros(2), np.zeros(2)).within(1e-6, 1e3)
