"""The structured QP of an arm is that of one step, sample by sample, with the sizes of the arm."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import solve_module
from mpc.tracking.compiled.structured_qp.structured import shifted
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.qp.certified import ACCURACY, LAZY_TOLERANCE
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.step import PreviousSample


class SizedQP:
    """It works for one controller: its arrays must not be used by two threads at a time."""

    def __init__(self, arm: Arm, dt: float, problem: TrackingProblem) -> None:
        self._settle: Any = solve_module(arm).settle_path
        limits, rows, weights = problem.limits, problem.rows, problem.weights
        units = np.concatenate([np.ones(2 * arm.n), np.full(2 * arm.m, BAR)])  # pressures count in bar
        self._setting = (
            rows.x * units[: arm.size] ** 2, rows.y, rows.e * BAR**2, rows.rate * BAR**2 / dt**2,
            (problem.L.T @ problem.L) * np.outer(units, units),
            np.array([*limits.pressure, limits.step, limits.min_force * BAR]) / BAR, np.array(limits.theta, float),
            np.array([problem.curvature, LAZY_TOLERANCE, ACCURACY]),
            np.array([weights.slack, weights.slack_square, weights.slack_force, weights.slack_force_square]),
            problem.starts.astype(np.int64), np.exp(-dt / arm.lags),
        )  # fmt: skip
        self.guess = np.zeros(arm.m * len(problem.blocks), np.int8)  # sign of the multipliers
        self.z, self.iterations = np.zeros(self.guess.size), 0  # of the interior point for the last QP
        self._last = np.zeros((2, arm.m))
        self._previous: PreviousSample | None = None  # of the sample that the guess is about
        self._shifted = shifted(problem.starts, arm.m)

    def solved(self, path: tuple[Array, ...], u: Array, feed: FeedForward, previous: PreviousSample) -> bool:
        """Return whether `z` is now the proved solution about a path as `step` linearises it, with the commands `u`."""
        if previous is not self._previous:  # at a new sample the same commands bind, one sample earlier
            self._previous, self.guess[:] = previous, self.guess[self._shifted]
        self._last[0], self._last[1] = previous
        given = *path, u, feed.x, feed.y, feed.u, self._last
        done, self.iterations = self._settle(*self._setting, *given, self.guess, self.z)
        return bool(done)

    def reset(self) -> None:
        """Forget which bounds bound."""
        self.guess[:] = 0
