"""Solvers are values with their options; names and dicts stand for them; wrong options are named in one sentence."""

from dataclasses import FrozenInstanceError, replace
from pickle import dumps, loads

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput, MissingBackend
from mpc import DAQP, IPOPT, OSQP, SCS, Clarabel, Fatrop, NonlinearMPC, PlanStatus, Plant, TrackingMPC
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver

PLANT, REST = Plant(), Plant().at_rest(0.0, 7.6)
TIGHT = {"name": "osqp", "eps_abs": 1e-9}


@pytest.mark.parametrize(
    "given", ["osqp", OSQP(), {"name": "osqp"}, TIGHT, OSQP(eps_abs=1e-9), DAQP(iter_limit=500), {}]
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


def test_a_dict_with_an_unknown_name_is_answered_with_those_there_are():
    with pytest.raises(MissingBackend, match=r"unknown QP solver 'magic'; available: .*daqp.*osqp"):
        TrackingMPC(PLANT, solver={"name": "magic"})
    with pytest.raises(MissingBackend, match=r"unknown NLP solver 'magic'; available: fatrop, ipopt"):
        NonlinearMPC(PLANT, solver={"name": "magic"})


@pytest.mark.parametrize("kind", [DAQP, OSQP, Clarabel, SCS, IPOPT, Fatrop])
def test_values_are_frozen_and_travel(kind):
    value = kind()
    with pytest.raises(FrozenInstanceError):
        value.name = "other"
    assert loads(dumps(value)) == value == replace(value)
    assert hash(value) == hash(kind())
