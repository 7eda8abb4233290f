"""Solvers are values with their options; names and dicts stand for them; wrong options are named in one sentence."""

from copy import deepcopy
from dataclasses import FrozenInstanceError, replace
from pickle import dumps, loads

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput, MissingBackend
from mpc import NonlinearMPC, PlanStatus, Plant, TrackingMPC
from mpc.solvers import DAQP, IPOPT, OSQP, SCS, Clarabel, Fatrop, Riccati
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Installed, solver

PLANT, REST = Plant(), Plant().at_rest(0.0, 7.6)
TIGHT = {"name": "osqp", "eps_abs": 1e-9}


@pytest.mark.compiles
@pytest.mark.parametrize(
    "given",
    ["riccati", Riccati(), "osqp", OSQP(), {"name": "osqp"}, TIGHT, OSQP(eps_abs=1e-9), DAQP(iter_limit=500), {}],
)
def test_a_name_a_dict_and_a_value_come_to_the_same_plan(given):
    wanted, got = (TrackingMPC(PLANT, N=6, solver=s).step(REST, 20 * DEG, 7.6) for s in ("daqp", given))
    assert got.status is PlanStatus.OPTIMAL
    np.testing.assert_allclose(got.u, wanted.u, atol=2e-3 * BAR)


@pytest.mark.parametrize(
    "given", ["ipopt", IPOPT(), {"name": "ipopt", "max_iter": 100}, Fatrop(max_iter=100), {"tol": 1e-8}]
)
def test_so_they_do_of_the_nonlinear_mpc(given):
    wanted, got = (NonlinearMPC(PLANT, N=5, solver=s).step(REST, 2 * DEG, 7.6) for s in ("ipopt", given))
    assert got.status is PlanStatus.OPTIMAL
    np.testing.assert_allclose(got.u, wanted.u, atol=1e-3 * BAR)


@pytest.mark.compiles
def test_options_reach_the_solver():
    assert solver(DAQP(iter_limit=1)).given == solver({"iter_limit": 1}).given == {"iter_limit": 1}
    seen = TrackingMPC(PLANT, N=5).qp(REST, 20 * DEG, 7.6)
    arrays = seen.H, seen.f, seen.lower, seen.upper, seen.rows, seen.rows_lower, seen.rows_upper
    qp = QP(*map(np.copy, arrays))
    assert DAQP()(qp) is not None
    assert DAQP(iter_limit=1)(qp) is None
    exact, rough = (solver(OSQP(max_iter=most, polishing=False))(qp) for most in (50_000, 25))
    assert qp.certify(*exact).gap < qp.certify(*rough).gap
    assert NonlinearMPC(PLANT, N=5, solver=IPOPT(max_iter=1)).step(REST, 20 * DEG, 7.6).status is PlanStatus.UNSOLVED


@pytest.mark.compiles
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: DAQP(tolerance=1.0), "DAQP has no option 'tolerance'; its options are primal_tol, dual_tol"),
        (lambda: TrackingMPC(PLANT, solver={"eps": 1.0}), "DAQP has no option 'eps'; its options are primal_tol"),
        (lambda: TrackingMPC(PLANT, solver={"name": "clarabel", "eps": 1.0}), "Clarabel has no option 'eps'; its"),
        (lambda: NonlinearMPC(PLANT, solver={"eps": 1.0}), "IPOPT has no option 'eps'; its options are tol, max_iter"),
        (lambda: Fatrop(tol=1.0), "Fatrop has no option 'tol'; its options are tolerance"),
    ],
)
def test_an_option_that_does_not_exist_is_answered_with_those_there_are(make, said):
    with pytest.raises(InvalidInput, match=said):
        make()


@pytest.mark.compiles
def test_a_dict_with_an_unknown_name_is_answered_with_those_there_are():
    with pytest.raises(MissingBackend, match=r"unknown QP solver 'magic'; available: .*daqp.*osqp"):
        TrackingMPC(PLANT, solver={"name": "magic"})
    with pytest.raises(MissingBackend, match=r"unknown NLP solver 'magic'; available: fatrop, ipopt"):
        NonlinearMPC(PLANT, solver={"name": "magic"})


