"""A QP step builds and solves one QP about a sequence of commands: once a sample, or several times.

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
from mpc.tracking.qp.condense import TrackingProblem, condense
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Solver


class SlowStep(UserWarning):
    """A controller's step could not be compiled: the readable one answers, about ten times as slowly."""


class PreviousSample(NamedTuple):
    """The previous sample is what its successor knows of it.

    All QPs of a sample are given the same object, another sample's another one.
    """

    u: Array  # command (2,) [Pa]
    u_star: Array  # its feed-forward (2,) [Pa]


class QPAnswer(NamedTuple):
    """The answer is what became of one QP."""

    status: PlanStatus
    u: Array  # (N, 2) optimal commands within the limits if the status is OPTIMAL, else those that the QP is about [Pa]
    motion: Motion | None  # under them, finite, where it is known already
    qp: QP | None  # None if there was no need to build it
    times: tuple[float, float, float]  # of linearising, condensing, solving with its proof [s]; 0.0: not needed


class QPStep(Protocol):
    """A QP step builds the QP about the commands `u` (N, 2) from `x` (4,) under the torques `d` (N,), and solves it.

    About those within the limits that are nearest to `u`, that is.
    """

    @property
    def implementation(self) -> str:
        """The implementation is "compiled" or "readable"."""

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Answer the QP with `solve`, by `deadline` [s] on the clock of `perf_counter`."""

    def reset(self) -> None:
        """Forget the past."""

    active_set: NDArray[np.int8] | None
    """The active set is what is remembered from sample to sample, for a copy in another process to go on with."""


class ReadableQPStep:
    """The readable step works by NumPy and CasADi."""

    implementation = "readable"
    active_set: NDArray[np.int8] | None = None

    def __init__(self, problem: TrackingProblem, predictor: Predictor) -> None:
        self.problem, self.predictor = problem, predictor

    def reset(self) -> None:
        """Do nothing: nothing is remembered."""

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Answer as `QPStep` says."""
        began = perf_counter()
        u = self.problem.limits.limited(previous.u, u)
        model = self.predictor.linearise(x, u, d)
        linearised = perf_counter()
        qp = condense(self.problem, model, feed, previous.u, previous.u_star)
        condensed = perf_counter()
        answer = certified(solve, qp, deadline, self.problem.curvature)
        if answer.status is PlanStatus.OPTIMAL:
            u = self.problem.limits.limited(previous.u, u + self.problem.E @ answer.z)
        times = linearised - began, condensed - linearised, perf_counter() - condensed
        return QPAnswer(answer.status, u, None, qp, times)


__all__ = ["PreviousSample", "QPAnswer", "QPStep", "ReadableQPStep", "SlowStep"]
