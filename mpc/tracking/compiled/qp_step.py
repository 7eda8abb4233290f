"""Compiled `mpc.tracking.qp.step`: tens of microseconds instead of hundreds.

The QP is solved sample by sample (`structured_qp.solve`): by a sweep of Riccati recursions with the limits that were
active in the last QP, and an exchange of those that it held wrongly. Other solvers get the same condensed QP as from
the readable step.
"""

from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.tracking.compiled.structured_qp.structured import StructuredQP
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.linearise import Linearisation, Motion
from mpc.tracking.plan import Moved
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.solvers import Riccati, Solver
from mpc.tracking.qp.step import PreviousSample, QPAnswer, dense_answer, structured_answer

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import CompiledPlant  # which imports numba
    from mpc.tracking.compiled.sample.arrays import Feeding


class CompiledQPStep:
    """Compiled step of one controller; two threads must not use its buffers at the same time.

    `structure` makes the structured QP of a problem.
    """

    implementation = "compiled"

    def __init__(
        self,
        plant: "CompiledPlant",
        problem: TrackingProblem,
        structure: Callable[[TrackingProblem], StructuredQP] = StructuredQP,
    ) -> None:
        from mpc.tracking.compiled.sample.arrays import StepArrays

        self._given = self.plant, self._problem, _ = plant, problem, structure
        self.structured = structure(problem)
        self._arrays = StepArrays(plant, sum(problem.blocks), self.structured)
        self._arrays.linearise()  # compiles now rather than at the machine's first command

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
        self.linearise(x, u, d, feed, previous)
        linearised = perf_counter()
        if not isinstance(solve, Riccati):
            return dense_answer(self._problem, self.model, feed, previous, solve, began, deadline)
        proved, (finite, made) = self.structured.solved(solve.limit), self._arrays.rollout()
        motion = Motion(made.u, made.x, self.plant.stiffness(made.K), made.F)
        now = perf_counter()
        times = linearised - began, 0.0, now - linearised
        return structured_answer(proved, finite, motion.u, motion, self.structured.gap, times, now > deadline)

    def linearise(self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample) -> None:
        """Linearise about the commands `u` within the limits, for the structured QP."""
        self.structured.take(x, u, d.ravel(), feed, previous)
        self._arrays.linearise()

    @property
    def model(self) -> Linearisation:
        """Path as a linearisation of the readable step; copies."""
        return self.structured.model


class CompiledFeedForward:
    """Compiled `mpc.tracking.feedforward.InverseDynamics`; the readable one is used if the kernel is not sure."""

    whole = True  # whether it is a part of the whole step

    def __init__(self, plant: "CompiledPlant", readable: InverseDynamics) -> None:
        from mpc.tracking.compiled.sample.arrays import StepArrays

        self.plant, self.readable = plant, readable
        self.feeding = self._feeding(readable)
        self.arrays = StepArrays(plant, len(readable.slopes[0]) - 1, feeding=self.feeding)

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Return a copy with its own buffers."""
        return type(self)(self.plant, self.readable)

    def __call__(self, theta: Array, K: Array, d: Array) -> FeedForward:
        """Return the feed-forward for `theta` [rad] and `K` [N·m/rad] under torques `d` [N·m], (N+1, …)."""
        return self._found(theta, K, d) or self.readable(theta, K, d)

    def _found(self, theta: Array, K: Array, d: Array) -> FeedForward | None:
        """Return the feed-forward, or None if the kernel is not sure."""
        ask = self.arrays.ask
        ask.theta[:], ask.K[:], ask.torques[:] = theta.ravel(), K.ravel(), d.ravel()
        sure, moved = self.arrays.feed_forward()
        if not sure:
            return None
        found = self.arrays.given.reference
        return FeedForward(found.x.copy(), found.y.copy(), found.u.copy(), Moved(*moved.tolist()))

    def _feeding(self, readable: InverseDynamics) -> "Feeding":
        """Return the arrays of the `readable` feed-forward."""
        from mpc.tracking.compiled.sample.arrays import feeding_of

        return feeding_of(readable)
