"""Solvers of the allocation problem by name; each is imported only when it is used.

The back-ends share the goals to minimise in order, the starting points and the form of the answers.
"""

from importlib import import_module
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import OPTIMISER
from allocator.allocation.two_muscles import certificate, exact
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.closed_form import solve_inverse
from allocator.errors import InvalidInput
from allocator.units import BAR

CERTIFIED = 1e-5  # of the supply range: an answer with a greater residual is rejected
_NOTHING = 1e-12  # of the scale of torque or stiffness: a goal missed by less leaves nothing to optimise
_GRID = 7
_SNAP = 1e-7  # of the supply range: an optimiser's pressure this near to a bound is moved to it
SCALE = BAR  # optimisers use pressures in bar: numbers of order one


class Goal(NamedTuple):
    """Minimisation of w_T (T - T*)² + w_K (K - K*)² + ρ ‖P - P_ref‖² with constant `kept`."""

    w_T: float
    w_K: float
    rho: float
    kept: str | None = None  # "torque", "stiffness" or nothing


class Answer(NamedTuple):
    """Unverified answer of a back-end for n problems."""

    P1: Array  # [Pa], NaN where the solver failed
    P2: Array
    iterations: NDArray[np.int32]


def goals(problem: Problem) -> tuple[Goal, ...]:
    """Return one weighted goal, or first one target and then, with it kept, the other: the lexicographic priorities."""
    if problem.priority == "torque":
        return Goal(1.0, 0.0, 0.0), Goal(0.0, 1.0, problem.pull, kept="torque")
    if problem.priority == "stiffness":
        return Goal(0.0, 1.0, 0.0), Goal(1.0, 0.0, problem.pull, kept="stiffness")
    return (Goal(*problem.weights, problem.pull),)


def settled(problem: Problem, goal: Goal, P: Array) -> NDArray[np.bool_]:
    """Return whether a goal is settled at P (2, n): a solver failed, it is met, or the kept goal was missed.

    A goal is missed at a single point only, which leaves no choice.
    """
    errors = np.abs(problem.errors(*P)) / problem.scales
    done = np.asarray(np.isnan(P).any(axis=0))
    if not goal.rho:
        unmet = [e > _NOTHING for e, w in zip(errors, (goal.w_T, goal.w_K), strict=True) if w]
        done |= ~np.any(unmet, axis=0)
    if goal.kept is not None:
        done |= errors[0 if goal.kept == "torque" else 1] > OPTIMISER.met
    return done


def start(problem: Problem, warm: bool) -> Array:
    """Return the starting points (2, n) [Pa]: the projected analytic inverse, or the middle of the box.

    The weighted cost of muscles that are not affine has local minima on the edges: the start is then the best of the
    projected inverse and a coarse grid of the box.
    """
    box = problem.box
    middle = (box.agonist.lo + box.agonist.hi) / 2, (box.antagonist.lo + box.antagonist.hi) / 2
    if not warm:
        return np.stack(box.project(*middle))
    P1, P2 = solve_inverse(problem.joint, problem.theta, problem.K_aim, problem.T_aim, problem.shares)
    P1, P2 = np.where(np.isfinite(P1), P1, middle[0]), np.where(np.isfinite(P2), P2, middle[1])
    projected = np.stack(box.project(P1, P2))
    if problem.priority != "weighted" or problem.joint.affine:
        return projected
    candidates = np.concatenate([projected[:, None], _grid(problem)], axis=1)  # (2, m, n)
    (e_T, e_K), (w_T, w_K) = problem.errors(*candidates), problem.weights
    best = np.argmin(w_T * e_T**2 + w_K * e_K**2 + problem.pull_cost(*candidates), axis=0)
    return np.take_along_axis(candidates, best[None, None], axis=1)[:, 0]


def replacement(problem: Problem) -> tuple[Array, Array]:
    """Return the exact answer where a back-end failed, or the projected inverse if there is no exact one."""
    try:
        P1, P2, _ = exact.solve(problem)
        return P1, P2
    except InvalidInput:  # a pull without a closed form
        P1, P2 = start(problem, warm=True)
        return P1, P2


def _grid(problem: Problem) -> Array:
    """Return a grid of points (2, m², n) over the feasible set."""
    share = np.linspace(0.0, 1.0, _GRID)[:, None]
    P1, P2 = (side.lo + share * (side.hi - side.lo) for side in problem.box)  # (m, n)
    shape = (_GRID, _GRID, problem.theta.size)
    corners = np.broadcast_to(P1[:, None], shape), np.broadcast_to(P2[None], shape)
    return np.stack(problem.box.project(*(P.reshape(-1, problem.theta.size) for P in corners)))


Optimiser = Literal["convex", "nlp", "qp"]
OPTIMISERS: tuple[Optimiser, ...] = get_args(Optimiser)


class Solution(NamedTuple):
    """Feasible pressures of n problems, and the back-end's iterations and failures."""

    P1: Array
    P2: Array
    iterations: NDArray[np.int32]
    failed: NDArray[np.bool_]  # whether the back-end's answer was replaced


def optimise(problem: Problem, method: str, solver: str | None, warm_start: bool) -> Solution:
    """Run the back-end `method`, check every answer, and replace those that are not optimal."""
    answer = _run(problem, method, solver, warm_start)
    P1, P2 = _snapped(problem, answer)
    failed = np.asarray(~(certificate.residual(problem, P1, P2) <= CERTIFIED))
    if failed.any():
        P1[failed], P2[failed] = replacement(problem.take(failed))
    return Solution(P1, P2, answer.iterations, failed)


def _run(problem: Problem, method: str, solver: str | None, warm_start: bool) -> Answer:
    """Call `solve` of the module named after the back-end."""
    backend = import_module(f"allocator.allocation.optimisers.{method}")
    answer: Answer = backend.solve(problem, solver, warm_start)
    return answer


def _snapped(problem: Problem, answer: Answer) -> tuple[Array, Array]:
    """Make the answer feasible to the last digit, with pressures next to a bound put on it."""
    near = _SNAP * problem.joint.pressure_span
    P1, P2 = problem.box.project(answer.P1, answer.P2)
    agonist, antagonist = problem.box
    for P, interval in ((P1, agonist), (P2, antagonist)):
        np.copyto(P, interval.lo, where=P - interval.lo < near)
        np.copyto(P, interval.hi, where=interval.hi - P < near)
    return problem.box.project(P1, P2)