@pytest.mark.parametrize("kind", [Riccati, DAQP, OSQP, Clarabel, SCS, IPOPT, Fatrop])
def test_values_are_frozen_and_travel(kind):
    value = kind()
    with pytest.raises(FrozenInstanceError):
        value.name = "other"
    assert loads(dumps(value)) == value == replace(value)
    assert hash(value) == hash(kind())


@pytest.mark.compiles
@pytest.mark.parametrize("given", [OSQP, DAQP, IPOPT, IPOPT(), None, 5, ("osqp",), b"osqp", {5: 6}])
def test_what_is_no_qp_solver_is_refused_when_the_controller_is_built(given):
    with pytest.raises(InvalidInput, match="solver = "):
        TrackingMPC(PLANT, N=3, solver=given)


@pytest.mark.parametrize("given", [IPOPT, DAQP(), None, 5, ["ipopt"]])
def test_what_is_no_nlp_solver_is_refused_when_the_controller_is_built(given):
    with pytest.raises(MissingBackend, match="unknown NLP solver"):
        NonlinearMPC(PLANT, N=3, solver=given)


@pytest.mark.parametrize(
    ("kind", "option", "value"),
    [
        (OSQP, "eps_abs", "x"), (OSQP, "eps_abs", -1.0), (OSQP, "polishing", 1), (DAQP, "primal_tol", np.nan),
        (DAQP, "iter_limit", 1.5), (DAQP, "iter_limit", 10**12), (Clarabel, "max_iter", "x"),
        (Clarabel, "tol_feas", None),
        (IPOPT, "max_iter", 1.5), (IPOPT, "max_iter", -4), (IPOPT, "tol", True), (IPOPT, "mu_strategy", 3),
    ],
)  # fmt: skip
def test_an_option_of_the_wrong_kind_is_one_sentence(kind, option, value):
    with pytest.raises(InvalidInput, match=f"{kind.__name__}: {option} = .* has to be "):
        kind(**{option: value})


def test_numbers_of_numpy_are_numbers():
    assert DAQP(primal_tol=np.float32(0.5), iter_limit=np.int64(3)).given == {"primal_tol": 0.5, "iter_limit": 3}
    assert OSQP(polishing=np.True_).given["polishing"]


def test_an_option_that_casadi_refuses_is_one_sentence():
    with pytest.raises(InvalidInput, match="CasADi refuses IPOPT"):
        NonlinearMPC(PLANT, N=3, solver=IPOPT(mu_strategy="nope"))


@pytest.mark.compiles
def test_a_value_of_a_solver_that_is_not_installed_is_refused(monkeypatch):
    monkeypatch.setattr("qpsolvers.available_solvers", ["clarabel"])
    with pytest.raises(MissingBackend, match="unknown QP solver 'osqp'; available: clarabel, daqp"):
        TrackingMPC(PLANT, N=3, solver=OSQP(eps_abs=1e-9))
    with pytest.raises(MissingBackend, match="unknown QP solver 'nope'"):
        solver(Installed("nope"))
    assert hash(Installed("highs")) == hash(Installed("highs"))


@pytest.mark.compiles
def test_a_copy_of_a_qp_cannot_be_written_into_either():
    for copied in (loads(dumps(qp := TrackingMPC(PLANT, N=3).qp(REST, 0.1, 7.6))), deepcopy(qp)):
        assert not copied.H.flags.writeable
        np.testing.assert_array_equal(copied.H, qp.H)


@pytest.mark.compiles
def test_a_qp_beyond_the_range_of_numbers_is_one_sentence():
    with pytest.raises(InvalidInput, match="leaves the range of numbers"):
        TrackingMPC(PLANT, N=3).qp(REST, 0.1, 7.6, 1e300)
