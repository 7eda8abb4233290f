"""Sensitivities with more limits and costs, against differences and against CasADi's derivative of the NLP."""

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocator import InvalidInput, Limits, Method, Stiffness, allocate, report_joint
from allocator.units import BAR

shares = st.floats(0.02, 0.98).map(lambda x: round(x, 4))
VARIANTS = {
    "force ceiling": {"limits": Limits(max_force=400.0)},
    "force floor": {"limits": Limits(min_force=80.0)},
    "co-contraction": {"limits": Limits(min_cocontraction=3 * BAR)},
    "pull": {"pull": (5e-11, (2.5 * BAR, 2.0 * BAR))},
    "pull and co-contraction": {"pull": (5e-11, (2.5 * BAR, 2.0 * BAR)), "limits": Limits(min_cocontraction=3 * BAR)},
    "tolerance": {"stiffness": Stiffness(tolerance=0.3)},
}


@pytest.mark.slow
@pytest.mark.parametrize("priority", ["torque", "weighted"])
@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS.keys())
@settings(max_examples=10)  # for each of 11 variants and priorities
@given(share=shares, share_T=shares, K=st.floats(2.0, 11.0))
def test_the_jacobian_is_the_slope_of_the_answer(joints, variant, priority, share, share_T, K):
    joint = joints["sarosi-lever"]  # affine: every variant has a closed form
    if "stiffness" in variant and priority != "torque":
        return
    options = {"joint": joint, "priority": priority, "weights": (2.0, 5.0) if priority == "weighted" else None}
    left, right = joint.angle_range
    theta = left + share * (right - left)
    T_min, T_max = allocate(theta, 5.0, joint=joint).torque_interval
    x = np.array([theta, K, T_min + (1.4 * share_T - 0.2) * (T_max - T_min)])

    def pressures(x):
        a = allocate(*x, **options, **variant)
        return np.array([a.P1, a.P2]), a.active, a.status

    answer = allocate(*x, **options, **variant)
    for column, h in enumerate((1e-4, 1e-3, 1e-3)):
        near = [pressures(x + k * h * np.eye(3)[column]) for k in (-2, -1, 1, 2)]
        if any((active, status) != (answer.active, answer.status) for _, active, status in near):
            continue  # the active set changes here: the slope is one-sided
        p2m, p1m, p1, p2 = (P for P, *_ in near)
        slope = (8 * (p1 - p1m) - (p2 - p2m)) / (12 * h)
        assert answer.jacobian()[:, column] == pytest.approx(slope, rel=1e-4, abs=5.0)


def casadi_jacobian(joint, theta, K, T, lo, hi):
    """dP/d(θ, K, T) of the weighted NLP (w = 2, 5), by CasADi's own differentiation of IPOPT's solution."""
    x, p = casadi.SX.sym("P", 2), casadi.SX.sym("p", 3)
    P1, P2 = BAR * x[0], BAR * x[1]
    e_T, e_K = joint.torque(p[0], P1, P2) - p[2], joint.stiffness(p[0], P1, P2) - p[1]
    ipopt = {"print_level": 0, "sb": "yes", "tol": 1e-12}
    options = {"print_time": False, "min_lam": 1e-6, "ipopt": ipopt}  # smaller multipliers are those of no bound
    solver = casadi.nlpsol("s", "ipopt", {"x": x, "p": p, "f": 2 * e_T**2 + 5 * e_K**2}, options)
    q = casadi.MX.sym("q", 3)
    solution = solver(x0=[2.5, 2.5], p=q, lbx=lo, ubx=hi)
    jacobian = casadi.Function("J", [q], [casadi.jacobian(solution["x"], q)])
    return BAR * np.array(jacobian([theta, K, T]))


@pytest.mark.parametrize(
    ("theta", "K", "T", "min_force"),
    [
        pytest.param(0.3, 7.5, 1.0, 0.0, id="interior"),
        pytest.param(-0.8, 7.9, -2.0, 0.0, id="interior, left"),
        pytest.param(0.3, 11.0, 2.0, None, id="P1 at its upper limit"),
    ],
)
def test_the_jacobian_is_casadi_s(theta, K, T, min_force):
    joint = report_joint()
    answer = allocate(theta, K, T, priority="weighted", weights=(2.0, 5.0), limits=Limits(min_force=min_force))
    expected = casadi_jacobian(joint, theta, K, T, [0.0, 0.0], [5.0, 5.0])
    assert answer.jacobian() == pytest.approx(expected, rel=1e-4, abs=1e-4 * np.abs(expected).max())


def test_there_are_no_sensitivities_under_uncertainty(joints):
    joint = joints["sarosi-pulley"]
    covariance = np.diag([(0.01 * p) ** 2 for p in joint.agonist.parameters.values()])
    a = allocate(0.1, 6.0, 0.5, joint=joint, method=Method("convex", uncertainty=covariance))
    with pytest.raises(InvalidInput, match="without uncertainty"):
        a.jacobian()
