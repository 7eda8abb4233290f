"""Sequential quadratic programming for the allocation problem, shared by "qp" and "convex".

At pressures P each goal is replaced by its model in the step d,

    minimise ½ dᵀH d + gᵀd   subject to   lo - P ≤ d ≤ hi - P,  d1 + d2 ≥ 2 P_co - P1 - P2,  aᵀd = r              (QP)

with the Gauss–Newton Hessian H plus the curvature of torque and stiffness (diagonal, since each muscle sees its own
pressure only) where H stays positive definite, and with aᵀd = r keeping the goal that came first, which is restored
after every step (second-order correction). A step that raises the merit, cost plus an exact penalty on the kept goal,
is replaced by the best of shorter and longer ones, as are all steps once progress is slow. All problems advance
together; only the small QPs are solved one by one.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.optimisers.backends import SCALE, Answer, Goal, goals, settled, start
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array

_ITERATIONS, _QUICK = 60, 6  # at most; Newton's method ends long before the second number unless progress is slow
_LADDER = 2.0 ** np.arange(8, -26, -1)  # steps tried, in units of d
_CONVERGED = 1e-8  # [bar] a smaller step counts as none
_DAMPING = 1e-5  # of the Hessian's trace: makes the QP of a single goal strictly convex; costs an iteration
_STALLED = 1e-16  # a smaller gain in the merit, which is of order one, counts as none
_PENALTY = 10.0  # on the kept goal, in scaled units; above its multiplier, which is of order one


class SmallQP(NamedTuple):
    """One (QP), in bar and scaled errors; the kept row is None without a kept goal."""

    H: Array  # (2, 2)
    g: Array  # (2,)
    lo: Array  # (2,)
    hi: Array  # (2,)
    least_sum: float  # of the step; -inf without a floor
    row: Array | None  # a, (2,)
    right: float  # r


def solve(problem: Problem, solve_qp: Callable[[SmallQP], Array | None], warm_start: bool = True) -> Answer:
    """Minimise the goals of all problems; `solve_qp` returns a step (2,), or None on failure."""
    P = start(problem, warm_start) / SCALE
    iterations = np.zeros(problem.theta.shape, np.int32)
    for goal in goals(problem):
        P, used = _minimise(problem, goal, P, solve_qp)
        iterations += used
    return Answer(P[0] * SCALE, P[1] * SCALE, iterations)


def _minimise(
    problem: Problem, goal: Goal, P: Array, solve_qp: Callable[[SmallQP], Array | None]
) -> tuple[Array, NDArray[np.int32]]:
    model = _Model(problem, goal, P.copy())
    used = np.zeros(P.shape[1], np.int32)
    active = ~settled(problem, goal, P * SCALE)
    for iteration in range(_ITERATIONS):
        index = np.flatnonzero(active)
        if not index.size:
            break
        part = model.take(index)
        steps = [solve_qp(qp) for qp in part.qps(P[:, index])]
        d = np.array([[np.nan, np.nan] if step is None else step for step in steps]).T
        used[index] += 1
        before, P[:, index] = part.merit(P[:, index]), part.searched(P[:, index], d, slow=iteration >= _QUICK)
        gained = before - part.merit(P[:, index]) > _STALLED
        active[index] = gained & (np.abs(d).max(axis=0) > _CONVERGED)  # NaN compares false: a failure stops
    P[:, active] = np.nan  # out of iterations
    return P, used


class _Model:
    """Scaled errors, derivatives and merit of one goal for a set of problems; pressures (2, n) in bar."""

    def __init__(self, problem: Problem, goal: Goal, P_start: Array) -> None:
        self.problem, self.goal, self._P_start = problem, goal, P_start
        T_scale, K_scale = problem.scales
        weight = np.maximum(goal.w_T * T_scale**2, goal.w_K * K_scale**2)  # makes the cost of order one
        self.w_T, self.w_K, self.rho = goal.w_T / weight, goal.w_K / weight, goal.rho * SCALE**2 / weight
        self.kept_scale = T_scale if goal.kept == "torque" else K_scale
        self.kept_value = self._kept(P_start)

    def take(self, index: NDArray[np.intp]) -> "_Model":
        return _Model(self.problem.take(index), self.goal, self._P_start[:, index])

    def _errors(self, P: Array) -> tuple[Array, Array]:
        return self.problem.errors(*(P * SCALE))

    def _kept(self, P: Array) -> Array:
        e_T, e_K = self._errors(P)
        return {"torque": e_T, "stiffness": e_K}.get(self.goal.kept or "", 0.0 * e_T) / self.kept_scale

    def _gains(self, P: Array) -> tuple[Array, Array]:
        """Return ∂T/∂P and ∂K/∂P, (2, n) per bar."""
        t = np.stack([side.torque_gain(p * SCALE) for side, p in zip(self.problem.sides, P, strict=True)])
        k = np.stack([side.stiffness_gain(p * SCALE) for side, p in zip(self.problem.sides, P, strict=True)])
        return t * SCALE, k * SCALE

    def _reference(self) -> Array:
        return np.stack([np.broadcast_to(R, self.problem.theta.shape) for R in self.problem.P_ref]) / SCALE

    def merit(self, P: Array) -> Array:
        e_T, e_K = self._errors(P)
        pull = self.rho * ((P - self._reference()) ** 2).sum(axis=0)
        broken = np.abs(self._kept(P) - self.kept_value)
        return np.asarray(self.w_T * e_T**2 + self.w_K * e_K**2 + pull + _PENALTY * broken)

    def qps(self, P: Array) -> list[SmallQP]:
        (e_T, e_K), (t, k), box = self._errors(P), self._gains(P), self.problem.box
        g = self.w_T * e_T * t + self.w_K * e_K * k + self.rho * (P - self._reference())
        H = self.w_T * t[:, None] * t + self.w_K * k[:, None] * k + self.rho * np.eye(2)[:, :, None]
        H = _convexified(H, self._curvature(P, e_T, e_K))
        lo = np.stack([box.agonist.lo, box.antagonist.lo]) / SCALE - P
        hi = np.stack([box.agonist.hi, box.antagonist.hi]) / SCALE - P
        least = np.broadcast_to(box.least_sum, P[0].shape) / SCALE - P.sum(axis=0)
        row = (t if self.goal.kept == "torque" else k) / self.kept_scale
        right = self.kept_value - self._kept(P)
        # problem by problem and contiguous: DAQP reads the memory of strided views wrongly
        H, g, lo, hi, row = (np.ascontiguousarray(np.moveaxis(array, -1, 0)) for array in (H, g, lo, hi, row))
        rows = row if self.goal.kept else [None] * len(g)
        return [SmallQP(*numbers) for numbers in zip(H, g, lo, hi, least, rows, right, strict=True)]

    def _curvature(self, P: Array, e_T: Array, e_K: Array) -> Array:
        """Return the Hessian's diagonal second-order part (2, n), w_T e_T T_PP + w_K e_K K_PP; 0 for affine muscles."""
        if self.problem.joint.affine:
            return np.zeros_like(P)
        h = 1e-4  # [bar]
        (t_up, k_up), (t_down, k_down) = self._gains(P + h), self._gains(P - h)
        return np.asarray((self.w_T * e_T * (t_up - t_down) + self.w_K * e_K * (k_up - k_down)) / (2 * h))

    def searched(self, P: Array, d: Array, slow: bool) -> Array:
        """Return P + d if the merit does not rise; else, or if progress is `slow`, the best step of a ladder."""
        start, best = self.merit(P), self._restored(P + d)
        best_merit = self.merit(best)
        if not slow and not (best_merit > start).any():
            return best
        for step in _LADDER:
            trial = self._restored(P + step * d)
            merit = self.merit(trial)
            better = merit < best_merit
            best, best_merit = np.where(better, trial, best), np.where(better, merit, best_merit)
        return np.where(best_merit > start, P, best)

    def _restored(self, P: Array) -> Array:
        """Move P back onto the curved level of the kept goal; otherwise the merit allows only short steps."""
        if self.goal.kept is not None:
            t, k = self._gains(P)
            row = (t if self.goal.kept == "torque" else k) / self.kept_scale
            square = (row**2).sum(axis=0)  # 0: no pressure changes this goal
            P = P + row * (self.kept_value - self._kept(P)) / np.where(square > 0, square, 1.0)
        return np.stack(self.problem.box.project(*(P * SCALE))) / SCALE


def _convexified(H: Array, curvature: Array) -> Array:
    """Return H + diag(curvature) where that is positive definite, else H; slightly damped, (2, 2, n).

    A goal that no pressure changes has H = 0: it gets the identity, and its step is zero.
    """
    full = H + curvature[:, None] * np.eye(2)[:, :, None]
    trace, det = full[0, 0] + full[1, 1], full[0, 0] * full[1, 1] - full[0, 1] ** 2
    chosen = np.where((trace > 0) & (det > 1e-9 * trace**2), full, H)
    trace = chosen[0, 0] + chosen[1, 1]
    return np.asarray(chosen + np.where(trace > 0, _DAMPING * trace, 1.0) * np.eye(2)[:, :, None])
