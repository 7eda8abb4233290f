"""The softened QP: it always has an answer, and this is the minimum that another solver finds."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from mpc import Plant, TrackingMPC
from mpc.tracking.qp.condense import softened
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver
from tests.mpc.tracking.hard_limits import hard_solutions

pytestmark = pytest.mark.compiles

COMMAND = 1e6  # [cost]/[bar]²


@pytest.fixture(scope="module")
def qps():
    return [hard.qp for hard in hard_solutions(TrackingMPC(Plant(), N=8), 120)]


def with_a_slack_for_each_row(qp):
    """The problem of `mpc.tracking.qp.condense` as a QP: every row may be broken for ½ w times the square of its own
    slack."""
    n, m = qp.f.size - 2, len(qp.R)
    w = np.where(qp.R[:, -2] != 0, qp.H[-2, -2], np.where(qp.R[:, -1] != 0, qp.H[-1, -1], COMMAND))
    H = np.zeros((n + m, n + m))
    H[:n, :n], H[n:, n:] = qp.H[:n, :n], np.diag(w)
    R, bounds = np.hstack([qp.R[:, :n], np.eye(m)]), [(qp.lower, -inf), (qp.upper, inf)]
    lower, upper = (np.append(given[:n], np.full(m, free)) for given, free in bounds)
    return QP(H, np.append(qp.f[:n], np.zeros(m)), lower, upper, R, qp.rows_lower, qp.rows_upper)


def test_it_has_an_answer_near_every_limit_and_keeps_the_slew(qps):
    for qp in qps:
        z = softened(qp, inf)
        assert z is not None
        assert ((qp.lower <= z) & (z <= qp.upper)).all()


def test_it_finds_the_minimum_that_a_solver_finds_for_a_slack_of_each_row(qps):
    charged = 0
    for qp in qps[:40]:
        whole = with_a_slack_for_each_row(qp)
        best, _ = solver("clarabel")(whole)
        z = softened(qp, inf)[:-2]
        breach = np.clip(whole.R[:, : z.size] @ z, qp.rows_lower, qp.rows_upper) - whole.R[:, : z.size] @ z
        assert whole.cost(np.append(z, breach)) <= whole.cost(best) + 1e-5 * abs(whole.cost(best))
        charged += bool((np.abs(breach) > 1e-6).any())
    assert charged > 3


def test_where_no_limit_is_broken_it_is_the_qp_s_solution(qps):
    qp = replace(qps[0], rows_lower=np.full(len(qps[0].R), -inf), rows_upper=np.full(len(qps[0].R), inf))
    z, _ = solver("daqp")(qp)
    np.testing.assert_allclose(softened(qp, inf), z, atol=1e-8)


def test_when_time_is_over_it_has_none(qps):
    assert [softened(qp, -inf) for qp in qps[:3]] == [None] * 3


def test_numbers_that_allow_no_answer_do_no_harm(qps):
    assert softened(replace(qps[0], H=np.zeros_like(qps[0].H)), inf) is None
