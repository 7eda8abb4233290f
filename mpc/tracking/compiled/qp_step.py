"""Compiled `mpc.tracking.qp.step`: tens of microseconds instead of hundreds.

The QP is solved sample by sample (`structured_qp.solve`): by a sweep of Riccati recursions with the limits that were
active in the last QP, and an exchange of those that it held wrongly. Other solvers get the same condensed QP as from
the readable step.
"""

from abc import ABC, abstractmethod
from time import perf_counter
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.tracking.compiled.structured_qp.structured import SolvedQP, StructuredQP
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.linearise import Linearisation, Motion
from mpc.tracking.plan import Moved
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.solvers import Riccati, Solver
from mpc.tracking.qp.step import PreviousSample, QPAnswer, dense_answer, structured_answer

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import CompiledPlant  # which imports numba


class CompiledStep(ABC):
    """Compiled step of one controller; two threads must not use its buffers at the same time."""

    implementation = "compiled"
    structured: SolvedQP
    _given: tuple[Any, ...]  # arguments of the constructor
    _problem: TrackingProblem

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Return a copy with its own buffers."""
        other = type(self)(*self._given)
        other.active_set = self.active_set
        return other

    @property
    def active_set(self) -> NDArray[np.int8] | None:
        """Active set (n,): the limits at which changes and commands are held."""
        return self.structured.guess.copy()

    @active_set.setter
    def active_set(self, guess: NDArray[np.int8] | None) -> None:
        if guess is not None:
            self.structured.guess[:] = guess

    def reset(self) -> None:
        """Forget which limits were active."""
        self.structured.reset()

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Solve the QP as `mpc.tracking.qp.step.QPStep` describes."""
        began = perf_counter()
        self._linearise(x, u, d, feed, previous)
        linearised = perf_counter()
        if not isinstance(solve, Riccati):
            return dense_answer(self._problem, self.model, feed, previous, solve, began, deadline)
        proved, (finite, motion) = self._solved(feed, previous, solve.limit), self._rolled_out()
        now = perf_counter()
        times = linearised - began, 0.0, now - linearised
        return structured_answer(proved, finite, motion.u, motion, self.structured.gap, times, now > deadline)

    @property
    @abstractmethod
    def model(self) -> Linearisation:
        """Path as a linearisation of the readable step; copies."""

    @abstractmethod
    def _linearise(self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample) -> None:
        """Linearise about the commands `u` within the limits."""

    @abstractmethod
    def _solved(self, feed: FeedForward, previous: PreviousSample, exchanges: float) -> bool:
        """Solve the structured QP; return whether its `z` is the proved solution, after at most so many exchanges."""

    @abstractmethod
    def _rolled_out(self) -> tuple[bool, Motion]:
        """Return whether the motion of the structured QP's answer is finite, and the motion."""


class CompiledQPStep(CompiledStep):
    """Compiled step of a joint."""

    structured: StructuredQP

    def __init__(self, plant: "CompiledPlant", problem: TrackingProblem) -> None:
        from mpc.tracking.compiled.sample.arrays import StepArrays

        self._given = self.plant, self._problem = plant, problem
        self.structured = StructuredQP(problem)
        self._arrays = StepArrays(plant, sum(problem.blocks), self.structured)
        self._arrays.linearise()  # compiles now rather than at the joint's first command

    @property
    def model(self) -> Linearisation:
        """Path as a linearisation of the readable step; copies."""
        return self.structured.model

    def _linearise(self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample) -> None:
        self.structured.take(x, u, d, feed, previous)
        self._arrays.linearise()

    def _solved(self, feed: FeedForward, previous: PreviousSample, exchanges: float) -> bool:
        return self.structured.solved(exchanges)

    def _rolled_out(self) -> tuple[bool, Motion]:
        made = self._arrays.rollout()[1]
        motion = Motion(made.u, made.x, made.K, made.F)
        return motion.finite, motion


class CompiledFeedForward:
    """Compiled `mpc.tracking.feedforward.InverseDynamics`; the readable one is used if the kernel is not sure."""

    def __init__(self, plant: "CompiledPlant", readable: InverseDynamics) -> None:
        from mpc.tracking.compiled.sample.arrays import StepArrays

        self._plant, self.readable = plant, readable
        self.arrays = StepArrays(plant, len(readable.slopes[0]) - 1, inverse=readable)
        rest = np.zeros(len(readable.slopes[0]))
        self(rest, rest + 1.0, rest)  # compiles it

    def __deepcopy__(self, memo: dict[int, object]) -> "CompiledFeedForward":
        """Return a copy with its own buffers."""
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
