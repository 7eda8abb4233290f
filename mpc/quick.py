"""`mpc.improvement` in compiled code: tens of microseconds where that takes hundreds.

The QP is solved with its simple bounds only, from the guess that those bind which bound in the last sample's plan. If the
answer keeps all rows and is proved optimal (`mpc.compiled.certificate`) it is the QP's, and the step is done; else the
whole QP, the same that `mpc.condense` gives, goes to `mpc.certified`.
"""

from dataclasses import dataclass, field
from math import inf
from time import perf_counter
from typing import Any, Self

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.compiled.translate import Untranslatable
from mpc.certified import GAP_TOLERANCE, LAZY_TOLERANCE, PRIMAL_TOLERANCE, certified
from mpc.condense import SLACKS, Problem
from mpc.feedforward import FeedForward
from mpc.improvement import Before, Improvement, Improver, ReadableImprover
from mpc.linearise import Motion, Predictor
from mpc.plan import PlanStatus
from mpc.plant import NU, NX, Plant
from mpc.qp import QP
from mpc.solvers import Solver

_TOLERANCES = (LAZY_TOLERANCE, PRIMAL_TOLERANCE, GAP_TOLERANCE)


class QuickImprover:
    """For one controller: its buffers must not be used by two threads at a time."""

    def __init__(self, plant: Plant, dt: float, problem: Problem) -> None:
        """Raises `Uncompilable` where there is no numba, or nowhere to keep what it compiles."""
        from mpc.compiled.module import law

        self._law = law(plant, dt)
        self._problem, self._setting = problem, setting(problem, self._law.substeps)
        self._given = _Given.of(sum(problem.blocks))
        self._no_rows, self._no_bounds = np.zeros((0, NU * len(problem.blocks))), np.zeros(0)
        self.reset()
        self._compile()

    def reset(self) -> None:
        """Forget which bounds bound."""
        self._guess: Array | None = None  # multipliers (n,)

    def _compile(self) -> None:
        """Now, and not when the joint is waiting for its first command."""
        from mpc.compiled.condensing import rows

        given, functions, c = self._given, self._law.module, self._law.c
        path, ubar, box = functions.prepare(c, self._setting, *given.arguments)
        nothing = np.zeros_like(box.f)
        functions.finish(c, self._setting, path, ubar, box, nothing, nothing, given.last[0], given.d, _TOLERANCES)
        rows(path, ubar, self._setting)

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before, solve: Solver, deadline: float
    ) -> Improvement:
        """See `mpc.improvement.Improver`."""
        began = perf_counter()
        given, functions, c = self._given, self._law.module, self._law.c
        given.take(x, u, d, feed, before)
        path, ubar, box = functions.prepare(c, self._setting, *given.arguments)
        built = perf_counter()
        qp = QP(*box, self._no_rows, self._no_bounds, self._no_bounds, self._guess)
        found = solve(qp, deadline - built)
        if found is not None and perf_counter() <= deadline:
            outcome, moved, x_new, y = functions.finish(
                c, self._setting, path, ubar, box, *found, given.last[0], given.d, _TOLERANCES
            )
            if outcome == functions.SOLVED:
                self._guess = _moved_on(found[1])
                motion = Motion(moved, x_new, y[:, 0], y[:, 1:])
                return Improvement(PlanStatus.OPTIMAL, moved, motion, qp, (0.0, built - began, perf_counter() - built))
        self.reset()
        return self._whole(path, ubar, box, before, solve, deadline, built - began)

    def _whole(
        self, path: Any, ubar: Array, box: Any, before: Before, solve: Solver, deadline: float, building: float
    ) -> Improvement:
        """The QP with its slacks and rows, and its answer."""
        from mpc.compiled.condensing import rows

        began = perf_counter()
        weights, n = self._problem.weights, box.f.size
        H = np.zeros((n + SLACKS, n + SLACKS))
        H[:n, :n], H[n, n], H[n + 1, n + 1] = box.H, weights.slack_square, weights.slack_force_square
        f = np.append(box.f, [weights.slack, weights.slack_force])
        lower, upper = np.append(box.lower, SLACKS * [0.0]), np.append(box.upper, SLACKS * [inf])
        qp = QP(H, f, lower, upper, *rows(path, ubar, self._setting))
        building += perf_counter() - began
        answer = certified(solve, qp, deadline)
        u = ubar * BAR
        if answer.status is PlanStatus.OPTIMAL:
            u = self._problem.limits.limited(before.u, u + self._problem.E @ answer.z)
        return Improvement(answer.status, u, None, qp, (0.0, building, perf_counter() - began))


@dataclass(frozen=True)
class _Given:
    """Buffers of what changes from step to step, so that numba always meets the same types."""

    x: Array
    u: Array
    d: Array
    wish: Any  # records.Wish
    last: Array = field(default_factory=lambda: np.zeros((2, NU)))

    @classmethod
    def of(cls, N: int) -> Self:
        from mpc.compiled.records import Wish

        row = np.zeros(N + 1)
        wish = Wish(row, row.copy(), row.copy(), np.zeros((N + 1, NU)), np.zeros((N, NU)))
        return cls(np.zeros(NX), np.zeros((N, NU)), np.zeros(N), wish)

    @property
    def arguments(self) -> tuple[Any, ...]:
        return self.x, self.u, self.d, self.wish, self.last

    def take(self, x: Array, u: Array, d: Array, feed: FeedForward, before: Before) -> None:
        self.x[:], self.u[:], self.d[:], self.last[0], self.last[1] = x, u, d, before.u, before.u_star
        wish = self.wish
        wish.theta[:], wish.omega[:], wish.K[:], wish.P[:], wish.u[:] = feed.theta, feed.omega, feed.K, feed.P, feed.u


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
    room = Room(
        float(low / BAR), float(high / BAR), limits.step / BAR, float(limits.theta[0]), float(limits.theta[1]), limits.min_force
    )
    return Setting(cost, room, problem.starts.astype(np.int64), substeps)


def _moved_on(multipliers: Array) -> Array:
    """Of the next sample, if what binds then is what binds now, one block earlier."""
    return np.concatenate([multipliers[NU:], multipliers[-NU:]])


__all__ = ["QuickImprover", "improver", "setting"]
