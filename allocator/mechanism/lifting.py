"""An endpoint with more joints than coordinates is allocated here: K_x is not linear in K, but settles by linearising.

K_x = Gᵀ K G is concave in K, with GᵀdKG for its derivative, where G is how the joints follow the hand (`lifted` in
`allocator.mechanism.endpoint.endpoint`). The problem with G held is problem [M]; where its answer has the G it was
solved with, it satisfies the first-order conditions of the problem with the true K_x.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from allocator.mechanism.batches import Solved
from allocator.mechanism.problem import BoxProblem

_MOST_STEPS = 100
_FULL_STEPS = 40  # before the first is damped
_SETTLED = 1e-11  # of E, which is near 1
_NEAR = 0.8  # share of the last answer in the centre
_HARDLY = 0.7  # of the step before: one that is longer does not settle
_DAMPED, _LEAST_SHARE = 0.8, 0.02


def solve(problem: BoxProblem, method: Callable[[BoxProblem], Solved]) -> tuple[BoxProblem, Solved]:
    """Solve by `method`, an endpoint with more joints than coordinates again until its view of the joints settles.

    Returns the last problem and its answer; where the view does not settle there are 0 rounds, as where `method` fails.
    """
    targets = problem.endpoint
    if targets is None or not targets.redundant:
        return problem, method(problem)
    P, least = np.mean(problem.bounds, axis=0), problem.reference
    K, share, before = problem.joint_stiffness(P), np.ones(problem.size), np.full(problem.size, np.inf)
    for step in range(_MOST_STEPS):
        # a centre between P_ref and the last P, in fixed shares, leads to the same answer by smaller steps
        centre = _NEAR * P + (1 - _NEAR) * least
        targets, _ = targets.relifted(K)
        problem = replace(problem, endpoint=targets, reference=centre)
        solved = method(problem)
        P = problem.pressures(solved.x)
        found = problem.joint_stiffness(P)
        moved = targets.relifted(found)[1]
        if (moved <= _SETTLED).all():
            break
        if step >= _FULL_STEPS:  # what goes to and fro between two sets of binding limits is damped
            share = np.where(moved > _HARDLY * before, np.maximum(_DAMPED * share, _LEAST_SHARE), share)
        K, before = K + share[:, None, None] * (found - K), moved
    return problem, solved._replace(rounds=np.where(moved <= _SETTLED, solved.rounds, 0))
