"""Compiled QP step of an arm, with the same results as the readable one.

`Riccati` solves the QP sample by sample, like a joint's (`SizedQP`). Other solvers get the QP of
`mpc.tracking.qp.condense`.
"""

from math import inf
from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import CompiledArm, solve_module
from mpc.tracking.compiled.factory import setting
from mpc.tracking.compiled.qp_step import CompiledStep
from mpc.tracking.compiled.structured_qp.structured import SolvedQP
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.linearise import Linearisation, Motion
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.step import PreviousSample

_REST = 7  # place in `SizedQP._setting` of curvature, exchanges, accuracy


class CompiledArmQPStep(CompiledStep):
    """Compiled step of an arm."""

    structured: "SizedQP"

    def __init__(self, arm: Arm, dt: float, made: CompiledArm, problem: TrackingProblem) -> None:
        self._given = arm, dt, made, problem
        self._step, self._problem = made.step, problem
        N, n, m, size = sum(problem.blocks), arm.n, arm.m, arm.size
        outputs, limits = arm.stiffnesses + m, problem.limits
        self._integration = made.c, made.h, made.decay
        self._bounds = np.array([*limits.pressure, limits.step])
        self._starts, self._kept = problem.starts.astype(np.int64), np.exp(-dt / arm.lags)
        self._u = np.zeros((N, m))
        # copies of the arguments: read-only arrays, such as plans, would need a second compilation
        self._now = np.zeros(size), np.zeros((N, m)), np.zeros((N, n)), np.zeros(m)
        self._path = (
            np.zeros((N + 1, size)),
            np.zeros((N, 2 * n, 2 * n + 2 * m)),
            np.zeros((N + 1, outputs)),
            np.zeros((N + 1, n + m, outputs)),
        )
        self._stiffnesses = arm.stiffnesses
        self.structured = SizedQP(arm, dt, problem)  # for `Riccati`

    def _linearise(self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample) -> None:
        for kept, given in zip(self._now, (x, u, d, previous.u), strict=True):
            kept[:] = given
        x, u, d, u_last = self._now
        self._step.linearise(*self._integration, self._bounds, u_last, x, u, d, self._u, *self._path)

    def _solved(self, feed: FeedForward, previous: PreviousSample, exchanges: float) -> bool:
        return self.structured.solved(self._path, self._u, feed, previous, exchanges)

    def _rolled_out(self) -> tuple[bool, Motion]:
        (x, _, d, u_last), (states, _, y, _) = self._now, self._path
        u, after, outputs = np.empty_like(self._u), np.empty_like(states), np.empty_like(y)
        path = self._bounds, u_last, x, d, self._u, self._starts, self.structured.z
        finite = self._step.rollout(*self._integration, *path, u, after, outputs)
        return finite, Motion(u, after, outputs[:, : self._stiffnesses], outputs[:, self._stiffnesses :])

    @property
    def model(self) -> Linearisation:
        """Path as a linearisation of the readable step; copies."""
        (x, S, y, slope), k = self._path, self._stiffnesses
        N, moving, m = len(S), S.shape[1], self._u.shape[1]
        A, B = np.zeros((N, moving + m, moving + m)), np.zeros((N, moving + m, m))
        A[:, :moving], B[:, :moving] = S[:, :, : moving + m], S[:, :, moving + m :]
        A[:, moving:, moving:], B[:, moving:] = np.diag(self._kept), np.diag(1 - self._kept)
        gradient = np.zeros((N + 1, y.shape[1], moving + m))
        n = moving // 2
        gradient[:, :, :n], gradient[:, :, moving:] = slope[:, :n].swapaxes(1, 2), slope[:, n:].swapaxes(1, 2)
        return Linearisation(
            self._u.copy(), x.copy(), y[:, :k].copy(), y[:, k:].copy(), A, B, gradient[:, :k], gradient[:, k:]
        )


class SizedQP(SolvedQP):
    """Structured QP of one controller of an arm; two threads must not use its arrays at the same time."""

    def __init__(self, arm: Arm, dt: float, problem: TrackingProblem) -> None:
        super().__init__(problem, arm.m)
        self._settle: Any = solve_module(arm).settle_path
        made = setting(problem, in_bar=True)
        low, high, step, *angles, min_force = made.bounds
        self._setting = (
            *made.cost, np.array([low, high, step, min_force]), np.array(angles, float),
            np.array([made.curvature, made.exchanges, made.accuracy]), made.slack, made.starts, np.exp(-dt / arm.lags),
        )  # fmt: skip
        self._last, self.exchanges = np.zeros((2, arm.m)), 0

    def solved(
        self, path: tuple[Array, ...], u: Array, feed: FeedForward, previous: PreviousSample, exchanges: float = inf
    ) -> bool:
        """Solve the QP about a `path` of `step` with the commands `u`; return whether `z` is the proved solution, after
        at most so many `exchanges`. Otherwise it is within slew and supply.
        """
        self.shift(previous)
        self._last[0], self._last[1], self._setting[_REST][1] = *previous, exchanges
        given = *path, u, feed.x, feed.y, feed.u, self._last
        done, self.exchanges = self._settle(*self._setting, *given, self.guess, self.answer)
        return bool(done)
