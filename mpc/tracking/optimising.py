"""A controller that optimises solves QPs about the previous plan, and softens the one that cannot be solved.

It fills in the stage `_optimise` of `mpc.tracking.base`, for a joint and for an arm alike.
"""

from collections.abc import Sequence
from itertools import accumulate, chain, repeat
from time import perf_counter

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.tracking.base import BaseController, Optimised, Situation
from mpc.tracking.limits import LONGEST_HORIZON
from mpc.tracking.plan import PlanStatus, Rung
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.softened import softened
from mpc.tracking.qp.solvers import Solver
from mpc.tracking.qp.step import QPAnswer, QPStep

_BLOCKS = 1, 1, 2, 4, 6  # lengths of the first blocks of an arm; the others are as long as the last of these


class OptimisingController(BaseController):
    """A controller that optimises has the attributes below beyond those of `BaseController`."""

    N: int  # horizon [samples]
    iterations: int  # QPs per step
    blocks: Sequence[int] | None  # lengths of the blocks of samples, N in all
    problem: TrackingProblem
    _qp_step: QPStep
    _solve: Solver

    def _check_settings(self) -> tuple[int, ...]:
        """Check what all of them are set, and return the blocks."""
        self.dt = float(checks.real("dt", self.dt, "s"))
        self.N = checks.count("N", self.N, least=3, most=LONGEST_HORIZON)
        self.iterations = checks.count("iterations", self.iterations, least=1)
        self.patience = checks.not_negative("patience", self.patience, "s")
        self.budget = None if self.budget is None else checks.not_negative("budget", self.budget, "s")
        if self.blocks is None:
            return usual_blocks(self.plant, self.N)
        lengths = tuple(checks.count("a length of blocks", length, least=1) for length in self.blocks)
        if sum(lengths) != self.N:
            raise InvalidInput(f"blocks = {lengths} cover {sum(lengths)} samples, not the N = {self.N} of the horizon")
        return lengths

    def _optimise(self, situation: Situation) -> Optimised:
        """Return the commands after `iterations` QPs, or up to one that failed: then the softened one's."""
        task, feed, previous, deadline = situation
        x, d, u = task.x, task.d[:-1], self.ladder.shift(feed.u)
        best, motion, status, spent = None, None, PlanStatus.OPTIMAL, (0.0, 0.0, 0.0)
        for _ in range(self.iterations):
            if perf_counter() > deadline:
                status = status if best else PlanStatus.LATE
                break
            answer = self._qp_step(x, u, d, feed, previous, self._solve, deadline)
            spent = spent[0] + answer.times[0], spent[1] + answer.times[1], spent[2] + answer.times[2]
            if answer.status is not PlanStatus.OPTIMAL:
                if best is None:
                    best, status = self._softened(answer, previous.u, deadline), answer.status
                break
            u, motion = answer.u, answer.motion
            best = Rung.QP, u
        return Optimised(status, best, motion, spent)

    def _softened(self, answer: QPAnswer, u_last: Array, deadline: float) -> tuple[Rung, Array] | None:
        """Return the next rung, if there is time for it and numbers to work with."""
        if answer.qp is None or answer.status in (PlanStatus.LATE, PlanStatus.NOT_FINITE):
            return None
        if (z := softened(answer.qp, deadline)) is None:
            return None
        return Rung.SOFTENED, self.limits.limited(u_last, answer.u + self.problem.E @ z)


def usual_blocks(plant: Machine, N: int) -> tuple[int, ...]:
    """Return the lengths of blocks, `N` in all: one sample each, of an arm 1, 1, 2, 4, 6, 6, …, the last shortened."""
    if not isinstance(plant, Arm):
        return (1,) * N
    ends = accumulate(chain(_BLOCKS, repeat(_BLOCKS[-1])))
    starts = [0]
    while (end := next(ends)) < N:
        starts.append(end)
    return tuple(np.diff([*starts, N]).tolist())
