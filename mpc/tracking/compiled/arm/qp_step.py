"""Compiled QP step of an arm, with the same results as the readable one.

The solver first solves the QP with its simple bounds only. If the answer satisfies all rows and is proved optimal, it
solves the QP. Otherwise `mpc.tracking.qp.certified` solves the whole QP of `mpc.tracking.qp.condense`. `Riccati` solves
the QP sample by sample, like a joint's (`SizedQP`). If that needs the interior point, because many limits bind, the
dense QP is faster and is used for the next `DENSE_FOR` QPs. Both answers are proved optimal, and they are the same,
since the QP is strictly convex.
"""

from math import inf
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import CompiledArm, solve_module
from mpc.tracking.compiled.structured_qp.structured import shifted
from mpc.tracking.cost import Rows
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.linearise import Motion
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.certified import ACCURACY, LAZY_TOLERANCE, certified
from mpc.tracking.qp.condense import SLACKS, TrackingProblem
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Riccati, Solver
from mpc.tracking.qp.step import PreviousSample, QPAnswer

DENSE_FOR = 12  # QPs


def _charged(rows: Rows, n: int, stiffnesses: int) -> Array:
    """Return the weights (2n + stiffnesses + 2m,) of the compiled step, from the table of residuals.

    Raises `InvalidInput` for weights of pressures or muscle forces, which the step does not support.
    """
    if rows.x[2 * n :].any() or rows.y[stiffnesses:].any():
        raise InvalidInput(
            "a weight of `mpc.tracking.cost` charges an arm's pressures or muscle forces, which its compiled step "
            "(mpc/tracking/compiled/arm/step.py) does not know: add it there"
        )
    return np.concatenate([rows.x[: 2 * n], rows.y[:stiffnesses], rows.e, rows.rate])


