"""`mpc.improvement` in compiled code: tens of microseconds where that takes hundreds.

The QP is solved with its simple bounds only, from the guess that those bind which bound in the last sample's plan. If
the answer keeps all rows and is proved optimal (`mpc.compiled.certificate`) it is the QP's, and the step is done; else
the whole QP, the same that `mpc.condense` gives, goes to `mpc.certified`.
"""

from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.certified import GAP_TOLERANCE, LAZY_TOLERANCE, PRIMAL_TOLERANCE, certified
from mpc.compiled.translate import Untranslatable
from mpc.condense import SLACKS, Problem
from mpc.feedforward import FeedForward
from mpc.improvement import Before, Improvement, Improver, ReadableImprover
from mpc.linearise import Motion, Predictor
from mpc.plan import PlanStatus
from mpc.plant import NU, Plant
from mpc.qp import QP
from mpc.solvers import Solver

_TOLERANCES = (LAZY_TOLERANCE, PRIMAL_TOLERANCE, GAP_TOLERANCE)


class QuickImprover:
    """For one controller: its memory must not be used by two threads at a time."""

    def __init__(self, plant: Plant, dt: float, problem: Problem) -> None:
        """Raises `ImportError` or `OSError` where there is no numba, or nowhere to keep what it compiles."""
        from mpc.compiled.memory import flat, given_in, lengths
        from mpc.compiled.module import law

        functions, c, substeps = law(plant, dt)
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


def improver(plant: Plant, dt: float, problem: Problem, predictor: Predictor) -> Improver:
    """The quick one, compiled and ready; the readable one where there is no compiler, or nowhere to keep its work."""
    try:
        return QuickImprover(plant, dt, problem)
    except (ImportError, OSError, Untranslatable):
        return ReadableImprover(problem, predictor)


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


__all__ = ["QuickImprover", "improver", "setting"]
