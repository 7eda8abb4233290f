"""`mpc.tracking.qp_step` in compiled code: tens of microseconds where that takes hundreds.

The QP is solved with its simple bounds only, from the guess that those bind which bound in the last one, by Riccati
recursions (`mpc.tracking.compiled.structured`); where these do not settle, the solver says which bounds bind. If the
answer keeps all rows and is proved optimal (`mpc.tracking.compiled.certificate`) it is the QP's, and the step is done;
else the whole QP, the same that `mpc.tracking.qp.condense` gives, goes to `mpc.tracking.qp.certified`.
"""

from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.notices import notice
from allocator.units import BAR
from mpc.model.plant import NU, Plant
from mpc.tracking.feedforward import FeedForward, FeedForwardLaw
from mpc.tracking.linearise import Motion, Predictor
from mpc.tracking.plan import Moved, PlanStatus
from mpc.tracking.qp.certified import ACCURACY, LAZY_TOLERANCE, certified
from mpc.tracking.qp.condense import SLACKS, Problem
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Solver, daqp
from mpc.tracking.qp_step import Before, Improvement, Improver, ReadableImprover, SlowStep

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import Law  # which imports numba

_SWEEPS = 2  # of the quick solution before the solver is asked
_LINEARISING, _CONDENSING, _SOLVING = range(3)  # places in `Improvement.times`


class QuickImprover:
    """For one controller: its memory must not be used by two threads at a time."""

    implementation = "compiled"

    def __init__(self, law: "Law", problem: Problem) -> None:
        from mpc.tracking.compiled.flat_records import flat, given_in, lengths

        self._law, self._answers, c, _, h, substeps = self._made_from = law
        self._problem = problem
        N, n = sum(problem.blocks), NU * len(problem.blocks)
        given, memory = map(np.zeros, lengths(N))
        views: Any = given_in
        self._given = views.py_func(given)  # to be filled
        numbers, starts = flat(setting(problem)), problem.starts.astype(np.int64)
        self._rest = numbers, starts, given, memory
        self._all = c, h, substeps, *self._rest
        self._no_rows, self._no_bounds = np.zeros((0, n)), np.zeros(0)
        self._guess = np.zeros(n, np.int8)  # sign of the multipliers
        self._before: Before | None = None  # of the sample that the guess is about
        self._onward = _onward(problem.starts)
        self._compile()

    def __deepcopy__(self, memo: dict[int, Any]) -> "QuickImprover":
        """With memory of its own."""
        other = QuickImprover(self._made_from, self._problem)
        other._guess[:] = self._guess
        return other

    @property
    def memory(self) -> NDArray[np.int8] | None:
        """Which bounds bound (n,): the sign of their multipliers."""
        return self._guess.copy()

    @memory.setter
    def memory(self, guess: NDArray[np.int8] | None) -> None:
        if guess is not None:
            self._guess[:] = guess

    def _compile(self) -> None:
        """Now, and not when the joint is waiting for its first command."""
        numbers, starts, _, memory = self._rest
        self._law.prepare(*self._all)
        self._answers.settle(*self._rest, self._guess, 0)
        self._answers.pose(*self._rest)
        self._law.march(*self._all, np.zeros(self._guess.size))
        self._answers.rows(numbers, starts, memory)

    def reset(self) -> None:
        """Forget which bounds bound."""
        self._guess[:] = 0

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before, solve: Solver, deadline: float
    ) -> Improvement:
        """See `mpc.tracking.qp_step.Improver`."""
        watch = _Stopwatch()
        self._begin(before)
        self._take(x, u, d, feed, before)
        self._law.prepare(*self._all)
        watch.book(_LINEARISING)
        outcome, z, found, box = self._answers.REFUSED, None, None, None
        if solve is daqp:
            outcome, z = self._answers.settle(*self._rest, self._guess, _SWEEPS)
            watch.book(_SOLVING)
        if outcome != self._answers.SOLVED:
            box = self._posed()
            watch.book(_CONDENSING)
        if outcome == self._answers.REFUSED and box is not None:
            found = _Once(solve, box, deadline)
            outcome, z = self._confirmed(box, found.first)
            watch.book(_SOLVING)
        motion = self._marched(z) if z is not None and outcome == self._answers.SOLVED else None
        if motion is None or perf_counter() > deadline:
            if outcome != self._answers.ROWS:  # else the guess is right for this QP, and about so for the next one
                self.reset()
            return self._whole(box or self._posed(), before, found or solve, deadline, watch)
        return Improvement(PlanStatus.OPTIMAL, motion.u, motion, box, watch.times)

    def _begin(self, before: Before) -> None:
        """At a new sample the same commands bind as at the last, one sample earlier."""
        if before is not self._before:
            self._before, self._guess[:] = before, self._guess[self._onward]

    def _take(self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before) -> None:
        given, wish = self._given, self._given.wish
        given.x[:], given.u[:], given.d[:], given.last[0], given.last[1] = x, u, d, before.u, before.u_star
        wish.theta[:], wish.omega[:], wish.K[:], wish.P[:], wish.u[:] = feed.theta, feed.omega, feed.K, feed.P, feed.u

    def _posed(self) -> QP:
        """The QP without slacks and rows."""
        H, f, lower, upper = self._answers.pose(*self._rest)
        return QP(H, f, lower, upper, self._no_rows, self._no_bounds, self._no_bounds, self._guess.copy())

    def _confirmed(self, box: QP, found: tuple[Array, Array] | None) -> tuple[int, Array | None]:
        """What the recursions come to from the bounds that bind in the solver's answer, to their own precision."""
        if found is None:
            return self._answers.REFUSED, None
        z, push = found
        pushed = np.abs(push) > self._problem.curvature * np.abs(np.where(push > 0, box.upper, box.lower) - z)
        self._guess[:] = np.where(pushed, np.sign(push), 0)  # of a solver of the interior all push a little
        return self._answers.settle(*self._rest, self._guess, _SWEEPS)  # type: ignore[no-any-return]  # compiled

    def _marched(self, z: Array) -> Motion | None:
        """What `z` leads to, if that is finite."""
        finite, *found = self._law.march(*self._all, z)
        return Motion(*found) if finite else None

    def _whole(self, box: QP, before: Before, solve: Solver, deadline: float, watch: "_Stopwatch") -> Improvement:
        """The QP with its slacks and rows, and its answer."""
        weights, n = self._problem.weights, box.f.size
        H = np.zeros((n + SLACKS, n + SLACKS))
        H[:n, :n], H[n, n], H[n + 1, n + 1] = box.H, weights.slack_square, weights.slack_force_square
        f = np.append(box.f, [weights.slack, weights.slack_force])
        lower, upper = np.append(box.lower, SLACKS * [0.0]), np.append(box.upper, SLACKS * [inf])
        numbers, starts, _, memory = self._rest
        qp = QP(H, f, lower, upper, *self._answers.rows(numbers, starts, memory))
        watch.book(_CONDENSING)
        answer = certified(solve, qp, deadline, self._problem.curvature)
        watch.book(_SOLVING)
        u = self._problem.limits.limited(before.u, self._given.u)
        if answer.status is PlanStatus.OPTIMAL:
            u = self._problem.limits.limited(before.u, u + self._problem.E @ answer.z)
        return Improvement(answer.status, u, None, qp, watch.times)


