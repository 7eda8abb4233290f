"""The muscles have to add torque to overcome their friction, for the intended direction of motion s.

The link is to get T, so that the muscles have to give T + μ s (a1 F1 + a2 F2), which depends on the pressures that give
it. Put in and allocated again, it changes by at most a share μ each time (its derivative along either pressure is
± μ s): a contraction, solved by repetition. Every method and limit of `allocate` stays as it is.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from allocator import checks
from allocator.allocation.pair import PairAllocation
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput

_TOLERANCE = 1e-10  # of the greatest torque
_ROUNDS = 60


def checked_direction(direction: object) -> Array:
    """Return directions of motion, between -1 and +1; what lies between is a share, for smooth changes."""
    s = checks.real("direction", direction, "-1 to +1")
    if (wrong := np.abs(s) > 1).any():
        raise InvalidInput(
            f"direction{checks.at(s, wrong)} has to lie between -1 (θ falls) and +1 (θ rises); 0: at rest"
        )
    return s


def with_friction(solve: Callable[[Problem], PairAllocation], problem: Problem, s: Array) -> PairAllocation:
    """Return the answer of `solve` that leaves the torque of `problem` for the link moving in directions `s` (n,)."""
    wanted, mu = problem.T, problem.joint.friction
    for _ in range(_ROUNDS):
        found = solve(problem)
        agonist, antagonist = found.torques
        lost = mu * s * (agonist - antagonist)  # a1 F1 + a2 F2
        needed = np.where(np.isfinite(lost), wanted + lost, wanted)  # NaN: there is no answer to be moved
        if np.abs(needed - problem.T).max(initial=0.0) <= _TOLERANCE * max(np.abs(needed).max(initial=0.0), 1.0):
            return found
        problem = replace(problem, T=needed)
    raise InvalidInput(f"friction = {mu:g} takes more than the muscles can add at these targets")
