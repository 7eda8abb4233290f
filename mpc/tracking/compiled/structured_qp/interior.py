"""Interior-point method on Riccati recursions for QPs on which the sweeps do not settle, with rows and slacks.

Mehrotra's predictor and corrector (S. Mehrotra, SIAM J. Optimization 2, 1992) on the recursion, as in HPIPM (G. Frison
and M. Diehl, IFAC-PapersOnLine 53, 2020): O(N) per iteration, and at most MOST iterations. It does not finish by
itself: once the active set begins to show, the sweeps, or with rows `multipliers`, compute the solution to all digits,
multipliers included, and its proof. An interior point's own multipliers, λ up to 1e10 next to distances of 1e-18,
suffer from rounding: with them, one in fifty of the worst QPs had no proof.

Rows that the solution satisfies anyway are left out: they are added when an iterate violates them, and the iteration
goes on. Restarting with them took up to twice as many iterations. The following changes gained at most a tenth:
multipliers improved from the solution without the rows, where the sets cycle; earlier and later checks of the active
set (SHOWS, AGAIN), other products for added rows (LIFT), and other shares of the step (SHORT).
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from mpc.codegen.jit import assign, inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Errors, Indices, Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.certificate import confirmed, needed
from mpc.tracking.compiled.structured_qp.multipliers import GAP, PRIMAL, guess_held, hold_guessed, multiplied
from mpc.tracking.compiled.structured_qp.newton import (
    Factors,
    adjoint,
    direction,
    factorise,
    gradients,
    left_over,
)
from mpc.tracking.compiled.structured_qp.riccati import Sweep, settled
from mpc.tracking.compiled.structured_qp.rows import (
    NEAR,
    Rows,
    add,
    aim_at,
    bring_near,
    go,
    measure,
    none,
    products_after,
    row_steps,
    sides,
)
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, FREE, LOWER, NU, NXI, UPPER

MOST = 60  # iterations
SWEEPS = 2  # from a guessed set
SHORT = 0.995  # [-] of the way to the boundary
BINDS = 1e3  # λ/t of active bounds [cost]/[bar]²
SHOWS = 1e4  # [-] of the allowed gap: sum of the products t λ below which the active set begins to show
AGAIN = 0.1  # [-] of the products at which it did not: below, it is checked again
LEAST = 1e-4  # [-] of the allowed gap: products below are rounding
FEW = 0.01  # [-] of the greatest gradient [cost]/[bar]: products t λ of the changes' rows at first; with all rows, 1
EARLY = 0.1  # [-] of the initial products: below, rows that an iterate violates are added
LIFT = 1e-3  # [-] of the greatest gradient at first: least products of added rows
BEGUN = 1e-3  # [bar], [rad], [N] allowed residual of an iterate there


class Work(NamedTuple):
    """Arrays of an iteration."""

    rows: Rows
    factors: Factors
    by: Point
    sweep: Sweep
    gx: Array  # this and the next two are those of the sweep
    gv: Array
    r: Array  # (N, 2)
    first: Array  # (N, 2) gradient of the cost at the origin
    origin_x: Array  # gradients by ξ and v at the origin, as `gradients` sets them
    origin_v: Array
    trial: Point  # candidate for the solution; in the memory of the three above, which are not needed at the same time


@inlined
def new_point(N: int) -> Point:
    """Return an uninitialised point."""
    return Point(np.empty((N + 1, NXI)), np.empty((N, NU)), np.zeros(2))


@inlined
def new_work(N: int, sweep: Sweep) -> Work:
    """Return the arrays of an iteration, some of them those of a sweep."""
    lines = np.empty((8, N + 1, ALL))
    span = np.empty((N + 1, 2), np.int64)
    rows = Rows(span, lines[0], lines[1], lines[2], lines[3], lines[4], lines[5], lines[6], lines[7])
    factors = Factors(sweep.R, sweep.feedback, np.empty((N, NU, 2)), sweep.D, np.empty(3))
    first, origin_x, origin_v = np.empty((N, NU)), np.empty((N + 1, NXI)), np.empty((N, NU))
    trial = Point(origin_x, origin_v, first[0])
    return Work(rows, factors, new_point(N), sweep, sweep.gx, sweep.gv, sweep.r, first, origin_x, origin_v, trial)


@inlined
def interior(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, count: int, guess: Signs,
    at: Point, work: Work, limit: int
) -> int:  # fmt: skip
    """Return the number of iterations after which `at` is a proved solution; -1: none after `limit`.

    The method begins at the origin with the first `count` rows of every sample; `guess` becomes the active bounds.
    """
    rows, slack, there = work.rows, setting.slack, bounded.there
    most = 0.5 * setting.curvature * setting.accuracy**2
    sides(path, u, setting.bounds, bounded, rows.b)
    steepest = steepest_at_origin(path, errors, setting, there, at, work)
    number = add(path, rows, slack, there, count, steepest * (1.0 if count == ALL else FEW), at)
    shows, early = SHOWS * most, 0.0
    for iteration in range(limit + 1):
        total, worst = measure(path, at, rows, count)
        if iteration == limit or not np.isfinite(total):
            break
        early = EARLY * total if iteration == 0 else early
        gradients(path, errors, setting.cost, at, work.gx, work.gv)
        if total < GAP * most and own_proof(path, setting, u, bounded, total, worst, count, guess, at, work):
            return iteration
        more, tried = count, total < shows and worst < BEGUN
        if tried:
            shows = AGAIN * total
            if finished(path, errors, setting, bounded, count, guess, at, work):
                more = needed(path, setting, u, work.by, setting.tolerance)
                if more <= count:
                    assign(at.xi, work.by.xi)
                    assign(at.v, work.by.v)
                    return iteration
        elif count < ALL and total < early:
            more = needed(path, setting, u, at, BEGUN)
        if more > count:
            product, count, shows = max(total / number, LIFT * steepest), more, SHOWS * most
            bring_near(rows, slack, product / NEAR)
            number = add(path, rows, slack, there, count, product, at)
        if tried or more > count:
            total, worst = measure(path, at, rows, count)
            gradients(path, errors, setting.cost, at, work.gx, work.gv)
        improve(path, setting, there, total, count, number, at, work)
    return -1


@inlined
def improve(
    path: Path, setting: Setting, there: Mask, total: float, count: int, number: int, at: Point, work: Work
) -> None:
    """Take a step from a measured point whose `number` products have the sum `total`."""
    rows, f, by, slack = work.rows, work.factors, work.by, setting.slack
    least = LEAST * 0.5 * setting.curvature * setting.accuracy**2
    factorise(path, setting.cost, slack, rows.W, there, count, f)
    direction(path, f, slack, at, work.gx, work.gv, rows.push, count, by)
    free = products_after(rows, row_steps(path, rows, count, by)) / total
    aim_at(rows, max(min(free**3, 1.0) * total, least) / number)
    direction(path, f, slack, at, work.gx, work.gv, rows.push, count, by)
    step = min(1.0, SHORT * row_steps(path, rows, count, by))
    bring_near(rows, slack, go(rows, step, at, by) / number)


@inlined
def steepest_at_origin(path: Path, errors: Errors, setting: Setting, there: Mask, at: Point, work: Work) -> float:
    """Begin at the origin without rows, and return the greatest entry of the gradient there, at least 1."""
    none(work.rows, at)
    gradients(path, errors, setting.cost, at, work.origin_x, work.origin_v)
    adjoint(path, work.origin_x, work.origin_v, work.first)
    steepest = 1.0
    for k in range(there.size):
        for i in range(NU):
            steepest = max(steepest, abs(work.first[k, i])) if there[k] else steepest
    return steepest


@inlined
def finished(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, count: int, guess: Signs, at: Point, work: Work
) -> bool:
    """Return whether the point `by` of `work`, found from the apparent active set of an iterate, is the proved solution
    with the first `count` rows; W and residuals of the rows are overwritten.
    """
    rows, trial, by, gx, gv, r = work.rows, work.trial, work.by, work.gx, work.gv, work.r
    binding(rows, setting.starts, guess)
    if count == BOUNDS:
        done = settled(path, setting, work.origin_x, work.origin_v, bounded, guess, SWEEPS, by, work.sweep)
        return done and confirmed(path, errors, setting, bounded, by, gx, gv, r)
    assign(trial.xi, at.xi)
    assign(trial.v, at.v)
    assign(trial.sigma, at.sigma)
    assign(rows.change, rows.multiplier)
    hold_guessed(rows, setting.starts, guess)
    done = multiplied(
        path, errors, setting, bounded, count, rows, work.factors, trial, work.by, work.gx, work.gv, work.r
    )
    if done:
        guess_held(rows, setting.starts, guess)
        assign(by.xi, trial.xi)
        assign(by.v, trial.v)
        assign(by.sigma, trial.sigma)
    return done


@inlined
def own_proof(
    path: Path, setting: Setting, u: Array, bounded: Bounded, total: float, worst: float, count: int, guess: Signs,
    at: Point, work: Work
) -> bool:  # fmt: skip
    """Return whether the iteration's own multipliers prove that an iterate is the solution and satisfies the other
    rows; ½ rᵀH⁻¹r is replaced by its upper bound ½|r|²/c.
    """
    square, slack, most = 0.0, setting.slack, 0.5 * setting.curvature * setting.accuracy**2
    if worst > PRIMAL or needed(path, setting, u, at, setting.tolerance) > count:
        return False
    c0, c1 = left_over(path, slack, at, work.gx, work.gv, work.rows.multiplier, count, work.r)
    for k in range(bounded.there.size):
        if bounded.there[k]:
            for i in range(NU):
                square += work.r[k, i] ** 2
    square /= setting.curvature
    binding(work.rows, setting.starts, guess)
    return total + 0.5 * (square + (c0**2 / slack[1] + c1**2 / slack[3] if count == ALL else 0.0)) < most


@inlined_flat
def binding(rows: Rows, starts: Indices, guess: Signs) -> None:
    """Set `guess` (n,) to the active bounds of the changes."""
    for block in range(starts.size):
        k = starts[block]
        for i in range(NU):
            above = rows.multiplier[k, i] > BINDS * rows.t[k, i]
            below = rows.multiplier[k, NU + i] > BINDS * rows.t[k, NU + i]
            guess[NU * block + i] = UPPER if above else LOWER if below else FREE
