"""The QP is solved by an interior point on Riccati recursions where the sweeps do not settle, rows and slacks included.

Mehrotra's predictor and corrector (S. Mehrotra, SIAM J. Optimization 2, 1992) on the recursion, as in HPIPM (G. Frison
and M. Diehl, IFAC-PapersOnLine 53, 2020): O(N) an iteration, and MOST iterations at most. An answer is one only if it
passes the certificate of `mpc.tracking.qp.programme`, with the iteration's own multipliers, ½ rᵀH⁻¹r taken as the
greater ½|r|²/c. What is found to bind where only changes have bounds may be handed back to the sweeps, `binding`, which
come to the same point to all digits.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import assign, inlined
from mpc.tracking.compiled.newton import ALL, BOUNDS, Factors, adjoint, direction, factorise, gradients, left_over
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.riccati import FREE, LOWER, UPPER, Sweep, settled
from mpc.tracking.compiled.rows import (
    Rows,
    aim_at,
    begin,
    bring_near,
    go,
    measure,
    products_after,
    row_steps,
    sides,
)

MOST = 60  # iterations
PRIMAL = 1e-7  # by which a row may be off at the end [bar], [rad], [N]
GAP = 1e-3  # [-] of the gap that may be: the aim, which grows tenfold
TRIES = 16  # with each iteration at it whose proof is hidden by rounding, as often at most
SHORT = 0.995  # of the way to the boundary
BINDS = 1e3  # λ/t of rows that bind [cost]/[bar]²
SHOWS = 100.0  # [-] of the gap that may be: below, what binds begins to show


class Work(NamedTuple):
    """What an iteration works with."""

    rows: Rows
    factors: Factors
    by: Point
    sweep: Sweep
    gx: Array  # this and the two below are those of the sweep
    gv: Array
    r: Array  # (N, 2)
    first: Array  # (N, 2) gradient of the cost at the origin
    origin_x: Array  # that by ξ and v, as `gradients` sets them
    origin_v: Array


@inlined
def new_point(N: int) -> Point:
    """Return a point that is not set yet."""
    return Point(np.empty((N + 1, 6)), np.empty((N, 2)), np.zeros(2))


@inlined
def new_work(N: int, sweep: Sweep) -> Work:
    """Return the arrays of an iteration, some of which are those of a sweep."""
    lines = np.empty((8, N + 1, ALL))
    span = np.empty((N + 1, 2), np.int64)
    rows = Rows(span, lines[0], lines[1], lines[2], lines[3], lines[4], lines[5], lines[6], lines[7])
    factors = Factors(sweep.R, sweep.feedback, np.empty((N, 2, 2)), sweep.D, np.empty(3))
    first, origin_x, origin_v = np.empty((N, 2)), np.empty((N + 1, 6)), np.empty((N, 2))
    return Work(rows, factors, new_point(N), sweep, sweep.gx, sweep.gv, sweep.r, first, origin_x, origin_v)


@inlined
def gap_of(path: Path, setting: Setting, at: Point, there: Any, total: float, count: int, work: Work) -> float:
    """Return what the point costs above the least cost, at most, its products being `total` in sum."""
    square, slack = 0.0, setting.slack
    c0, c1 = left_over(path, slack, at, work.gx, work.gv, work.rows.multiplier, count, work.r)
    for k in range(there.size):
        if there[k]:
            square += work.r[k, 0] ** 2 + work.r[k, 1] ** 2
    square /= setting.curvature
    return total + 0.5 * (square + (c0**2 / slack[1] + c1**2 / slack[3] if count == ALL else 0.0))


@inlined
def fall_to(path: Path, setting: Setting, at: Point, there: Any, work: Work) -> float:
    """Return by how much the cost without slacks is less at the point than at the origin."""
    fall = 0.0
    adjoint(path, work.gx, work.gv, work.r)
    for k in range(there.size):
        if there[k]:
            fall -= (work.first[k, 0] + work.r[k, 0]) * at.v[k, 0] + (work.first[k, 1] + work.r[k, 1]) * at.v[k, 1]
    return 0.5 * fall


@inlined
def interior(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, count: int, guess: Any,
    at: Point, work: Work, limit: int
) -> int:  # fmt: skip
    """Return after how many iterations `at` is a solution with the first `count` rows, proved; -1: after `limit` none.

    With changes only, BOUNDS, the sweeps are given the set that begins to show.
    """
    rows, slack, cost, there = work.rows, setting.slack, setting.cost, bounded.there
    most = 0.5 * setting.curvature * setting.accuracy**2
    sides(path, u, setting.bounds, bounded, rows.b)
    at.xi[:], at.v[:], at.sigma[:] = 0.0, 0.0, 0.0
    gradients(path, errors, cost, at, work.origin_x, work.origin_v)
    adjoint(path, work.origin_x, work.origin_v, work.first)
    steepest = 1.0
    for k in range(there.size):
        steepest = max(steepest, abs(work.first[k, 0]), abs(work.first[k, 1])) if there[k] else steepest
    number = begin(rows, there, slack, count, steepest * (1.0 if count == ALL else 0.01), at)
    tries = 0
    for iteration in range(limit + 1):
        gradients(path, errors, cost, at, work.gx, work.gv)
        total, worst = measure(path, at, rows, count)
        wanted = min(GAP * 10.0**tries, 0.5) * most
        if worst < PRIMAL and total < most:
            wanted = max(wanted, min(1e-12 * abs(fall_to(path, setting, at, there, work)), most))
            if total < wanted:
                if gap_of(path, setting, at, there, total, count, work) < (wanted if tries == 0 else most):
                    return iteration
                tries += 1
                if tries == TRIES:
                    break
        if iteration == limit or not np.isfinite(total):
            break
        if count == BOUNDS and total < SHOWS * most:
            binding(rows, setting.starts, guess)
            if settled(path, setting, work.origin_x, work.origin_v, bounded, guess, 2, work.by, work.sweep):
                assign(at.xi, work.by.xi)
                assign(at.v, work.by.v)
                return iteration
        factorise(path, cost, slack, rows.W, there, count, work.factors)
        direction(path, work.factors, slack, at, work.gx, work.gv, rows.push, count, work.by)
        free = products_after(rows, row_steps(path, rows, count, work.by)) / total
        aim_at(rows, max(min(free**3, 1.0) * total, 0.1 * wanted) / number)
        direction(path, work.factors, slack, at, work.gx, work.gv, rows.push, count, work.by)
        step = min(1.0, SHORT * row_steps(path, rows, count, work.by))
        bring_near(rows, slack, go(rows, step, at, work.by) / number)
    return -1


@inlined
def binding(rows: Rows, starts: Any, guess: Any) -> None:
    """Set `guess` (n,) to the bounds of the changes that bind."""
    for block in range(starts.size):
        k = starts[block]
        for i in range(2):
            above = rows.multiplier[k, i] > BINDS * rows.t[k, i]
            below = rows.multiplier[k, 2 + i] > BINDS * rows.t[k, 2 + i]
            guess[2 * block + i] = UPPER if above else LOWER if below else FREE


__all__ = ["MOST", "Work", "binding", "interior", "new_point", "new_work"]