class _Once:
    """A solver that has answered the QP without rows already, and is not asked the same again."""

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
    """Where the time of an improvement goes."""

    def __init__(self) -> None:
        self._spent, self._now = [0.0, 0.0, 0.0], perf_counter()

    def book(self, kind: int) -> None:
        """The time since the last entry was spent on `kind`."""
        before, self._now = self._now, perf_counter()
        self._spent[kind] += self._now - before

    @property
    def times(self) -> tuple[float, float, float]:
        """See `Improvement.times`."""
        linearising, condensing, solving = self._spent
        return linearising, condensing, solving


def _onward(starts: Array) -> NDArray[np.intp]:
    """For each decision that of the block in which its sample was when it was one later."""
    blocks = np.searchsorted(starts, starts + 1, side="right") - 1
    return (NU * blocks[:, None] + np.arange(NU)).ravel()


class QuickFeedForward:
    """`mpc.tracking.feedforward.FeedForwardLaw`, which answers itself where the joint's kernel is not sure."""

    def __init__(self, law: "Law", readable: FeedForwardLaw) -> None:
        plant = readable.plant
        self._readable, self._follow = readable, law.module.follow
        physics = plant.inertia, plant.damping, plant.gravity_torque, *readable.alpha, *plant.joint.angle_range
        self._fixed = law.c, law.p, np.array([*physics, readable.min_force]), *(D.T.copy() for D in readable.slopes)
        rest = np.zeros(len(readable.slopes[0]))
        self(rest, rest + 1.0, rest)  # compiles it

    def __deepcopy__(self, memo: dict[int, Any]) -> "QuickFeedForward":
        """Itself: nothing in it changes."""
        return self

    def __call__(self, theta: Array, K: Array, d: Array) -> FeedForward:
        """For the previews `theta` [rad] and `K` [N·m/rad] under the torques `d` [N·m], all (N+1,), writable rows."""
        sure, within, omega, reachable, P, u, moved = self._follow(*self._fixed, theta, K, d)
        if not sure:
            return self._readable(theta, K, d)
        return FeedForward(within, omega, reachable, P, u, Moved(*moved.tolist()))


class Workings(NamedTuple):
    """What a `TrackingMPC` works with."""

    improve: Improver
    feed_forward: FeedForwardLaw | QuickFeedForward


def workings(plant: Plant, dt: float, problem: Problem, predictor: Predictor, feed_forward: FeedForwardLaw) -> Workings:
    """The quick ones, compiled and ready; the readable ones, with a `SlowStep` warning, where that fails."""
    try:
        from mpc.tracking.compiled.module import law

        found = law(plant, dt)
        quick = QuickFeedForward(found, feed_forward) if found.p else feed_forward.ready()
        return Workings(QuickImprover(found, problem), quick)
    except Exception as failure:  # no compiler, no place for its work, a law too long, or a fault of the compiler's own
        reason = (str(failure).strip() or type(failure).__name__).splitlines()[0]
    said = f"the controller's step is not compiled and takes about ten times as long: {reason}"
    notice(said, SlowStep)
    return Workings(ReadableImprover(problem, predictor), feed_forward.ready())


def setting(problem: Problem) -> Any:
    """What the compiled functions have to know of `problem`: a `records.Setting`."""
    from mpc.tracking.compiled.records import Cost, Room, Setting

    w, limits, L = problem.weights, problem.limits, problem.L
    units = np.array([1, 1, 1, 1, BAR, BAR])
    end = (L.T @ L) * np.outer(units, units)
    cost = Cost(w.theta, w.omega, w.K, w.u * BAR**2, problem.curvature, end)
    low, high = limits.pressure
    room = Room(low / BAR, high / BAR, limits.step / BAR, *limits.theta, limits.min_force)
    return Setting(cost, room, LAZY_TOLERANCE, ACCURACY, problem.starts.astype(np.int64))


__all__ = ["QuickFeedForward", "QuickImprover", "Workings", "setting", "workings"]
