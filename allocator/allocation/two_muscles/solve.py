"""Answers of `allocate` for two muscles: choice of the method, and its repetition for valves, friction and plans.

A method solves a `Problem`. Free valves, friction and a planned trajectory wrap it:

* With free valves the trapped gas of each state of the valves is part of its stiffness, so the four states are four
  ordinary problems. The best of the four answers is returned.
* With friction the link gets T only if the muscles give T + μ s (a1 F1 + a2 F2), which depends on the pressures that
  give it. Inserted and allocated again, this torque changes by at most a share μ each time (its derivative along either
  pressure is ± μ s), so the iteration is a contraction.
* Along a trajectory several pairs may give the same torque and stiffness. If they are chosen sample by sample, a branch
  of pairs may end at a limit, where the pressures must jump. Dynamic programming over the pairs of all samples jumps
  only where necessary.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from allocator import checks, search
from allocator.allocation.arguments import Asked, Method, Name, checked_direction, problem_from
from allocator.allocation.optimisers import backends
from allocator.allocation.result import as_status, shaped
from allocator.allocation.status import CLOSED_FORM, OPTIMISER, UNCERTAIN, Status
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.certificate import Assessment, assess, assess_inverse
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.two_muscles.result import PairAllocation
from allocator.allocation.uncertain.spread import with_covariance
from allocator.calculus import Array, Mask, Value
from allocator.closed_form import solve_inverse
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import HELD, StiffnessKind, of_a_joint
from allocator.joint.limits import Limits
from allocator.joint.torque_levels import Pair

METHODS: tuple[Name, ...] = get_args(Name)
Solve = Callable[[Problem], PairAllocation]

_TOLERANCE = 1e-10  # of the greatest torque
_ROUNDS = 60
_FIELDS = ("P1", "P2", "T", "K", "status", "limits", "iterations", "_gap")
_SAME = 1e-12  # of a cost: rounding


def allocated(joint: AntagonistJoint, asked: Asked) -> PairAllocation:
    """Return the allocation of two muscles without a kernel. Raises as `allocate`."""
    chosen, kind = _checked_method(asked.method), of_a_joint(asked.stiffness, joint.gas, joint.affine)
    _check_together(kind, chosen, asked.along)
    if chosen.uncertainty is not None:
        joint = with_covariance(joint, chosen.uncertainty)
    s = checked_direction(asked.direction)
    T = checks.broadcast(T=checks.real("T", asked.T, "N·m"), direction=s)[0] if s.ndim else asked.T
    problem, angles = problem_from(
        *(joint, asked.theta, asked.K, T),
        limits=asked.limits,
        priority=asked.priority,
        weights=asked.weights,
        tolerance=asked.stiffness.tolerance,
        pull=asked.pull,
        shares=None if kind.shares is None else kind.fixed,
        felt=kind.secant(joint.loop) if kind.amplitude is not None else None,
    )
    solve = _solver(chosen, angles, _axis(asked.along, angles.ndim, chosen, asked.limits))
    answer = partial(_answer, solve=solve, kind=kind)
    if not (joint.friction and s.any()):
        return answer(problem)
    return with_friction(answer, problem, np.broadcast_to(s, angles.shape).ravel())


def _solver(method: Method, asked: Array, along: int | None) -> Solve:
    """Return the solver for problems at the given angles."""
    if method.name == "exact":
        return partial(_exact, asked=asked, along=along)
    if method.name == "analytic":
        return partial(_inverted, asked=asked)
    if method.uncertainty is not None:
        return partial(_uncertain, asked=asked, risk=method.risk)
    return partial(_optimised, asked=asked, method=method)


def _answer(problem: Problem, solve: Solve, kind: StiffnessKind) -> PairAllocation:
    """Return the answer of `solve` for the requested kind of stiffness; free valves are in their best state."""
    if kind.shares is None:
        return with_free_valves(solve, problem, kind)
    found = solve(problem)
    return found if kind is HELD else replace(found, kind=kind)


def _checked_method(chosen: Method) -> Method:
    """Return the method. Raises for unknown methods, and for options of other methods."""
    if chosen.name not in METHODS:
        raise MissingBackend("method", chosen.name, METHODS)
    if chosen.solver is not None and chosen.name not in backends.OPTIMISERS:
        raise InvalidInput(
            f"solver = {chosen.solver!r} belongs to the methods {', '.join(backends.OPTIMISERS)}, not {chosen.name!r}"
        )
    if chosen.uncertainty is not None and (chosen.name != "convex" or chosen.solver is not None):
        raise InvalidInput("uncertainty belongs to method='convex' with its default solver")
    return chosen


def _check_together(kind: StiffnessKind, method: Method, along: object) -> None:
    """Raise `InvalidInput` for options without an answer for a stiffness with trapped gas."""
    if kind is HELD:
        return
    if method.uncertainty is not None:
        raise InvalidInput(
            f"uncertainty is for the isobaric stiffness: it does not know what a {kind.name} stiffness "
            "owes to the muscles' volumes; leave out valves and frequency"
        )
    if kind.amplitude is not None and (method.name != "exact" or along is not None):
        raise InvalidInput(
            f"a stiffness felt by a push is allocated by method='exact' and without along, not by {method.name!r}"
            if along is None
            else "along plans pressures for a stiffness without hysteresis; leave out along or amplitude"
        )
    if kind.shares is None and method.name == "analytic":
        raise InvalidInput(
            "method='analytic' knows no limits by which to choose valves; give a state instead of 'free'"
        )
    if kind.shares is None and along is not None:
        raise InvalidInput("along plans pressures for valves that stay as they are; give a state instead of 'free'")


def _axis(along: object, ndim: int, method: Method, limits: Limits) -> int | None:
    """Return the axis of time, counted from 0."""
    if along is None:
        return None
    if method.name != "exact" or limits.previous is not None:
        raise InvalidInput(
            "along plans the exact answers of a whole trajectory: without previous, and by no other method"
        )
    return checks.axis("along", along, ndim)


def _exact(problem: Problem, asked: Array, along: int | None) -> PairAllocation:
    P1, P2, gap = exact.solve(problem)
    if along is not None:
        met = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel())).status == Status.EXACT
        P1, P2 = planned(problem, P1, P2, met, asked.shape, along)
    found = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel()))
    return _allocation(problem, asked, P1, P2, found, "exact", gap=gap)


def _inverted(problem: Problem, asked: Array) -> PairAllocation:
    problem = problem.at(asked.ravel())  # no limit, not even the joint's range
    P1, P2 = solve_inverse(problem.joint, problem.theta, problem.K, problem.T, problem.shares)
    found = assess_inverse(problem, P1, P2, problem.joint.outside_range(problem.theta))
    return _allocation(problem, asked, P1, P2, found, "analytic", gap=np.full(P1.shape, np.nan))


def _optimised(problem: Problem, asked: Array, method: Method) -> PairAllocation:
    P1, P2, iterations, failed = backends.optimise(problem, method.name, method.solver, method.warm_start)
    found = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel()), OPTIMISER)
    found = found._replace(status=np.where(failed, np.int8(Status.SOLVER_FAILED), found.status))
    return _allocation(problem, asked, P1, P2, found, method.name, gap=None, iterations=iterations)


def _uncertain(problem: Problem, asked: Array, risk: float) -> PairAllocation:
    from allocator.allocation.uncertain import chance

    P1, P2, iterations, failed, box, infeasible = chance.optimise(problem, risk)
    outside = problem.joint.outside_range(asked.ravel())
    found = assess(problem, P1, P2, outside, OPTIMISER)
    missed = np.isin(found.status, (Status.TORQUE_LIMITED, Status.STIFFNESS_LIMITED, Status.BOTH_LIMITED))
    status = np.where(missed, np.int8(Status.HEDGED), found.status)
    status = np.where(failed, np.int8(Status.SOLVER_FAILED), status)
    limits = box.binding(P1, P2, UNCERTAIN.binds * problem.joint.pressure_span) | outside
    found = found._replace(status=np.where(infeasible, np.int8(Status.TOO_RISKY), status), limits=limits)
    gap = np.full(P1.shape, np.nan)
    return _allocation(problem, asked, P1, P2, found, "uncertain", gap=gap, iterations=iterations)


def _allocation(
    problem: Problem,
    asked: Array,
    P1: Array,
    P2: Array,
    found: Assessment,
    method: str,
    *,
    gap: Array | None,
    iterations: NDArray[np.int32] | None = None,
) -> PairAllocation:
    shape = asked.shape

    def form(array: NDArray[Any]) -> Any:
        return shaped(array, shape)

    return PairAllocation(
        theta=form(asked.ravel()),
        T_target=form(problem.T),
        K_target=form(problem.K),
        P1=form(P1),
        P2=form(P2),
        T=form(found.T),
        K=form(found.K),
        status=as_status(found.status, shape),
        limits=form(found.limits),
        _gap=None if gap is None else form(gap),
        method=method,
        iterations=None if iterations is None else form(iterations),
        joint=problem.joint,
        priority=problem.priority,
        _within=problem.limits,
        _built=problem,
        _shape=shape,
    )


# --- friction ---------------------------------------------------------------------------------------------------------


def with_friction(solve: Callable[[Problem], PairAllocation], problem: Problem, s: Array) -> PairAllocation:
    """Return the answer of `solve` that gives the link the torque of `problem` as it moves in directions `s` (n,)."""
    wanted, mu = problem.T, problem.joint.friction
    for _ in range(_ROUNDS):
        found = solve(problem)
        agonist, antagonist = found.torques
        lost = mu * s * (agonist - antagonist)  # a1 F1 + a2 F2
        needed = np.where(np.isfinite(lost), wanted + lost, wanted)  # NaN: no answer to correct
        if np.abs(needed - problem.T).max(initial=0.0) <= _TOLERANCE * max(np.abs(needed).max(initial=0.0), 1.0):
            return found
        problem = replace(problem, T=needed)
    raise InvalidInput(f"friction = {mu:g} takes more than the muscles can add at these targets")


# --- free valves ------------------------------------------------------------------------------------------------------


def with_free_valves(
    solve: Callable[[Problem], PairAllocation], problem: Problem, kind: StiffnessKind
) -> PairAllocation:
    """Return the best of the answers of `solve` to `problem` in each state of the valves.

    The best is nearest to the targets by their priority; among equals it has the least sum of pressures, then the first
    state of `StiffnessKind.free`, where open valves come first.
    """
    answers = [solve(problem.with_shares(shares)) for shares in StiffnessKind.free]
    chosen = _best(problem, answers)
    fields = {name: _selected([getattr(a, name) for a in answers], chosen, answers[0]._shape) for name in _FIELDS}
    one, two = np.array(StiffnessKind.free)[chosen].T
    return replace(answers[0], **fields, kind=kind, _built=replace(answers[0]._problem, shares=(one, two)))


def _selected(given: list[Value], chosen: NDArray[np.intp], shape: tuple[int, ...]) -> Value:
    """Return the fields of the chosen answers; None if the method does not give the field."""
    if given[0] is None:
        return None
    if not shape:
        return given[int(chosen[0])]
    rows = np.stack([np.ravel(field) for field in given])
    return shaped(np.take_along_axis(rows, chosen[None], 0)[0], shape)


def _best(problem: Problem, answers: list[PairAllocation]) -> NDArray[np.intp]:
    """Return the number of the best answer to each target (n,)."""
    first, second = (np.stack(costs) for costs in zip(*(_costs(problem, a) for a in answers), strict=True))
    widest = problem.with_shares(StiffnessKind.free[-1])
    met = CLOSED_FORM.met if answers[0].method == "exact" else OPTIMISER.met
    T_tie, K_tie = ((met * scale) ** 2 for scale in widest.scales)
    w_T, w_K = problem.weights
    ties = {"torque": (T_tie, K_tie), "stiffness": (K_tie, T_tie)}.get(
        problem.priority, (w_T * T_tie + w_K * K_tie,) * 2
    )
    left = np.ones(first.shape, bool)
    for cost, tie in zip((first, second), ties, strict=True):
        cost = np.where(left, cost, np.inf)
        least = cost.min(axis=0)
        left &= cost <= least + tie + _SAME * least
    pressure = np.stack([np.ravel(a.P1) + np.ravel(a.P2) for a in answers])
    return np.asarray(np.where(left, pressure, np.inf).argmin(axis=0))


def _costs(problem: Problem, a: PairAllocation) -> tuple[Array, Array]:
    """Return the squared costs of an answer by the first and by the second goal, (n,) each."""
    e_T = np.ravel(a.T) - problem.T
    e_K = np.maximum(np.abs(np.ravel(a.K) - problem.K) - problem.stiffness_tolerance, 0.0)
    pulled = problem.pull_cost(np.ravel(a.P1), np.ravel(a.P2))
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        cost = w_T * e_T**2 + w_K * e_K**2 + pulled
        return cost, cost
    return (e_T**2, e_K**2 + pulled) if problem.priority == "torque" else (e_K**2, e_T**2 + pulled)


# --- a trajectory ----------------------------------------------------------------------------------------------------


def planned(problem: Problem, P1: Array, P2: Array, met: Mask, shape: tuple[int, ...], axis: int) -> Pair:
    """Return pairs with the torques and stiffnesses of (P1, P2), with the least sum of squared steps along an axis.

    Pressures of targets that are not `met` are unchanged: the nearest feasible answer is a single pair.
    """
    found = _candidates(problem, P1, P2, met)  # (n, m, 2)
    if not P1.size:
        return P1, P2
    steps = np.moveaxis(found.reshape(*shape, *found.shape[1:]), axis, 0)
    chosen = _least_steps(steps.reshape(shape[axis], -1, *found.shape[1:]))
    back = np.moveaxis(chosen.reshape(*steps.shape[:-2], 2), 0, axis).reshape(-1, 2)
    return back[:, 0], back[:, 1]


def _candidates(problem: Problem, P1: Array, P2: Array, met: Mask) -> Array:
    """Return all pairs of each sample (n, m, 2) [Pa]: the first is (P1, P2), NaN where there are fewer than m."""
    several = met & (exact.determinant_signs(problem) == 0)
    first = np.stack([P1, P2], 1)[:, None]
    if not several.any():
        return first
    part = problem.take(several)
    _, others = search.all_pairs(part.curves, part.T_aim, part.of_muscles(part.K_aim))
    listed = np.full((P1.size, others.shape[1], 2), np.nan)
    listed[several] = others
    return np.concatenate([first, listed], axis=1)


def _least_steps(pairs: Array) -> Array:
    """Return the path through one pair a step with the least sum of squared steps, (steps, k, m, 2) → (steps, k, 2)."""
    steps, k, m, _ = pairs.shape
    came_from = np.zeros((steps, k, m), np.intp)
    cost = np.where(np.isnan(pairs[0, :, :, 0]), np.inf, 0.0)  # (k, m)
    for s in range(1, steps):
        jump = ((pairs[s, :, None] - pairs[s - 1, :, :, None]) ** 2).sum(axis=3)  # (k, from, to)
        total = cost[:, :, None] + np.where(np.isnan(jump), np.inf, jump)
        came_from[s] = total.argmin(axis=1)
        cost = total.min(axis=1)
    at, path, each = cost.argmin(axis=1), np.empty((steps, k, 2)), np.arange(k)
    for s in range(steps - 1, -1, -1):
        path[s] = pairs[s, each, at]
        at = came_from[s, each, at]
    return path