class CompiledArmQPStep:
    """Compiled step of one controller; two threads must not use its buffers at the same time."""

    implementation = "compiled"

    def __init__(self, arm: Arm, dt: float, made: CompiledArm, problem: TrackingProblem) -> None:
        self._given = arm, dt, made, problem
        self._step, self._problem = made.step, problem
        N, n, m, size, blocks = sum(problem.blocks), arm.n, arm.m, arm.size, len(problem.blocks)
        outputs, z = arm.stiffnesses + m, m * blocks
        limits, starts = problem.limits, problem.starts.astype(np.int64)
        self._integration = made.c, made.h, made.decay
        self._bounds = np.array([*limits.pressure, limits.step])
        self._ranges = np.array(limits.theta, float)
        self._soft = np.array([LAZY_TOLERANCE, ACCURACY * problem.curvature, limits.min_force])
        self._shape = starts, _risen(starts, N, np.exp(-dt / arm.lags))
        rows, charged = problem.rows, _charged(problem.rows, n, arm.stiffnesses)
        E = problem.E[:, :, :-SLACKS]
        rate = np.diff(E, axis=0, prepend=np.zeros((1, m, z)))
        constant = np.einsum("j,kji,kjl->il", rows.e, E, E)
        constant += np.einsum("j,kji,kjl->il", rows.rate, rate, rate) / dt**2
        self._cost = charged, np.ascontiguousarray(problem.L), *self._shape, constant, dt, self._bounds
        self._u = np.zeros((N, m))
        # copies of the arguments: read-only arrays, such as plans, would need a second compilation
        self._now = np.zeros(size), np.zeros((N, m)), np.zeros((N, n)), np.zeros(m), np.zeros(m)
        self._path = (
            np.zeros((N + 1, size)),
            np.zeros((N, 2 * n, 2 * n + 2 * m)),
            np.zeros((N + 1, outputs)),
            np.zeros((N + 1, n + m, outputs)),
        )
        self._G = np.zeros((N + 1, 2 * n, z))
        self._qp = np.zeros((z, z)), np.zeros(z), np.zeros(z), np.zeros(z)
        self._whole_size = N * (2 * m + 2 * n), z + SLACKS
        self._no_rows, self._no_bounds = np.zeros((0, z)), np.zeros(0)
        self._stiffnesses = outputs - m
        self.structured: SizedQP | None = None  # for `Riccati`
        self._dense_for = 0  # remaining QPs to solve as dense ones

    def __deepcopy__(self, memo: dict[int, object]) -> "CompiledArmQPStep":
        """Return a copy with its own buffers."""
        other = CompiledArmQPStep(*self._given)
        other.active_set, other._dense_for = self.active_set, self._dense_for
        return other

    @property
    def active_set(self) -> NDArray[np.int8] | None:
        """Active set (n,): the signs of the active bounds' multipliers, if remembered."""
        return None if self.structured is None else self.structured.guess.copy()

    @active_set.setter
    def active_set(self, guess: NDArray[np.int8] | None) -> None:
        if guess is not None:
            self._structured_qp().guess[:] = guess

    def _structured_qp(self) -> "SizedQP":
        """Return the structured QP, which is compiled on first use."""
        if self.structured is None:
            arm, dt, _, problem = self._given
            self.structured = SizedQP(arm, dt, problem)
        return self.structured

    def reset(self) -> None:
        """Forget which bounds were active."""
        self._dense_for = 0
        if self.structured is not None:
            self.structured.reset()

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Solve the QP as `mpc.tracking.qp.step.QPStep` describes."""
        began = perf_counter()
        for kept, given in zip(self._now, (x, u, d, previous.u, previous.u - previous.u_star), strict=True):
            kept[:] = given
        x, u, d, u_last, e_last = self._now
        self._step.linearise(*self._integration, self._bounds, u_last, x, u, d, self._u, *self._path)
        linearised = perf_counter()
        if isinstance(solve, Riccati) and (motion := self._structured_answer(feed, previous)) is not None:
            now = perf_counter()
            status = PlanStatus.LATE if now > deadline else PlanStatus.OPTIMAL
            return QPAnswer(status, motion.u, motion, None, (linearised - began, 0.0, now - linearised))
        errors = feed.x, feed.y, feed.u, u_last, e_last
        self._step.condense(*self._cost, *self._path, self._u, *errors, self._G, *self._qp)
        condensed = perf_counter()
        box = QP(*self._qp, self._no_rows, self._no_bounds, self._no_bounds)
        found = solve(box, deadline - condensed) if np.isfinite(self._qp[1]).all() else None
        motion = None if found is None else self._finished(found[0])
        solved = perf_counter()
        times = linearised - began, condensed - linearised, solved - condensed
        if motion is not None and solved <= deadline:
            return QPAnswer(PlanStatus.OPTIMAL, motion.u, motion, box, times)
        return self._whole(previous, solve, deadline, times)

    def _structured_answer(self, feed: FeedForward, previous: PreviousSample) -> Motion | None:
        """Return the motion of the structured QP's proved solution; None if there is none, or the dense QP is due."""
        if self._dense_for:
            self._dense_for -= 1
            return None
        structured, (x, _, d, u_last, _), (states, _, y, _) = self._structured_qp(), self._now, self._path
        done = structured.solved(self._path, self._u, feed, previous)
        if not done or structured.iterations:
            self._dense_for = DENSE_FOR
        if not done:
            return None
        u, after, outputs = np.empty_like(self._u), np.empty_like(states), np.empty_like(y)
        path = self._bounds, u_last, x, d, self._u, self._shape[0], structured.z
        if not self._step.rollout(*self._integration, *path, u, after, outputs):
            return None
        return Motion(u, after, outputs[:, : self._stiffnesses], outputs[:, self._stiffnesses :])

    def _finished(self, z: Array) -> Motion | None:
        """Return the commands and the motion of `z`, if `z` is proved to solve the whole QP."""
        (x, _, d, u_last, _), (states, _, y, slope) = self._now, self._path
        u, after, outputs = np.empty_like(self._u), np.empty_like(states), np.empty_like(y)
        path = x, d, u_last, self._u, states, y, slope, self._G
        status = self._step.finish(
            *self._integration, self._bounds, self._soft, self._ranges, *self._shape, *path, *self._qp, z,
            u, after, outputs,
        )  # fmt: skip
        if status != self._step.SOLVED:
            return None
        return Motion(u, after, outputs[:, : self._stiffnesses], outputs[:, self._stiffnesses :])

    def _whole(
        self, previous: PreviousSample, solve: Solver, deadline: float, times: tuple[float, float, float]
    ) -> QPAnswer:
        """Solve the QP with its slacks and rows."""
        began, problem = perf_counter(), self._problem
        qp = self.whole_qp()
        answer = certified(solve, qp, deadline, problem.curvature)
        u = self._u.copy()
        if answer.status is PlanStatus.OPTIMAL:
            u = problem.limits.limited(previous.u, u + problem.E @ answer.z)
        return QPAnswer(answer.status, u, None, qp, (*times[:2], times[2] + perf_counter() - began))

    def whole_qp(self) -> QP:
        """Return the last QP with its slacks and rows."""
        weights, (H, f, lower, upper) = self._problem.weights, self._qp
        states, _, y, slope = self._path
        rows, n = self._whole_size
        R, below, above = np.empty((rows, n)), np.empty(rows), np.empty(rows)
        least = float(self._soft[2])
        path = self._u, states, y, slope, self._G
        self._step.rows_of(self._bounds, least, self._ranges, *self._shape, *path, R, below, above)
        whole = np.zeros((n, n))
        whole[:-SLACKS, :-SLACKS], whole[-2, -2], whole[-1, -1] = H, weights.slack_square, weights.slack_force_square
        f = np.append(f, [weights.slack, weights.slack_force])
        return QP(whole, f, np.append(lower, SLACKS * [0.0]), np.append(upper, SLACKS * [inf]), R, below, above)


def _risen(starts: NDArray[np.int64], N: int, left: Array) -> Array:
    """Return the response of the pressures to the change of a block at every sample (N+1, blocks, m) [Pa/bar].

    `left` (m,) is the remaining share of an error after a sample.
    """
    since = np.maximum(np.arange(N + 1)[:, None] - starts, 0)
    return np.asarray(BAR * (1 - left ** since[..., None]))


class SizedQP:
    """Structured QP of one controller of an arm; two threads must not use its arrays at the same time."""

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
        self.z, self.iterations = np.zeros(self.guess.size), 0  # iterations of the interior point for the last QP
        self._last = np.zeros((2, arm.m))
        self._previous: PreviousSample | None = None  # of the sample of the guess
        self._shifted = shifted(problem.starts, arm.m)

    def solved(self, path: tuple[Array, ...], u: Array, feed: FeedForward, previous: PreviousSample) -> bool:
        """Solve the QP about a `path` of `step` with the commands `u`; return whether `z` is the proved solution."""
        if previous is not self._previous:  # at a new sample the active set moves by one sample
            self._previous, self.guess[:] = previous, self.guess[self._shifted]
        self._last[0], self._last[1] = previous
        given = *path, u, feed.x, feed.y, feed.u, self._last
        done, self.iterations = self._settle(*self._setting, *given, self.guess, self.z)
        return bool(done)

    def reset(self) -> None:
        """Forget which bounds were active."""
        self.guess[:] = 0
