"""One QP about a sequence of commands: what the controller does once a sample, or several times.

This is the readable way, `mpc.tracking.linearise`, `mpc.tracking.qp.condense` and `mpc.tracking.qp.certified` one after
the other; `mpc.tracking.compiled.qp_step` has the same in compiled code.
"""

from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.linearise import Motion, Predictor
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.certified import certified
from mpc.tracking.qp.condense import Problem, condense
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Solver


class SlowStep(UserWarning):
    """A controller's step could not be compiled: the readable one answers, about ten times as slowly."""


class Before(NamedTuple):
    """Of the sample before. All QPs of a sample are given the same object, another sample's another one."""

    u: Array  # command (2,) [Pa]
    u_star: Array  # its feed-forward (2,) [Pa]


class Improvement(NamedTuple):
    """What became of it."""

    status: PlanStatus
    u: Array  # (N, 2) optimal commands within the limits if the status is OPTIMAL, else those that the QP is about [Pa]
    motion: Motion | None  # under them, finite, where it is known already
    qp: QP | None  # None if there was no need to pose it
    times: tuple[float, float, float]  # of linearising, condensing, solving with its proof [s]; 0.0: not needed


class Improver(Protocol):
    """Poses the QP about the commands `u` (N, 2) from `x` (4,) under the torques `d` (N,), and solves it.

    About those within the limits that are nearest to `u`, that is.
    """

    @property
    def implementation(self) -> str:
        """Which one it is: "compiled" or "readable"."""

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before, solve: Solver, deadline: float
    ) -> Improvement:
        """With `solve`, by `deadline` [s] on the clock of `perf_counter`."""

    def reset(self) -> None:
        """Forget the past."""

    memory: NDArray[np.int8] | None
    """What is remembered from sample to sample, for a copy in another process to go on with."""


class ReadableImprover:
    """By NumPy and CasADi."""

    implementation = "readable"
    memory: NDArray[np.int8] | None = None

    def __init__(self, problem: Problem, predictor: Predictor) -> None:
        self.problem, self.predictor = problem, predictor

    def reset(self) -> None:
        """Nothing is remembered."""

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before, solve: Solver, deadline: float
    ) -> Improvement:
        """See `Improver`."""
        began = perf_counter()
        u = self.problem.limits.limited(before.u, u)
        model = self.predictor.linearise(x, u, d)
        linearised = perf_counter()
        qp = condense(self.problem, model, feed, before.u, before.u_star)
        condensed = perf_counter()
        answer = certified(solve, qp, deadline, self.problem.curvature)
        if answer.status is PlanStatus.OPTIMAL:
            u = self.problem.limits.limited(before.u, u + self.problem.E @ answer.z)
        times = linearised - began, condensed - linearised, perf_counter() - condensed
        return Improvement(answer.status, u, None, qp, times)


__all__ = ["Before", "Improvement", "Improver", "ReadableImprover", "SlowStep"]
