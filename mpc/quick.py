"""A step's linearisation, condensing and proof in compiled code: microseconds where `mpc.linearise` takes tens.

The QP is solved by DAQP with its simple bounds only, beginning from the bounds that bound in the last sample's plan. If
that answer keeps all rows and is proved optimal it is the QP's, and the step is done; if it breaks rows the whole QP
is handed back, which is the same as `mpc.condense` gives.
"""

from dataclasses import dataclass, field
from math import inf, isfinite
from time import perf_counter
from typing import Any, NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.certified import GAP_TOLERANCE, LAZY_TOLERANCE, PRIMAL_TOLERANCE
from mpc.condense import SLACKS, Problem
from mpc.feedforward import FeedForward
from mpc.linearise import Motion
from mpc.plant import NU, NX, Plant
from mpc.qp import QP

_ACTIVE, _AT_LOWER = 1, 2  # DAQP's marks of a bound
_TOLERANCES = (LAZY_TOLERANCE, PRIMAL_TOLERANCE, GAP_TOLERANCE)


class Quick(NamedTuple):
    """What came of it: the motion under the optimal commands, or else the QP that has still to be solved, if any."""

    motion: Motion | None
    u: Array  # (N, 2) the commands that the QP is about [Pa]
    qp: QP | None
    times: tuple[float, float]  # of building and solving [s]


class QuickStep:
    """The compiled step of a controller. Its buffers belong to it: it must not be called by two threads at a time."""

    def __init__(self, plant: Plant, dt: float, problem: Problem) -> None:
        """Raises ImportError or OSError where there is no numba or nowhere to keep what it compiles."""
        from mpc.compiled.module import law

        self._law = law(plant, dt)
        self._problem, self._setting = problem, setting(problem, self._law.substeps)
        N, n = sum(problem.blocks), NU * len(problem.blocks)
        self._given = _Given.of(N)
        self._no_rows = np.zeros((0, n))
        self.reset()

    def reset(self) -> None:
        """Forget which bounds bound."""
        self._marks = np.zeros(self._no_rows.shape[1], np.intc)

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, u_last: Array, u_star_last: Array, limit: float = inf
    ) -> Quick:
        """One QP about the commands `u` (N, 2) from `x` (4,) under the torques `d` (N,); DAQP may take `limit` [s]."""
        import daqp

        began = perf_counter()
        given, functions = self._given, self._law.module
        given.take(x, u, d, feed, u_last, u_star_last)
        path, ubar, box = functions.prepare(self._law.c, self._setting, *given.arguments)
        built = perf_counter()
        seconds = limit if isfinite(limit) else 0.0  # 0: as long as it takes
        z, _, flag, info = daqp.solve(
            box.H, box.f, self._no_rows, box.upper, box.lower, self._marks, time_limit=seconds
        )
        multipliers = info["lam"]
        outcome, moved, x_new, y = functions.finish(
            self._law.c, self._setting, path, ubar, box, z, multipliers, given.last[0], given.d, _TOLERANCES
        )
        times = built - began, perf_counter() - built
        if flag > 0 and outcome == functions.SOLVED:
            self._marks = _shifted(multipliers)
            return Quick(Motion(moved, x_new, y[:, 0], y[:, 1:]), moved, None, times)
        self.reset()
        return Quick(None, ubar * BAR, self._whole(path, ubar, box), times)

    def _whole(self, path: Any, ubar: Array, box: Any) -> QP:
        """The QP with its slacks and rows."""
        from mpc.compiled.condensing import rows

        weights, n = self._problem.weights, box.f.size
        H = np.zeros((n + SLACKS, n + SLACKS))
        H[:n, :n], H[n, n], H[n + 1, n + 1] = box.H, weights.slack_square, weights.slack_force_square
        f = np.append(box.f, [weights.slack, weights.slack_force])
        lower, upper = np.append(box.lower, SLACKS * [0.0]), np.append(box.upper, SLACKS * [inf])
        return QP(H, f, lower, upper, *rows(path, ubar, self._setting))


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

    def take(self, x: Array, u: Array, d: Array, feed: FeedForward, u_last: Array, u_star_last: Array) -> None:
        self.x[:], self.u[:], self.d[:], self.last[0], self.last[1] = x, u, d, u_last, u_star_last
        wish = self.wish
        wish.theta[:], wish.omega[:], wish.K[:], wish.P[:], wish.u[:] = feed.theta, feed.omega, feed.K, feed.P, feed.u


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


def _shifted(multipliers: Array) -> Any:
    """DAQP's marks of the bounds that bind if the next sample's are this one's moved on by one block."""
    marks = np.where(multipliers > 0, _ACTIVE, np.where(multipliers < 0, _ACTIVE | _AT_LOWER, 0)).astype(np.intc)
    marks[:-NU] = marks[NU:]
    return marks


__all__ = ["Quick", "QuickStep", "setting"]
