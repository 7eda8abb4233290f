"""The compiled step is `mpc.tracking.qp.step` in compiled code: tens of microseconds where that takes hundreds.

The QP is solved with its simple bounds only, from the guess that those bind which bound in the last one, by Riccati
recursions (`mpc.tracking.compiled.riccati`); where these do not settle, the solver says which bounds bind. If the
answer keeps all rows and is proved optimal (`mpc.tracking.compiled.certificate`) it is the QP's, and the step is done;
else the whole QP, the same that `mpc.tracking.qp.condense` gives, goes to `mpc.tracking.qp.certified`.
"""

from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.model.plant import NU
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.linearise import Motion
from mpc.tracking.plan import Moved, PlanStatus
from mpc.tracking.qp.certified import certified
from mpc.tracking.qp.condense import SLACKS, TrackingProblem
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import DAQP, Solver
from mpc.tracking.qp.step import PreviousSample, QPAnswer

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import CompiledPlant  # which imports numba
    from mpc.tracking.compiled.records import Setting

_SWEEPS = 2  # of the recursions before the solver is asked
_LINEARISING, _CONDENSING, _SOLVING = range(3)  # places in `QPAnswer.times`


class CompiledQPStep:
    """A compiled step works for one controller: its buffers must not be used by two threads at a time."""

    implementation = "compiled"

    def __init__(self, plant: "CompiledPlant", problem: TrackingProblem, setting: "Setting") -> None:
        from mpc.tracking.compiled.flat_records import flat, given_in, lengths

        self._step, self._solve, c, _, h, substeps = self._plant = plant
        self._problem, self._setting = problem, setting
        N, n = sum(problem.blocks), NU * len(problem.blocks)
        given, buffer = map(np.zeros, lengths(N))
        views: Any = given_in
        self._given = views.py_func(given)  # to be filled
        numbers, starts = flat(setting), setting.starts
        self._rest = numbers, starts, given, buffer
        self._all = c, h, substeps, *self._rest
        self._no_rows, self._no_bounds = np.zeros((0, n)), np.zeros(0)
        self._guess = np.zeros(n, np.int8)  # sign of the multipliers
        self._previous: PreviousSample | None = None  # of the sample that the guess is about
        self._shifted = _shifted(problem.starts)
        self._compile()

    def __deepcopy__(self, memo: dict[int, Any]) -> "CompiledQPStep":
        """Return one with buffers of its own."""
        other = CompiledQPStep(self._plant, self._problem, self._setting)
        other._guess[:] = self._guess
        return other

    @property
    def active_set(self) -> NDArray[np.int8] | None:
        """The active set (n,) is the sign of the multipliers of the bounds that bound."""
        return self._guess.copy()

    @active_set.setter
    def active_set(self, guess: NDArray[np.int8] | None) -> None:
        if guess is not None:
            self._guess[:] = guess

    def _compile(self) -> None:
        """Compile now, and not when the joint is waiting for its first command."""
        numbers, starts, _, buffer = self._rest
        self._step.linearise(*self._all)
        self._solve.settle(*self._rest, self._guess, 0)
        self._solve.build(*self._rest)
        self._step.rollout(*self._all, np.zeros(self._guess.size))
        self._solve.rows(numbers, starts, buffer)

    def reset(self) -> None:
        """Forget which bounds bound."""
        self._guess[:] = 0

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Answer as `mpc.tracking.qp.step.QPStep` says."""
        watch = _Stopwatch()
        if previous is not self._previous:  # at a new sample the same commands bind, one sample earlier
            self._previous, self._guess[:] = previous, self._guess[self._shifted]
        self._take(x, u, d, feed, previous)
        self._step.linearise(*self._all)
        watch.book(_LINEARISING)
        outcome, z, found, box = self._solve.REFUSED, None, None, None
        if isinstance(solve, DAQP):
            outcome, z = self._solve.settle(*self._rest, self._guess, _SWEEPS)
            watch.book(_SOLVING)
        if outcome != self._solve.SOLVED:
            box = self._built()
            watch.book(_CONDENSING)
        if outcome == self._solve.REFUSED and box is not None:
            found = _Once(solve, box, deadline)
            outcome, z = self._confirmed(box, found.first)
            watch.book(_SOLVING)
        motion = self._rolled_out(z) if z is not None and outcome == self._solve.SOLVED else None
        if motion is None or perf_counter() > deadline:
            if outcome != self._solve.ROWS:  # else the guess is right for this QP, and about so for the next one
                self.reset()
            return self._whole(box or self._built(), previous, found or solve, deadline, watch)
        return QPAnswer(PlanStatus.OPTIMAL, motion.u, motion, box, watch.times)

    def _take(self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample) -> None:
        given, reference = self._given, self._given.reference
        given.x[:], given.u[:], given.d[:], given.last[0], given.last[1] = x, u, d, previous.u, previous.u_star
        reference.x[:], reference.y[:], reference.u[:] = feed.x, feed.y, feed.u

    def _built(self) -> QP:
        """Return the QP without slacks and rows."""
        H, f, lower, upper = self._solve.build(*self._rest)
        return QP(H, f, lower, upper, self._no_rows, self._no_bounds, self._no_bounds, self._guess.copy())

    def _confirmed(self, box: QP, found: tuple[Array, Array] | None) -> tuple[int, Array | None]:
        """Return what the recursions come to from the bounds that bind in its answer, to their own precision."""
        if found is None:
            return self._solve.REFUSED, None
        z, push = found
        pushed = np.abs(push) > self._problem.curvature * np.abs(np.where(push > 0, box.upper, box.lower) - z)
        self._guess[:] = np.where(pushed, np.sign(push), 0)  # of a solver of the interior all push a little
        return self._solve.settle(*self._rest, self._guess, _SWEEPS)  # type: ignore[no-any-return]  # compiled

    def _rolled_out(self, z: Array) -> Motion | None:
        """Return what `z` leads to, if that is finite."""
        finite, *found = self._step.rollout(*self._all, z)
        return Motion(*found) if finite else None

    def _whole(
        self, box: QP, previous: PreviousSample, solve: Solver, deadline: float, watch: "_Stopwatch"
    ) -> QPAnswer:
        """Answer the QP with its slacks and rows."""
        weights, n = self._problem.weights, box.f.size
        H = np.zeros((n + SLACKS, n + SLACKS))
        H[:n, :n], H[n, n], H[n + 1, n + 1] = box.H, weights.slack_square, weights.slack_force_square
        f = np.append(box.f, [weights.slack, weights.slack_force])
        lower, upper = np.append(box.lower, SLACKS * [0.0]), np.append(box.upper, SLACKS * [inf])
        numbers, starts, _, buffer = self._rest
        qp = QP(H, f, lower, upper, *self._solve.rows(numbers, starts, buffer))
        watch.book(_CONDENSING)
        answer = certified(solve, qp, deadline, self._problem.curvature)
        watch.book(_SOLVING)
        u = self._problem.limits.limited(previous.u, self._given.u)
        if answer.status is PlanStatus.OPTIMAL:
            u = self._problem.limits.limited(previous.u, u + self._problem.E @ answer.z)
        return QPAnswer(answer.status, u, None, qp, watch.times)


class _Once:
    """A solver that has answered the QP without rows already is not asked the same again."""

    def __init__(self, solve: Solver, box: QP, deadline: float) -> None:
        self.first, self._solve, self._again = solve(box, deadline - perf_counter()), solve, False

    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        if self._again or len(qp.R):
            return self._solve(qp, limit)
        self._again = True
        if self.first is None:
            return None
        z, multipliers = self.first
        return np.append(z, SLACKS * [0.0]), np.append(multipliers, -qp.f[-SLACKS:])  # the slacks stay at their bounds


class _Stopwatch:
    """A stopwatch says where the time of a QP goes."""

    def __init__(self) -> None:
        self._spent, self._now = [0.0, 0.0, 0.0], perf_counter()

    def book(self, kind: int) -> None:
        """Enter the time since the last entry as spent on `kind`."""
        since, self._now = self._now, perf_counter()
        self._spent[kind] += self._now - since

    @property
    def times(self) -> tuple[float, float, float]:
        """The times are those of `QPAnswer.times`."""
        linearising, condensing, solving = self._spent
        return linearising, condensing, solving


def _shifted(starts: Array) -> NDArray[np.intp]:
    """Return for each decision that of the block in which its sample was when it was one later."""
    blocks = np.searchsorted(starts, starts + 1, side="right") - 1
    return (NU * blocks[:, None] + np.arange(NU)).ravel()


class CompiledFeedForward:
    """It is `mpc.tracking.feedforward.InverseDynamics`, which answers itself where the joint's kernel is not sure."""

    def __init__(self, plant: "CompiledPlant", readable: InverseDynamics) -> None:
        known = readable.plant
        self._readable, self._feed_forward = readable, plant.step.feed_forward
        physics = known.inertia, known.damping, known.gravity_torque, *readable.alpha, *known.joint.angle_range
        numbers = np.array([*physics, readable.min_force, *known.lags])
        self._fixed = plant.c, plant.p, numbers, *(D.T.copy() for D in readable.slopes)
        rest = np.zeros(len(readable.slopes[0]))
        self(rest, rest + 1.0, rest)  # compiles it

    def __deepcopy__(self, memo: dict[int, Any]) -> "CompiledFeedForward":
        """Return itself: nothing in it changes."""
        return self

    def __call__(self, theta: Array, K: Array, d: Array) -> FeedForward:
        """Return the feed-forward for `theta` [rad] and `K` [N·m/rad] under torques `d` [N·m], writable (N+1,)."""
        sure, x, y, u, moved = self._feed_forward(*self._fixed, theta, K, d)
        return FeedForward(x, y, u, Moved(*moved.tolist())) if sure else self._readable(theta, K, d)


__all__ = ["CompiledFeedForward", "CompiledQPStep"]
