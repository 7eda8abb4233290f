"""`mpc.improvement` in compiled code: tens of microseconds where that takes hundreds.

The QP is solved with its simple bounds only, from the guess that those bind which bound in the last sample's plan. If
the answer keeps all rows and is proved optimal (`mpc.compiled.certificate`) it is the QP's, and the step is done; else
the whole QP, the same that `mpc.condense` gives, goes to `mpc.certified`.
"""

from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.certified import GAP_TOLERANCE, LAZY_TOLERANCE, PRIMAL_TOLERANCE, certified
from mpc.compiled.translate import Untranslatable
from mpc.condense import SLACKS, Problem
from mpc.feedforward import FeedForward, FeedForwardLaw
from mpc.improvement import Before, Improvement, Improver, ReadableImprover
from mpc.linearise import Motion, Predictor
from mpc.plan import Moved, PlanStatus
from mpc.plant import NU, Plant
from mpc.qp import QP
from mpc.solvers import Solver

if TYPE_CHECKING:
    from mpc.compiled.module import Law  # which imports numba

_TOLERANCES = (LAZY_TOLERANCE, PRIMAL_TOLERANCE, GAP_TOLERANCE)


class QuickImprover:
    """For one controller: its memory must not be used by two threads at a time."""

    def __init__(self, law: "Law", problem: Problem) -> None:
        from mpc.compiled.memory import flat, given_in, lengths

        functions, c, _, substeps = law
        self._functions, self._problem = functions, problem
        N, n = sum(problem.blocks), NU * len(problem.blocks)
        given, memory = map(np.zeros, lengths(N))
        self._given = given_in.py_func(given, N)  # views, to be filled
        self._arguments = c, flat(setting(problem, substeps)), problem.starts.astype(np.int64), substeps, given, memory
        self._no_rows, self._no_bounds = np.zeros((0, n)), np.zeros(0)
        self.reset()
        self._compile()

    def _compile(self) -> None:
        """Now, and not when the joint is waiting for its first command."""
        box = self._functions.prepare(*self._arguments)
        self._functions.finish(*self._arguments, *box, np.zeros_like(box[1]), np.zeros_like(box[1]))
        self._rows()

    def reset(self) -> None:
        """Forget which bounds bound."""
        self._guess: Array | None = None  # multipliers (n,)

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before, solve: Solver, deadline: float
    ) -> Improvement:
        """See `mpc.improvement.Improver`."""
        began = perf_counter()
        self._take(x, u, d, feed, before)
        box = self._functions.prepare(*self._arguments)
        built = perf_counter()
        qp = QP(*box, self._no_rows, self._no_bounds, self._no_bounds, self._guess)
        found = solve(qp, deadline - built)
        if found is not None and perf_counter() <= deadline:
            outcome, moved, x_new, K, F = self._functions.finish(*self._arguments, *box, *found)
            if outcome == self._functions.SOLVED:
                self._guess = _moved_on(found[1])
                times = 0.0, built - began, perf_counter() - built
                return Improvement(PlanStatus.OPTIMAL, moved, Motion(moved, x_new, K, F), qp, times)
        self.reset()
        return self._whole(box, before, solve, deadline, built - began)

    def _take(self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before) -> None:
        given, wish = self._given, self._given.wish
        given.x[:], given.u[:], given.d[:], given.last[0], given.last[1] = x, u, d, before.u, before.u_star
        wish.theta[:], wish.omega[:], wish.K[:], wish.P[:], wish.u[:] = feed.theta, feed.omega, feed.K, feed.P, feed.u

    def _whole(
        self, box: tuple[Array, ...], before: Before, solve: Solver, deadline: float, building: float
    ) -> Improvement:
        """The QP with its slacks and rows, and its answer."""
        began = perf_counter()
        weights, n = self._problem.weights, box[1].size
        H = np.zeros((n + SLACKS, n + SLACKS))
        H[:n, :n], H[n, n], H[n + 1, n + 1] = box[0], weights.slack_square, weights.slack_force_square
        f = np.append(box[1], [weights.slack, weights.slack_force])
        lower, upper = np.append(box[2], SLACKS * [0.0]), np.append(box[3], SLACKS * [inf])
        qp = QP(H, f, lower, upper, *self._rows())
        building += perf_counter() - began
        answer = certified(solve, qp, deadline)
        u = self._problem.limits.limited(before.u, self._given.u)
        if answer.status is PlanStatus.OPTIMAL:
            u = self._problem.limits.limited(before.u, u + self._problem.E @ answer.z)
        return Improvement(answer.status, u, None, qp, (0.0, building, perf_counter() - began))

    def _rows(self) -> tuple[Array, Array, Array]:
        from mpc.compiled.condensing import rows

        _, numbers, starts, _, _, memory = self._arguments
        return rows(numbers, starts, memory)


class QuickFeedForward:
    """`mpc.feedforward.FeedForwardLaw`, which answers itself where the joint's kernel is not sure."""

    def __init__(self, law: "Law", readable: FeedForwardLaw) -> None:
        plant = readable.plant
        self._readable, self._follow = readable, law.module.follow
        physics = plant.inertia, plant.damping, plant.gravity_torque, *readable.alpha, *plant.joint.angle_range
        self._fixed = law.c, law.p, np.array([*physics, readable.min_force]), *(D.T.copy() for D in readable.slopes)
        rest = np.zeros(len(readable.slopes[0]))
        self(rest, rest + 1.0, rest)  # compiles it

    def __call__(self, theta: Array, K: Array, d: Array) -> FeedForward:
        """For the previews `theta` [rad] and `K` [N·m/rad] under the torques `d` [N·m], all (N+1,)."""
        sure, *found, moved = self._follow(*self._fixed, np.array(theta), np.array(K), np.array(d))
        return FeedForward(*found, Moved(*moved.tolist())) if sure else self._readable(theta, K, d)


class Workings(NamedTuple):
    """What a `TrackingMPC` works with."""

    improve: Improver
    feed_forward: FeedForwardLaw | QuickFeedForward


def workings(plant: Plant, dt: float, problem: Problem, predictor: Predictor, feed_forward: FeedForwardLaw) -> Workings:
    """The quick ones, compiled and ready; the readable ones where there is no compiler or nowhere to keep its work."""
    try:
        from mpc.compiled.module import law

        found = law(plant, dt)
        return Workings(
            QuickImprover(found, problem), QuickFeedForward(found, feed_forward) if found.p else feed_forward
        )
    except (ImportError, OSError, Untranslatable):
        return Workings(ReadableImprover(problem, predictor), feed_forward)


def setting(problem: Problem, substeps: int) -> Any:
    """What the compiled functions have to know of `problem`: a `records.Setting`."""
    from mpc.compiled.records import Cost, Room, Setting

    w, limits, L = problem.weights, problem.limits, problem.L
    units = np.array([1, 1, 1, 1, BAR, BAR])
    end = (L.T @ L) * np.outer(units, units)
    cost = Cost(w.theta, w.omega, w.K, w.u * BAR**2, w.rate * BAR**2 / problem.dt**2, end)
    low, high = limits.pressure
    room = Room(low / BAR, high / BAR, limits.step / BAR, *limits.theta, limits.min_force)
    return Setting(cost, room, _TOLERANCES, problem.starts.astype(np.int64), substeps)


def _moved_on(multipliers: Array) -> Array:
    """Of the next sample, if what binds then is what binds now, one block earlier."""
    return np.concatenate([multipliers[NU:], multipliers[-NU:]])


__all__ = ["QuickFeedForward", "QuickImprover", "Workings", "setting", "workings"]
