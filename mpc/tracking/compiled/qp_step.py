"""The compiled step is `mpc.tracking.qp.step` in compiled code: tens of microseconds where that takes hundreds.

The QP is solved as it is, sample by sample (`structured_qp.solve`): by a sweep of Riccati recursions from the
guess that those bounds bind which bound in the last one, by exchanging what that held wrongly, or by an interior point.
Other solvers are given the same
dense QP as by the readable step, and so is DAQP where the structured one has no proof.
"""

from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.tracking.compiled.structured_qp.structured import StructuredQP
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.linearise import Motion
from mpc.tracking.plan import Moved, PlanStatus
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.solvers import Riccati, Solver
from mpc.tracking.qp.step import PreviousSample, QPAnswer, dense_answer

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import CompiledPlant  # which imports numba


class CompiledQPStep:
    """A compiled step works for one controller: its buffers must not be used by two threads at a time."""

    implementation = "compiled"

    def __init__(self, plant: "CompiledPlant", problem: TrackingProblem) -> None:
        from mpc.tracking.compiled.sample.arrays import StepArrays

        self.plant, self._problem = plant, problem
        self.structured = StructuredQP(problem)
        self._arrays = StepArrays(plant, sum(problem.blocks), self.structured)
        self.linearise()  # compiles now, and not when the joint is waiting for its first command

    def __deepcopy__(self, memo: dict[int, object]) -> "CompiledQPStep":
        """Return one with buffers of its own."""
        other = CompiledQPStep(self.plant, self._problem)
        other.active_set = self.active_set
        return other

    @property
    def active_set(self) -> NDArray[np.int8] | None:
        """The active set (n,) is the sign of the multipliers of the bounds that bound."""
        return self.structured.guess.copy()

    @active_set.setter
    def active_set(self, guess: NDArray[np.int8] | None) -> None:
        if guess is not None:
            self.structured.guess[:] = guess

    def reset(self) -> None:
        """Forget which bounds bound."""
        self.structured.reset()

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Answer as `mpc.tracking.qp.step.QPStep` says."""
        began = perf_counter()
        self.structured.take(x, u, d, feed, previous)
        self.linearise()
        linearised = perf_counter()
        motion = self._rolled_out() if isinstance(solve, Riccati) and self.structured.solved() else None
        if motion is None:
            return dense_answer(self._problem, self.structured.model, feed, previous, solve, began, deadline)
        now = perf_counter()
        if now > deadline:
            return QPAnswer(PlanStatus.LATE, motion.u, None, None, (linearised - began, 0.0, now - linearised))
        return QPAnswer(PlanStatus.OPTIMAL, motion.u, motion, None, (linearised - began, 0.0, now - linearised))

    def linearise(self) -> None:
        """Linearise about what the structured QP was given."""
        self._arrays.linearise()

    def _rolled_out(self) -> Motion | None:
        """Return what the solution leads to, if that is finite."""
        finite, made = self._arrays.rollout()
        return Motion(made.u, made.x, made.K, made.F) if finite else None


class CompiledFeedForward:
    """It is `mpc.tracking.feedforward.InverseDynamics`, which answers itself where the joint's kernel is not sure."""

    def __init__(self, plant: "CompiledPlant", readable: InverseDynamics) -> None:
        from mpc.tracking.compiled.sample.arrays import StepArrays

        self._plant, self.readable = plant, readable
        self.arrays = StepArrays(plant, len(readable.slopes[0]) - 1, inverse=readable)
        rest = np.zeros(len(readable.slopes[0]))
        self(rest, rest + 1.0, rest)  # compiles it

    def __deepcopy__(self, memo: dict[int, object]) -> "CompiledFeedForward":
        """Return one with buffers of its own."""
        return CompiledFeedForward(self._plant, self.readable)

    def __call__(self, theta: Array, K: Array, d: Array) -> FeedForward:
        """Return the feed-forward for `theta` [rad] and `K` [N·m/rad] under torques `d` [N·m], (N+1,)."""
        ask = self.arrays.ask
        ask.theta[:], ask.K[:], ask.torques[:] = theta, K, d
        sure, moved = self.arrays.feed_forward()
        if not sure:
            return self.readable(theta, K, d)
        found = self.arrays.given.reference
        return FeedForward(found.x.copy(), found.y.copy(), found.u.copy(), Moved(*moved.tolist()))
