"""The QP of a step can be looked at: it is the one that is solved, its names say what is what, and nothing changes."""

from functools import cache

import numpy as np
import pytest
import qpsolvers
from scipy.optimize import Bounds, LinearConstraint, minimize
from scipy.sparse import csc_matrix

from allocator import BAR, DEG, InvalidInput
from mpc import Compensation, Plant, Rung, TrackingMPC
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip

pytestmark = pytest.mark.compiles

PLANT = Plant()
KNOWN = Compensation(Friction(mu=0.05), dead_time=0.02, dead_band=0.05 * BAR)
SLIP = MaxwellSlip((0.3, 0.2), (0.5 * DEG, 2 * DEG), elastic=True)
CASES = {  # of the controller, reference of the angle [rad], of the stiffness [N·m/rad]
    "free": ({}, 0.5 * DEG, 7.62),
    "slew": ({}, 20 * DEG, 7.6),
    "blocks": ({"blocks": (1, 1, 2, 4)}, 2 * DEG, 7.7),
    "dead time": ({"compensation": KNOWN}, 1 * DEG, 7.6),
    "hysteresis": ({"compensation": Compensation(SLIP)}, 1 * DEG, 7.6),
    "taut": ({"min_force": 40.0}, 20 * DEG, 5.0),
}


@cache
def built(name):
    return TrackingMPC(PLANT, N=8, **CASES[name][0])


@pytest.fixture(params=CASES)
def case(request):
    """A controller after two steps, its state and its references."""
    controller, (_, theta, K) = built(request.param), CASES[request.param]
    controller.reset()
    x = PLANT.at_rest(0.0, 7.6)
    for _ in range(2):
        x = controller.step(x, 0.0, 7.6).x[1]
    return controller, x, theta, K


def solution(qp):
    """The point that qpsolvers finds by Clarabel."""
    rows, bounds = np.vstack([qp.rows, -qp.rows]), np.append(qp.rows_upper, -qp.rows_lower)
    used = np.isfinite(bounds)
    tight = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}
    return qpsolvers.solve_qp(
        csc_matrix(qp.H),
        qp.f,
        csc_matrix(rows[used]),
        bounds[used],
        lb=qp.lower,
        ub=qp.upper,
        solver="clarabel",
        **tight,
    )


def test_an_independent_solver_comes_from_the_qp_to_the_plan(case):
    controller, *asked = case
    qp = controller.qp(*asked)
    commands = qp.commands(solution(qp))
    plan = controller.step(*asked)
    assert plan.rung is Rung.QP
    acting = controller.ladder.motion.u  # before the inverse of the dead band
    np.testing.assert_allclose(commands, acting, atol=2e-3 * BAR)


def test_scipy_comes_from_the_qp_to_the_plan():
    controller, x = TrackingMPC(PLANT, N=5), PLANT.at_rest(0.0, 7.6)
    qp = controller.qp(x, 1 * DEG, 7.62)
    scale = 1 / np.sqrt(np.diag(qp.H))  # z = scale y
    found = minimize(
        lambda y: 0.5 * (scale * y) @ qp.H @ (scale * y) + qp.f @ (scale * y),
        np.zeros_like(qp.f),
        jac=lambda y: scale * (qp.H @ (scale * y) + qp.f),
        hess=lambda y: scale[:, None] * qp.H * scale,
        method="trust-constr",
        bounds=Bounds(qp.lower / scale, qp.upper / scale),
        constraints=LinearConstraint(qp.rows * scale, qp.rows_lower, qp.rows_upper),
        options={"gtol": 1e-10, "xtol": 1e-12, "barrier_tol": 1e-10, "maxiter": 3000},
    )
    np.testing.assert_allclose(qp.commands(scale * found.x), controller.step(x, 1 * DEG, 7.62).u, atol=2e-3 * BAR)


def test_looking_changes_nothing(case):
    controller, *asked = case
    controller.qp(*asked)
    controller.qp(asked[0] + np.nan, 0.3, 9.0, 0.5)
    seen = controller.step(*asked)
    controller.reset()
    x = PLANT.at_rest(0.0, 7.6)
    for _ in range(2):
        x = controller.step(x, 0.0, 7.6).x[1]
    np.testing.assert_array_equal(controller.step(*asked).u, seen.u)


def test_names_say_what_decisions_and_rows_are(case):
    controller, *asked = case
    qp = controller.qp(*asked)
    n, m, N = len(qp.decisions), len(qp.row_names), controller.N
    assert qp.H.shape == (n, n)
    assert qp.rows.shape == (m, n)
    assert len(set(qp.decisions)) == n
    assert len(set(qp.row_names)) == m
    assert [name for name in qp.decisions if name.startswith("slack")] == ["slack angle", "slack force"]
    row = {name: qp.rows[i] for i, name in enumerate(qp.row_names)}
    column = {name: j for j, name in enumerate(qp.decisions)}
    for k in range(N):  # a command is the sum of the changes up to it
        acting = {name for name in qp.decisions if name.startswith("ΔP2[") and int(name[4:-1]) <= k}
        assert {qp.decisions[j] for j in np.flatnonzero(row[f"P2[{k}] supply"])} == acting
    for k in range(1, N + 1):
        assert row[f"angle[{k}] upper"][column["slack angle"]] == -1.0
        assert row[f"angle[{k}] lower"][column["slack angle"]] == 1.0
        assert row[f"agonist taut[{k}]"][column["slack force"]] == 1.0
    first = row["agonist taut[1]"][column["ΔP1[0]"]], row["antagonist taut[1]"][column["ΔP2[0]"]]
    assert min(first) > 0.0  # pressure makes its own muscle taut


def test_it_is_read_only_and_its_text_is_short(case):
    controller, *asked = case
    qp = controller.qp(*asked)
    with pytest.raises(ValueError, match="read-only"):
        qp.H[0, 0] = 1.0
    text = repr(qp)
    assert text.startswith(f"QP of a step: {len(qp.decisions)} decisions, {len(qp.row_names)} rows")
    assert all(name in text for name in ("ΔP1[0]", "slack angle", "P1[0] supply", "antagonist taut[8]"))
    assert len(text.splitlines()) < 60
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.filterwarnings("error")
def test_what_cannot_be_meant_is_said(case):
    controller, x, _, K = case
    with pytest.raises(InvalidInput, match="theta_ref = 40 rad"):
        controller.qp(x, 40.0, K)
    with pytest.raises(InvalidInput, match="x has the shape"):
        controller.qp(x[:3], 0.0, K)
