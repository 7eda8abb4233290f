"""Back-end "nlp": the allocation problem as a nonlinear programme in CasADi, by IPOPT or CasADi's SQP method.

The programme is built once per joint and kind of goal; angle, targets, bounds and weights are its parameters.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from allocator.allocation.optimisers.backends import SCALE, Answer, Goal, goals, settled, start
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import MissingBackend
from allocator.joint.antagonist import AntagonistJoint

if TYPE_CHECKING:
    import casadi

_SOLVERS: dict[str, dict[str, Any]] = {
    "ipopt": {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": 1e-11,
        "ipopt.acceptable_tol": 1e-9,
        "ipopt.max_iter": 200,
    },
    "sqpmethod": {
        "qpsol": "daqp",  # CasADi's default, qrqp, reports success on points that are not optimal
        "qpsol_options": {"error_on_fail": False},
        "print_header": False,
        "print_iteration": False,
        "print_status": False,
        "hessian_approximation": "limited-memory",  # the exact Hessian is indefinite in places
        "tol_pr": 1e-11,
        "tol_du": 1e-9,
        "max_iter": 100,
    },
}
_IPOPT_WARM = {  # start with a small barrier and near the bounds, where the warm start often lies
    "ipopt.mu_init": 1e-9,
    "ipopt.bound_push": 1e-8,
    "ipopt.bound_frac": 1e-8,
}


def solve(problem: Problem, solver: str | None = None, warm_start: bool = True) -> Answer:
    """Solve by CasADi; `solver` is "ipopt" (default) or "sqpmethod"."""
    solver = "ipopt" if solver is None else solver
    if solver not in _SOLVERS:
        raise MissingBackend("NLP solver", solver, _SOLVERS)
    P = start(problem, warm_start) / SCALE
    iterations = np.zeros(problem.theta.shape, np.int32)
    for goal in goals(problem):
        programme = _programme(problem.joint, goal.kept, solver, warm_start, problem.shares is not None)
        numbers = _numbers(problem, goal, P)
        for i in np.flatnonzero(~settled(problem, goal, P * SCALE)):
            P[:, i], used = _solve_one(programme, P[:, i], **{name: column[:, i] for name, column in numbers.items()})
            iterations[i] += used
    return Answer(P[0] * SCALE, P[1] * SCALE, iterations)


def _numbers(problem: Problem, goal: Goal, P: Array) -> dict[str, Array]:
    """Return parameters (12, n), bounds (2, n) in bar and constraint bounds (2, n) of all programmes."""
    n, box = problem.theta.size, problem.box
    T_scale, K_scale = problem.scales
    weight = np.maximum(goal.w_T * T_scale**2, goal.w_K * K_scale**2)  # makes the cost of order one
    ones = np.ones(n)
    R1, R2 = (ones * R / SCALE for R in problem.P_ref)
    weights = (ones * goal.w_T / weight, ones * goal.w_K / weight, ones * goal.rho * SCALE**2 / weight)
    s1, s2 = (0.0 * ones, 0.0 * ones) if problem.shares is None else problem.shares
    parameters = np.stack([problem.theta, problem.T_aim, problem.K_aim, *weights, R1, R2, T_scale, K_scale, s1, s2])
    lo = np.stack([box.agonist.lo, box.antagonist.lo]) / SCALE
    hi = np.stack([box.agonist.hi, box.antagonist.hi]) / SCALE
    e_T, e_K = problem.errors(*(P * SCALE))
    kept = {"torque": e_T / T_scale, "stiffness": e_K / K_scale}.get(goal.kept or "", 0.0 * ones)
    least = ones * box.least_sum / SCALE
    return {
        "p": parameters,
        "lo": lo,
        "hi": hi,
        "g_lo": np.stack([kept, least]),
        "g_hi": np.stack([kept, np.inf * ones]),
    }


def _solve_one(
    programme: "casadi.Function", x0: Array, p: Array, lo: Array, hi: Array, g_lo: Array, g_hi: Array
) -> tuple[Array, int]:
    if (lo == hi).all():  # nothing to choose
        return x0, 0
    solution = programme(x0=x0, p=p, lbx=lo, ubx=hi, lbg=g_lo, ubg=g_hi)
    return np.clip(np.array(solution["x"]).ravel(), lo, hi), int(programme.stats()["iter_count"])


@lru_cache(maxsize=32)
def _programme(joint: AntagonistJoint, kept: str | None, solver: str, warm_start: bool, gas: bool) -> "casadi.Function":
    import casadi

    x, p = casadi.SX.sym("P", 2), casadi.SX.sym("p", 12)
    theta, T, K, w_T, w_K, rho, R1, R2, T_scale, K_scale, s1, s2 = casadi.vertsplit(p)
    agonist, antagonist = joint.sides(theta, (s1, s2) if gas else None)
    P1, P2 = SCALE * x[0], SCALE * x[1]
    e_T = agonist.torque(P1) + antagonist.torque(P2) - T
    e_K = agonist.stiffness(P1) + antagonist.stiffness(P2) - K
    cost = w_T * e_T**2 + w_K * e_K**2 + rho * ((x[0] - R1) ** 2 + (x[1] - R2) ** 2)
    row = {"torque": e_T / T_scale, "stiffness": e_K / K_scale, None: casadi.SX(0)}[kept]
    nlp = {"x": x, "p": p, "f": cost, "g": casadi.vertcat(row, x[0] + x[1])}
    options = {"print_time": False, "error_on_fail": False, **_SOLVERS[solver]}
    if warm_start and solver == "ipopt":
        options |= _IPOPT_WARM
    return casadi.nlpsol("allocation", solver, nlp, options)
