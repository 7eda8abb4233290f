"""Allocation problem under uncertain muscle parameters, and its solution by the back-end "convex" with `uncertainty`.

The parameters p of the (affine) muscles are normal with covariance C = L Lᵀ. To first order in p every force, torque
and stiffness is normal, with a standard deviation that is the norm of an affine function of the pressures. So

    minimise    w_T E[(T - T*)²] + w_K E[(K - K*)²] + ρ ‖P - P_ref‖²
    subject to  prob(min_force ≤ F_i ≤ max_force, i = 1, 2) ≥ 1 - α,   supply, slew, floor                        [U]

is a second-order cone programme: E[(T - T*)²] = (T̂ - T*)² + ‖Lᵀ∂T/∂p‖², and each of the m force limits is kept with
probability 1 - α/m (Bonferroni), F̂_i - z ‖Lᵀ∂F_i/∂p‖ ≥ min_force with z the normal quantile. For the lexicographic
priorities the mean of the first target is met and kept; the second enters by its expectation.

Each force limit depends on one pressure only, so it is a bound on that pressure: the feasible set is a box again,
`chance_box`, found by root finding without the cones. Since the first order may underestimate the risk, the box also
keeps the limits in draws of the parameters (`draws.py`). cvxpy solves the cone programme; the certificate does not use
the cones, and measures optimality by the remaining step inside the box.
"""

from dataclasses import replace
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.optimisers import convex
from allocator.allocation.optimisers.backends import CERTIFIED, SCALE, Answer, Goal, goals, replacement
from allocator.allocation.status import UNCERTAIN
from allocator.allocation.two_muscles import certificate
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.uncertain.draws import sampled_box
from allocator.allocation.uncertain.spread import spread
from allocator.calculus import Array, increasing_root
from allocator.joint.limits import Limit, PressureBox, PressureInterval
from allocator.joint.one_muscle import OneMuscle


class Affine(NamedTuple):
    """Affine quantity y = y0 + Y u of pressures u = (P1, P2) [bar] of n problems; y (n, m), Y (n, m, 2)."""

    offset: Array
    slope: Array

    def __call__(self, u: Array) -> Array:
        """Return y (n, m) at u (n, 2)."""
        return np.asarray(self.offset + np.einsum("nmi,ni->nm", self.slope, u))


class Uncertain(NamedTuple):
    """n problems [U]: means (m = 1) and spreads over the pressures, and the force limits' z."""

    errors: tuple[Affine, Affine]  # T̂ - T*, K̂ - K* [N·m], [N·m/rad]
    spreads: tuple[Affine, Affine]  # Lᵀ∂T/∂p, Lᵀ∂K/∂p
    forces: tuple[Affine, Affine]  # F̂1, F̂2 [N]
    force_spreads: tuple[Affine, Affine]
    z: float  # normal quantile of 1 - α/m


def uncertain(problem: Problem, risk: float) -> Uncertain:
    """Return the means and spreads of the problem, affine in the pressures and thus determined by three of them."""
    corners = [np.full((2, problem.theta.size), 0.0) for _ in range(3)]
    corners[1][0], corners[2][1] = SCALE, SCALE

    def affine(values: list[Array]) -> Affine:
        zero, one, two = (v if v.ndim == 2 else v[:, None] for v in values)
        return Affine(zero, np.stack([one - zero, two - zero], axis=2))

    errors = [problem.errors(*P) for P in corners]
    forces = [[side.force(P[i]) for i, side in enumerate(problem.sides)] for P in corners]
    spreads = [spread(problem, *P) for P in corners]
    return Uncertain(
        (affine([e[0] for e in errors]), affine([e[1] for e in errors])),
        (affine([s.torque for s in spreads]), affine([s.stiffness for s in spreads])),
        (affine([f[0] for f in forces]), affine([f[1] for f in forces])),
        (affine([s.forces[0] for s in spreads]), affine([s.forces[1] for s in spreads])),
        NormalDist().inv_cdf(1 - risk_of_one(problem, risk)),
    )


