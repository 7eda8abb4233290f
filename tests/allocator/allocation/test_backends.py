"""Every back-end agrees with the exact answer, certifies it, and never claims more than it found."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allocator import AntagonistError, Limits, Method, MissingBackend, Status, Stiffness, allocate, report_joint
from allocator.allocation.optimisers import backends
from allocator.muscles import PolynomialMcKibben
from allocator.units import BAR

BACKENDS = {
    "qp-daqp": {"method": "qp"},
    "qp-osqp": {"method": Method("qp", solver="osqp")},
    "nlp-ipopt": {"method": "nlp"},
    "nlp-sqpmethod": {"method": Method("nlp", solver="sqpmethod")},
    "convex-clarabel": {"method": "convex"},
}
PRIORITIES = ("torque", "stiffness", "weighted")
SPAN = 5 * BAR


def options(priority):
    return {"priority": priority, "weights": (2.0, 5.0) if priority == "weighted" else None}


def targets(joint, n, seed):
    """Feasible, on the edge, infeasible, slack, beyond the joint range: the image of a box wider than the real one."""
    rng = np.random.default_rng(seed)
    left, right = joint.angle_range
    theta = rng.uniform(left - 0.1, right + 0.1, n)
    reached = np.clip(theta, left, right)
    P1, P2 = rng.uniform(-1 * BAR, 7 * BAR, (2, n))
    P1[: n // 5] = rng.choice([0.0, 5 * BAR], n // 5)  # on the edge
    sides = joint.sides(reached)
    T = sides[0].torque(P1) + sides[1].torque(P2)
    K = sides[0].stiffness(P1) + sides[1].stiffness(P2)
    return theta, np.maximum(K, 0.5), T


@pytest.fixture
def priority(joint, joints, backend):
    """A priority in turn: each joint has all, with five back-ends, and each back-end has each on three joints."""
    return PRIORITIES[([*joints.values()].index(joint) + [*BACKENDS.values()].index(backend)) % len(PRIORITIES)]


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS.keys())
def test_a_back_end_agrees_with_the_exact_answer(joint, backend, priority):
    """28 targets on each of nine joints, half of them with a slew limit."""
    for seed, slew in ((1, {}), (2, {"limits": Limits(previous=(2.2 * BAR, 2.0 * BAR), max_step=0.4 * BAR)})):
        problem = targets(joint, 14, seed)
        exact = allocate(*problem, joint=joint, **options(priority), **slew)
        found = allocate(*problem, joint=joint, **options(priority), **slew, **backend)
        proved = (exact.pairs == 1) & (found.gap < 1e-6)
        distance = np.maximum(np.abs(found.P1 - exact.P1), np.abs(found.P2 - exact.P2))[proved]
        assert distance.max(initial=0) <= 1e-4 * SPAN
        assert (found.kkt_residual[found.status != Status.SOLVER_FAILED] <= backends.CERTIFIED).all()
        failed = found.status == Status.SOLVER_FAILED
        assert failed.mean() < 0.15  # an optimiser may fail, and then says so; it must not be the rule
        same = (found.status == exact.status) | failed
        assert same[proved].mean() > 0.9  # statuses differ only for targets a rounding away from an edge
        assert np.isfinite([found.P1, found.P2, found.T, found.K]).all()


def cost(a, priority):
    if priority == "weighted":
        return 2 * a.T_error**2 + 5 * a.K_error**2, 0.0 * a.T_error
    pair = np.abs(a.T_error), np.abs(a.K_error)
    return pair if priority == "torque" else pair[::-1]


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS.keys())
def test_no_back_end_beats_the_exact_answer(joint, backend, priority):
    problem = targets(joint, 20, seed=3)
    exact, found = (allocate(*problem, joint=joint, **options(priority), **b) for b in ({}, backend))
    (first, second), (first_found, second_found) = cost(exact, priority), cost(found, priority)
    scale = np.maximum(1.0, first)
    assert (first_found >= first - 1e-6 * scale).all()
    tied = np.abs(first_found - first) < 1e-9
    assert (second_found >= second - 1e-4)[tied].all()


@pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS.keys())
def test_infeasible_feasible_infeasible_leaves_no_trace(backend):
    hard, easy = (0.2, 30.0, 50.0), (0.2, 7.5, 1.0)
    answers = [allocate(*target, **backend) for target in (hard, easy, hard, easy)]
    assert [a.status for a in answers] == [Status.BOTH_LIMITED, Status.EXACT] * 2
    assert (answers[0].P1, answers[0].P2) == (answers[2].P1, answers[2].P2)
    assert (answers[1].P1, answers[1].P2) == (answers[3].P1, answers[3].P2)


def test_the_weighted_start_avoids_the_local_minima_of_the_edges():
    """From the projected inverse alone every optimiser stays in the corner (5, 5) bar, where the cost is higher."""
    target = (1.8120771520117245, 13.27977655428117, -23.510875563713284)
    exact = allocate(*target, **options("weighted"))
    for backend in BACKENDS.values():
        found = allocate(*target, **options("weighted"), **backend)
        assert (found.P1, found.P2) == pytest.approx((exact.P1, exact.P2), abs=1e-4 * SPAN)
        assert found.gap <= 1e-6


def test_a_wrong_answer_is_replaced_and_said(monkeypatch):
    """A back-end that claims success with nonsense, or NaN, is not believed."""
    lies = backends.Answer(np.array([1 * BAR, np.nan]), np.array([4 * BAR, np.nan]), np.array([1, 1], np.int32))
    monkeypatch.setattr(backends, "_run", lambda *_: lies)
    a = allocate([0.3, 0.3], 7.5, 1.0, method="qp")
    exact = allocate(0.3, 7.5, 1.0)
    assert (a.status == Status.SOLVER_FAILED).all()
    assert not a.success.any()
    assert a.P1 == pytest.approx([exact.P1] * 2)
    assert a.T_error == pytest.approx([0, 0], abs=1e-9)


@pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS.keys())
def test_without_the_warm_start_the_answer_is_the_same_but_dearer(backend):
    theta, K, T = np.full(5, 0.3), np.linspace(6.8, 8.8, 5), np.linspace(-3, 3, 5)
    warm, cold = (
        allocate(theta, K, T, method=Method.of(backend["method"])._replace(warm_start=w)) for w in (True, False)
    )
    assert np.abs(warm.P1 - cold.P1).max() <= 1e-4 * SPAN
    assert warm.iterations.sum() < cold.iterations.sum()


EXTRAS = {
    "max_force": {"limits": Limits(max_force=350.0)},
    "min_force": {"limits": Limits(min_force=60.0)},
    "co-contraction": {"limits": Limits(min_cocontraction=3 * BAR)},
    "co-contraction and slew": {
        "limits": Limits(min_cocontraction=2.6 * BAR, previous=(2.4 * BAR, 2.4 * BAR), max_step=0.5 * BAR)
    },
    "tolerance": {"stiffness": Stiffness(tolerance=0.4)},
}


SOLVERS = BACKENDS["qp-daqp"], BACKENDS["nlp-ipopt"], BACKENDS["convex-clarabel"]


def in_turn(number):
    """A solver, further limits and a priority, so that 15 numbers in a row have all pairs of solver and limits."""
    extra = [*EXTRAS.values()][number % len(EXTRAS)]
    priority = "torque" if "stiffness" in extra else PRIORITIES[number // 2 % 3]
    return SOLVERS[number % 3], extra, priority


@pytest.mark.slow
@pytest.mark.parametrize("number", range(15))
def test_with_more_limits_they_still_agree(joint, number):
    backend, extra, priority = in_turn(number)
    problem = targets(joint, 12, seed=4)
    exact = allocate(*problem, joint=joint, **options(priority), **extra)
    found = allocate(*problem, joint=joint, **options(priority), **extra, **backend)
    proved = (exact.pairs == 1) & ~(found.gap > 1e-6)
    distance = np.maximum(np.abs(found.P1 - exact.P1), np.abs(found.P2 - exact.P2))[proved]
    assert distance.max(initial=0) <= 1e-4 * SPAN
    limits = extra.get("limits", Limits())
    if limits.min_cocontraction:
        reached = exact.status != Status.CONFLICT
        assert (exact.P1 + exact.P2 >= 2 * limits.min_cocontraction - 1e-6)[reached].all()
    if limits.max_force:
        assert np.max(exact.forces) <= 350 * (1 + 1e-9)


@pytest.mark.parametrize("priority", ["torque", "weighted"])
@pytest.mark.parametrize("extra", [{}, {"limits": Limits(min_cocontraction=3 * BAR)}], ids=["box", "floor"])
def test_with_a_pull_the_closed_form_is_the_optimisers_answer(joint, priority, extra):
    problem = targets(joint, 15, seed=5)
    pull = {"pull": (2e-11, (2.5 * BAR, 2.0 * BAR)), **options(priority), **extra}
    found = allocate(*problem, joint=joint, **pull, method="qp")
    if not joint.affine:
        with pytest.raises(AntagonistError, match="no closed form for a pull"):
            allocate(*problem, joint=joint, **pull)
        other = allocate(*problem, joint=joint, **pull, method="nlp")
    else:
        other = allocate(*problem, joint=joint, **pull)
    distance = np.maximum(np.abs(found.P1 - other.P1), np.abs(found.P2 - other.P2))[~(found.gap > 1e-6)]
    assert distance.max(initial=0) <= 1e-4 * SPAN
    assert (found.status != Status.SOLVER_FAILED).mean() > 0.9
    assert (found.status == Status.PULLED).any()


@given(share=st.floats(0, 1), tolerance=st.floats(0.01, 1.0))
def test_the_tolerance_is_spent_on_less_pressure(joint, share, tolerance):
    left, right = joint.angle_range
    theta, T = left + share * (right - left), 0.0
    K = np.mean(allocate(theta, 5.0, T, joint=joint).stiffness_interval)
    if K <= tolerance or not np.isfinite(K):
        return
    strict, loose = (allocate(theta, K, T, joint=joint, stiffness=Stiffness(tolerance=t)) for t in (0.0, tolerance))
    if strict.success and strict.pairs == 1:
        assert loose.success
        assert loose.T_error == pytest.approx(0, abs=1e-6)
        assert loose.P1 + loose.P2 < strict.P1 + strict.P2
        assert abs(loose.K_error) <= tolerance * (1 + 1e-6)


def test_limits_that_cannot_be_kept_together_are_reported():
    a = allocate(0.0, 7.5, limits=Limits(min_cocontraction=4 * BAR, previous=(2 * BAR, 2 * BAR), max_step=0.5 * BAR))
    assert a.status is Status.CONFLICT
    assert (a.P1, a.P2) == (2.5 * BAR, 2.5 * BAR)
    assert "co-contraction floor" in a.active


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"method": Method("qp", solver="magic")}, "unknown QP solver 'magic'; available: "),
        ({"method": Method("nlp", solver="daqp")}, "unknown NLP solver 'daqp'; available: ipopt, sqpmethod"),
        ({"method": Method("convex", solver="scip")}, "unknown convex solver 'scip'; available: clarabel, osqp"),
        ({"method": Method(solver="daqp")}, "solver = 'daqp' belongs to the methods convex, nlp, qp, not 'exact'"),
        ({"limits": Limits(min_force=300, max_force=200)}, "max_force = 200 N contradicts min_force = 300 N"),
        (
            {"limits": Limits(min_cocontraction=6 * BAR)},
            "min_cocontraction = 600000 Pa contradicts the supply pressure of 500000 Pa",
        ),
        ({"limits": Limits(min_cocontraction=2)}, "if bar was meant"),
        ({"pull": 1e-11}, "pull = 1e-11 has to be (ρ, P_ref)"),
        ({"pull": (-1.0, (2e5, 2e5))}, "pull[0] = -1.0"),
        (
            {"stiffness": Stiffness(tolerance=0.2), "priority": "stiffness"},
            "a stiffness tolerance holds for priority='torque' only",
        ),
    ],
)
def test_wrong_arguments_are_named(arguments, said):
    with pytest.raises(AntagonistError, match=re.escape(said)):
        allocate(0.3, 7.5, 1.0, **arguments)


@pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS.keys())
@pytest.mark.parametrize("priority", PRIORITIES)
def test_a_stiffness_that_no_pressure_changes_is_missed_and_the_torque_met(backend, priority):
    """The counter-force of `PolynomialMcKibben` does not see the pressure: the stiffness has no gradient at all."""
    joint = report_joint(PolynomialMcKibben(0.00975, 0.4485, (2.0e7, -6.8e7, 2.63e8)))  # fitted to measured forces
    K = joint.stiffness(0.1, 2 * BAR, 2 * BAR)
    a = allocate(0.1, 1.2 * K, 0.5, joint=joint, **backend, **options(priority))
    assert a.T == pytest.approx(0.5, abs=1e-6)
    assert a.K == pytest.approx(K, rel=1e-9)
    assert a.status in (Status.STIFFNESS_LIMITED, Status.SOLVER_FAILED)


def test_a_back_end_that_is_not_installed_is_a_missing_backend():
    with pytest.raises(MissingBackend, match="daqp"):
        allocate(0.3, 7.5, 1.0, method=Method("qp", solver="gurobi"))
