"""Where the valves are free each target is answered in all four states that they may have, and the best is taken.

The trapped gas of a state is part of its stiffness, so that the states are four ordinary problems, each solved by the
method asked for; what is proved of each holds for the best of them.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.pair import PairAllocation
from allocator.allocation.problem import Problem
from allocator.allocation.result import shaped
from allocator.allocation.status import CLOSED_FORM, OPTIMISER
from allocator.calculus import Array, Value
from allocator.joint.gas import StiffnessKind

_FIELDS = ("P1", "P2", "T", "K", "status", "limits", "iterations", "_gap")
_SAME = 1e-12  # of a cost: rounding


def with_free_valves(
    solve: Callable[[Problem], PairAllocation], problem: Problem, kind: StiffnessKind
) -> PairAllocation:
    """Return the best of the answers of `solve` to `problem` in each state of the valves.

    Best is what comes nearest to the targets by their priority; of answers that are as good the one with the least sum
    of pressures, and of these the first of `StiffnessKind.free`, in which open valves come first.
    """
    answers = [solve(problem.with_shares(shares)) for shares in StiffnessKind.free]
    chosen = _best(problem, answers)
    fields = {name: _selected([getattr(a, name) for a in answers], chosen, answers[0]._shape) for name in _FIELDS}
    one, two = np.array(StiffnessKind.free)[chosen].T
    return replace(answers[0], **fields, kind=kind, _built=replace(answers[0]._problem, shares=(one, two)))


def _selected(given: list[Value], chosen: NDArray[np.intp], shape: tuple[int, ...]) -> Value:
    """Return of the fields of all answers those of the chosen ones; None where the method does not give the field."""
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
    """Return what an answer costs by the first and by the second goal, (n,) each, as squares."""
    e_T = np.ravel(a.T) - problem.T
    e_K = np.maximum(np.abs(np.ravel(a.K) - problem.K) - problem.stiffness_tolerance, 0.0)
    pulled = problem.pull_cost(np.ravel(a.P1), np.ravel(a.P2))
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        cost = w_T * e_T**2 + w_K * e_K**2 + pulled
        return cost, cost
    return (e_T**2, e_K**2 + pulled) if problem.priority == "torque" else (e_K**2, e_T**2 + pulled)