def risk_of_one(problem: Problem, risk: float) -> float:
    """Return α/m [-], the probability with which each force limit may be broken."""
    limits = 2 * sum(force is not None for force in (problem.limits.min_force, problem.limits.max_force))
    return risk / max(limits, 1)


def chance_box(problem: Problem, risk: float) -> PressureBox:
    """Return the pressures that keep every force limit with its probability: again one interval a muscle."""
    model, box = uncertain(problem, risk), sampled_box(problem, risk_of_one(problem, risk))
    intervals = [
        _narrowed(problem, side, interval, model, j)
        for j, (side, interval) in enumerate(zip(problem.sides, box, strict=True))
    ]
    return replace(box, agonist=intervals[0], antagonist=intervals[1])


def _narrowed(
    problem: Problem, side: OneMuscle, interval: PressureInterval, model: Uncertain, j: int
) -> PressureInterval:
    mean, deviation, lo, hi = model.forces[j], model.force_spreads[j], interval.lo, interval.hi
    lo_limit, hi_limit = interval.lo_limit, interval.hi_limit

    def worst(P: Array, f0: Array, f1: Array, sign: Array, index: Array) -> Array:
        i = index.astype(int)
        spread = deviation.offset[i] + deviation.slope[i, :, j] * (P / SCALE)[..., None]
        return np.asarray(f0 + f1 * P / SCALE + sign * model.z * np.linalg.norm(spread, axis=-1))

    given = mean.offset[:, 0], mean.slope[:, 0, j]
    index = np.arange(problem.theta.size, dtype=float)
    if (least := problem.limits.min_force) is not None:
        low = increasing_root(worst, lo, hi, given[0] - least, given[1], -np.ones_like(lo), index)
        slack = Limit.AGONIST_SLACK if j == 0 else Limit.ANTAGONIST_SLACK
        lo_limit = np.where(low > lo, np.int32(slack), interval.lo_limit)
        lo = np.maximum(lo, low)
    if (greatest := problem.limits.max_force) is not None:
        high = increasing_root(worst, interval.lo, hi, given[0] - greatest, given[1], np.ones_like(lo), index)
        ceiling = Limit.AGONIST_FORCE if j == 0 else Limit.ANTAGONIST_FORCE
        hi_limit = np.where(high < hi, np.int32(ceiling), interval.hi_limit)
        hi = np.minimum(hi, high)
    return replace(interval, lo=lo, hi=hi, lo_limit=lo_limit, hi_limit=hi_limit, empty=interval.empty | (lo > hi))


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


def _solve_one(
    problem: Problem, model: Uncertain, box: PressureBox, A: Array, b: Array, kept: tuple[Array, float] | None, i: int
) -> tuple[Array, int]:
    """Return the pressures (2,) [bar] of problem i, NaN if the solver finds none, and its iterations."""
    values = _values(problem, model, box, A, b, kept, i)
    shape = (len(b), *(model.force_spreads[j].offset.shape[1] for j in _SIDES))
    limits = tuple(None if f is None else f / _FORCE for f in (problem.limits.min_force, problem.limits.max_force))
    programme = _programme(shape, limits, bool(np.isfinite(values["least"])), kept is not None)
    if not programme.run(values, "clarabel"):
        return np.full(2, np.nan), 0
    return np.asarray(programme.d.value), int(programme.problem.solver_stats.num_iters)


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
) -> convex.Programme:
    """Return the cone programme, built once for each shape, with parameters for changing data."""
    import cvxpy as cp

    def cones(u: "cp.Variable", p: dict[str, "cp.Parameter"]) -> list["cp.Constraint"]:
        made: list[cp.Constraint] = []
        for j in _SIDES:
            p |= {name: cp.Parameter() for name in (f"f{j}", f"f0{j}")}
            p |= {name: cp.Parameter(shape[1 + j]) for name in (f"S{j}", f"s{j}")}
            force, deviation = p[f"f{j}"] * u[j] + p[f"f0{j}"], cp.norm(p[f"S{j}"] * u[j] + p[f"s{j}"])
            low, high = limits
            made += [] if low is None else [deviation <= force - low]
            made += [] if high is None else [deviation <= high - force]
        return made

    return convex.programme_of(shape[0], floor, kept, cones)


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
