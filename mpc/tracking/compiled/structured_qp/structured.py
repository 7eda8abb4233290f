"""Structured QP of one step: its flat arrays by stages, and its solution.

The compiled code does not depend on the joint, so that a joint whose formulas cannot be compiled can use it as well.
"""

from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.model.plant import NU
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.linearise import Linearisation
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.step import PreviousSample

if TYPE_CHECKING:
    from mpc.tracking.compiled.records import Path


class SolvedQP:
    """Active set and answer of a structured QP of `m` muscles, from sample to sample."""

    def __init__(self, problem: TrackingProblem, m: int) -> None:
        self.guess = np.zeros(m * len(problem.blocks), np.int8)  # active limits
        self.answer = np.zeros(self.guess.size + 1)
        self.z = self.answer[:-1]
        self._previous: PreviousSample | None = None  # of the sample of the guess
        blocks = np.searchsorted(problem.starts, problem.starts + 1, side="right") - 1
        self._shifted = (m * blocks[:, None] + np.arange(m)).ravel()  # the block of a decision one sample later

    def shift(self, previous: PreviousSample) -> None:
        """Move the active set by one sample if `previous` is that of a new one."""
        if previous is not self._previous:
            self._previous, self.guess[:] = previous, self.guess[self._shifted]

    @property
    def gap(self) -> float:
        """Bound of the cost of `z` minus that of the solution."""
        return float(self.answer[-1])

    def reset(self) -> None:
        """Forget which limits were active."""
        self.guess[:] = 0


class StructuredQP(SolvedQP):
    """Structured QP of one controller of a joint; two threads must not use its arrays at the same time."""

    def __init__(self, problem: TrackingProblem) -> None:
        from mpc.codegen.views import flat, in_python
        from mpc.tracking.compiled.factory import setting
        from mpc.tracking.compiled.module import solve_module
        from mpc.tracking.compiled.records import given_in, lengths, path_in

        super().__init__(problem, NU)
        self.problem, self._settle = problem, solve_module().settle
        given, buffer = map(np.zeros, lengths(sum(problem.blocks)))
        self.given = in_python(given_in)(given)  # to be filled
        self.path, self.u = in_python(path_in)(buffer)  # the path and its commands [bar]
        made = setting(problem)
        self.arrays = flat(made), made.starts, given, buffer  # arguments of the compiled functions
        self.counted = np.zeros(1, np.int64)
        self._limit = np.isnan(flat(made._replace(exchanges=nan)))
        self._settle(*self.arrays, self.guess, self.answer)  # compiles it

    def take(self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample) -> None:
        """Store the new data of a step: see `mpc.tracking.qp.step.QPStep`."""
        self.shift(previous)
        given, reference = self.given, self.given.reference
        given.x[:], given.u[:], given.d[:], given.last[0], given.last[1] = x, u, d, previous.u, previous.u_star
        reference.x[:], reference.y[:], reference.u[:] = feed.x, feed.y, feed.u

    def take_model(self, model: Linearisation) -> None:
        """Store the path of the readable linearisation."""
        path: Path = self.path
        path.x[:], path.y[:], path.slope[:] = model.x, model.y, model.slope
        path.A[:], path.B[:], self.u[:] = model.A, BAR * model.B, model.u / BAR

    @property
    def model(self) -> Linearisation:
        """Path in the form of the readable step; copies."""
        path, K, F = self.path, self.path.y[:, 0].copy(), self.path.y[:, 1:].copy()
        C, D = path.slope[:, 0].copy(), path.slope[:, 1:].copy()
        return Linearisation(BAR * self.u, path.x.copy(), K, F, path.A.copy(), path.B / BAR, C, D)

    def solved(self, exchanges: float = inf) -> bool:
        """Solve the QP; return whether `z` is the proved solution, after at most so many `exchanges`. Otherwise it is
        within slew and supply.
        """
        self.arrays[0][self._limit] = exchanges
        done, self.counted[0] = self._settle(*self.arrays, self.guess, self.answer)
        self.arrays[0][self._limit] = inf
        return bool(done)

    @property
    def exchanges(self) -> int:
        """Exchanges of the last QP."""
        return int(self.counted[0])

    @property
    def address(self) -> int:
        """Address of the compiled function that solves the QP, for calls from compiled code."""
        from mpc.tracking.compiled.sample.calls import address_of

        return address_of(self._settle)
