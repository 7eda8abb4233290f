"""Back-end "convex" with `uncertainty`: problem [U] as a second-order cone programme in cvxpy.

The certificate does not use the cones: bounds come from root finding, optimality from the remaining step inside them.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.optimisers import convex
from allocator.allocation.optimisers.backends import CERTIFIED, SCALE, Answer, Goal, goals, replacement
from allocator.allocation.status import UNCERTAIN
from allocator.allocation.two_muscles import certificate
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.uncertain.problem import Affine, Uncertain, chance_box, risk_of_one, sampled_box, uncertain
from allocator.calculus import Array
from allocator.joint.limits import PressureBox

if TYPE_CHECKING:
    import cvxpy

_FORCE = 1e3  # [N] the solver uses kN
_SIDES = (0, 1)


class RiskySolution(NamedTuple):
    """Feasible pressures of n problems [U], and which are infeasible."""

    P1: Array
    P2: Array
    iterations: NDArray[np.int32]
    failed: NDArray[np.bool_]
    box: PressureBox  # the pressures that keep the force limits with the required probability
    infeasible: NDArray[np.bool_]  # whether there are none


def optimise(problem: Problem, risk: float) -> RiskySolution:
    """Solve problem [U], check every answer, and replace the failed ones by the nominal exact answer."""
    answer, box = solve(problem, risk), chance_box(problem, risk)
    infeasible = box.empty | (box.agonist.hi + box.antagonist.hi < box.least_sum)
    P1, P2 = box.project(answer.P1, answer.P2)
    failed = ~infeasible & ~(residual(problem, risk, P1, P2) <= CERTIFIED)
    if (replaced := failed | infeasible).any():
        P1[replaced], P2[replaced] = replacement(problem.take(replaced))
    return RiskySolution(P1, P2, answer.iterations, failed, box, infeasible)


def solve(problem: Problem, risk: float) -> Answer:
    """Return the pressures of [U], NaN where no pressures keep the limits with that probability."""
    model, n = uncertain(problem, risk), problem.theta.size
    box = sampled_box(problem, risk_of_one(problem, risk))
    u, iterations = np.full((n, 2), np.nan), np.zeros(n, np.int32)
    for goal in goals(problem):
        rows = _rows(problem, model, goal)
        for i in range(n):
            if goal.kept is not None and np.isnan(u[i]).any():
                continue
            kept = None if goal.kept is None else _kept(model, goal, u, i)
            u[i], used = _solve_one(problem, model, box, rows[0][i], rows[1][i], kept, i)
            iterations[i] += used
    return Answer(u[:, 0] * SCALE, u[:, 1] * SCALE, iterations)


def _rows(problem: Problem, model: Uncertain, goal: Goal) -> tuple[Array, Array]:
    """Return A (n, r, 2) and b (n, r) of the cost ‖A u + b‖²: mean errors, spreads, pull; scaled to order one."""
    first_of_two = goal.kept is None and problem.priority != "weighted"  # the mean alone
    parts, T_scale, K_scale = [], *problem.scales
    weight = np.maximum(goal.w_T * T_scale**2, goal.w_K * K_scale**2)
    for w, error, deviation in zip((goal.w_T, goal.w_K), model.errors, model.spreads, strict=True):
        if w:
            root = np.sqrt(w / weight)
            parts += [(root, part) for part in ((error,) if first_of_two else (error, deviation))]
    if goal.rho:
        n, R = problem.theta.size, np.stack(np.broadcast_arrays(*problem.P_ref, problem.theta)[:2], axis=1)
        identity = np.broadcast_to(np.eye(2), (n, 2, 2))
        parts.append((SCALE * np.sqrt(goal.rho / weight), Affine(-R / SCALE, identity)))
    A = np.concatenate([root[:, None, None] * part.slope for root, part in parts], axis=1)
    return A, np.concatenate([root[:, None] * part.offset for root, part in parts], axis=1)


def _kept(model: Uncertain, goal: Goal, u: Array, i: int) -> tuple[Array, float]:
    error = model.errors[0 if goal.kept == "torque" else 1]
    row = error.slope[i, 0] / np.abs(error.slope[i, 0]).max()
    return row, float(row @ u[i])


class _Programme(NamedTuple):
    problem: "cvxpy.Problem"
    u: "cvxpy.Variable"
    parameters: dict[str, "cvxpy.Parameter"]


def _solve_one(
    problem: Problem, model: Uncertain, box: PressureBox, A: Array, b: Array, kept: tuple[Array, float] | None, i: int
) -> tuple[Array, int]:
    """Return the pressures (2,) [bar] of problem i, NaN if the solver finds none, and its iterations."""
    values = _values(problem, model, box, A, b, kept, i)
    shape = (len(b), *(model.force_spreads[j].offset.shape[1] for j in _SIDES))
    limits = tuple(None if f is None else f / _FORCE for f in (problem.limits.min_force, problem.limits.max_force))
    programme = _programme(shape, limits, bool(np.isfinite(values["least"])), kept is not None)
    for name, parameter in programme.parameters.items():
        parameter.value = values[name]
    if not convex.run(programme.problem, "clarabel"):
        return np.full(2, np.nan), 0
    return np.asarray(programme.u.value), int(programme.problem.solver_stats.num_iters)


def _values(
    problem: Problem, model: Uncertain, box: PressureBox, A: Array, b: Array, kept: tuple[Array, float] | None, i: int
) -> dict[str, Array | float]:
    """Return the parameters of the programme of problem i."""
    values = {
        "A": A,
        "b": b,
        "lo": np.array([side.lo[i] for side in box]) / SCALE,
        "hi": np.array([side.hi[i] for side in box]) / SCALE,
        "least": np.broadcast_to(box.least_sum, problem.theta.shape)[i] / SCALE,
    }
    if kept is not None:
        values["row"], values["right"] = kept
    for j in _SIDES:
        mean, deviation = model.forces[j], model.force_spreads[j]
        values[f"f{j}"], values[f"f0{j}"] = mean.slope[i, 0, j] / _FORCE, mean.offset[i, 0] / _FORCE
        values[f"S{j}"], values[f"s{j}"] = (
            model.z * deviation.slope[i, :, j] / _FORCE,
            model.z * deviation.offset[i] / _FORCE,
        )
    return values


@lru_cache(maxsize=32)
def _programme(
    shape: tuple[int, int, int], limits: tuple[float | None, float | None], floor: bool, kept: bool
) -> _Programme:
    """Return the cone programme, built once for each shape, with parameters for changing data."""
    import cvxpy as cp

    u, (r, *m) = cp.Variable(2), shape
    p = {"A": cp.Parameter((r, 2)), "b": cp.Parameter(r), "lo": cp.Parameter(2), "hi": cp.Parameter(2)}
    constraints = [u >= p["lo"], u <= p["hi"]]
    if floor:
        p["least"] = cp.Parameter()
        constraints.append(cp.sum(u) >= p["least"])
    if kept:
        p["row"], p["right"] = cp.Parameter(2), cp.Parameter()
        constraints.append(p["row"] @ u == p["right"])
    for j in _SIDES:
        p |= {
            f"f{j}": cp.Parameter(),
            f"f0{j}": cp.Parameter(),
            f"S{j}": cp.Parameter(m[j]),
            f"s{j}": cp.Parameter(m[j]),
        }
        force, deviation = p[f"f{j}"] * u[j] + p[f"f0{j}"], cp.norm(p[f"S{j}"] * u[j] + p[f"s{j}"])
        low, high = limits
        constraints += [] if low is None else [deviation <= force - low]
        constraints += [] if high is None else [deviation <= high - force]
    return _Programme(cp.Problem(cp.Minimize(cp.sum_squares(p["A"] @ u + p["b"])), constraints), u, p)


def residual(problem: Problem, risk: float, P1: Array, P2: Array) -> Array:
    """Return the step that would improve the answer within the chance box, in fractions of the supply range (n,)."""
    model, box = uncertain(problem, risk), chance_box(problem, risk)
    u, span = np.stack([P1, P2], axis=1) / SCALE, problem.joint.pressure_span
    outside = [np.maximum(side.lo - P, P - side.hi) for side, P in zip(box, (P1, P2), strict=True)]
    steps = [np.maximum(*outside), box.least_sum - P1 - P2]
    for goal in goals(problem):
        A, b = _rows(problem, model, goal)
        g = np.einsum("nri,nr->in", A, np.einsum("nri,ni->nr", A, u) + b) / SCALE
        h = np.einsum("nri,nrj->ijn", A, A) / SCALE**2
        gradient, hessian = (g[0], g[1]), (h[0, 0], h[0, 1], h[1, 1])
        if goal.kept is not None:
            kept = model.errors[0 if goal.kept == "torque" else 1].slope[:, 0]
            steps.append(certificate.level_step(box, P1, P2, (kept[:, 0], kept[:, 1]), gradient, hessian))
        elif problem.priority == "weighted":
            steps.append(certificate.newton_step(box, P1, P2, gradient, hessian, near=UNCERTAIN.binds * span))
        else:
            toward = 1 / (hessian[0] + hessian[2])
            Q1, Q2 = box.project(P1 - toward * g[0], P2 - toward * g[1])
            steps.append(np.maximum(np.abs(Q1 - P1), np.abs(Q2 - P2)))
    worst = np.max([np.broadcast_to(step, P1.shape) for step in steps], axis=0) / span
    return np.asarray(np.where(np.isnan(worst), np.inf, np.maximum(worst, 0.0)))
