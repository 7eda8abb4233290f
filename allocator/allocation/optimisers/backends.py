"""`optimise` calls a solver of the allocation problem by its name; each is imported only when it is used."""

from importlib import import_module
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from allocator.allocation import certificate
from allocator.allocation.optimisers.common import CERTIFIED, Answer, replacement
from allocator.allocation.problem import Problem
from allocator.calculus import Array

_SNAP = 1e-7  # of the supply range: an optimiser's pressure this near to a bound is meant to be on it

Optimiser = Literal["convex", "nlp", "qp"]
OPTIMISERS: tuple[Optimiser, ...] = get_args(Optimiser)


class Solution(NamedTuple):
    """A `Solution` is feasible pressures of n problems, and what became of the back-end."""

    P1: Array
    P2: Array
    iterations: NDArray[np.int32]
    failed: NDArray[np.bool_]  # where the back-end's answer was replaced


def optimise(problem: Problem, method: str, solver: str | None, warm_start: bool) -> Solution:
    """Run the back-end `method`, check every answer, and replace the ones that are not optimal."""
    answer = _run(problem, method, solver, warm_start)
    P1, P2 = _snapped(problem, answer)
    failed = np.asarray(~(certificate.residual(problem, P1, P2) <= CERTIFIED))
    if failed.any():
        P1[failed], P2[failed] = replacement(problem.take(failed))
    return Solution(P1, P2, answer.iterations, failed)


def _run(problem: Problem, method: str, solver: str | None, warm_start: bool) -> Answer:
    """Call `solve` of the file in this folder that is called as the back-end."""
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
