"""A controller that optimises solves QPs about the previous plan, and softens the one that cannot be solved.

It fills in the stage `_optimise` of `mpc.tracking.base`, for a joint and for an arm alike.
"""

from time import perf_counter

from allocator.calculus import Array
from mpc.tracking.base import BaseController, Optimised, Situation
from mpc.tracking.plan import PlanStatus, Rung
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.softened import softened
from mpc.tracking.qp.solvers import Solver
from mpc.tracking.qp.step import QPAnswer, QPStep


class OptimisingController(BaseController):
    """A controller that optimises has the attributes below beyond those of `BaseController`."""

    iterations: int  # QPs per step
    problem: TrackingProblem
    _qp_step: QPStep
    _solve: Solver

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
