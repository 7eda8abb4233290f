"""Method of multipliers for the QP, from a point that shows the active rows, or nearly.

The quadratic part of a step has a constant weight W for each active row, in place of the λ/t of `interior`, which
suffers from rounding as soon as λ is large and t small. With r = a·y - b,

    binds:  λ + W r > 0,        λ ← max(λ + W (r + a Δy), 0)

(M. R. Hestenes, J. Optimization Theory and Applications 4, 1969). If the active set is right, every round divides the
error by a number far above 1. A change of a command that is held at its bound has the weight HELD, so that it reaches
the bound in one round; its multiplier is the remaining gradient, and has no rounding of its own.

The changes' rows have no other multipliers; those of the other rows are in `change` of `rows.Rows`.
"""

import numpy as np

from allocator.calculus import Array, Mask
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Errors, Indices, Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.newton import Factors, direction, factorise, gradients, left_over
from mpc.tracking.compiled.structured_qp.rows import Rows, values
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, JOINTS, LOWER, NU, NX, UPPER
from mpc.tracking.compiled.structured_qp.stage import advance

TURNS = 12  # rounds, at most
GIVES_UP = 2  # rounds after which the active set must not change any more
SOON = 6  # rounds after which rounding hides more of the gap
PRIMAL = 1e-7  # allowed violation of a row at the end [bar], [rad], [N]
GAP = 1e-3  # [-] of the allowed gap: aim
HELD = 1e30  # [cost]/[bar]²
WEIGHT = BOUNDS * (0.0,) + BOUNDS * (1e12,) + 2 * JOINTS * (2.5e13,) + NU * (6e8,)  # [cost]/(the row's unit)²
SLACK_WEIGHT = 100.0  # [-] weight of σ ≥ 0, relative to the cost of a slack's square


@inlined_flat
def hold_guessed(rows: Rows, starts: Indices, guess: Signs) -> None:
    """Set the weights of the changes' rows to those of a `guess` (n,)."""
    rows.W[:, :BOUNDS] = 0.0
    for block in range(starts.size):
        for i in range(NU):
            if guess[NU * block + i] == UPPER:
                rows.W[starts[block], i] = HELD
            elif guess[NU * block + i] == LOWER:
                rows.W[starts[block], NU + i] = HELD


@inlined_flat
def guess_held(rows: Rows, starts: Indices, guess: Signs) -> None:
    """Set a `guess` (n,) to the held changes."""
    for block in range(starts.size):
        k = starts[block]
        for i in range(NU):
            guess[NU * block + i] = UPPER if rows.W[k, i] > 0.0 else LOWER if rows.W[k, NU + i] > 0.0 else 0


@inlined_flat
def hold(rows: Rows, bounded: Bounded, at: Point, r: Array) -> bool:
    """Hold changes that violate their bounds, release those that `r` (N, 2) pushes inwards; set W and `push` of their
    rows, and return whether the held ones have changed.
    """
    new = False
    for k in range(bounded.there.size):
        if bounded.there[k]:
            for i in range(NU):
                v, lower, upper = at.v[k, i], bounded.lower[k, i], bounded.upper[k, i]
                above, below = rows.W[k, i] > 0.0, rows.W[k, NU + i] > 0.0
                if above or below:
                    free = lower < upper and (r[k, i] > 0.0 if above else r[k, i] < 0.0)
                    above, below, new = above and not free, below and not free, new or free
                else:
                    above, below = v > upper, v < lower
                    new = new or above or below
                rows.W[k, i], rows.W[k, NU + i] = HELD if above else 0.0, HELD if below else 0.0
                rows.push[k, i], rows.push[k, NU + i] = 0.0, 0.0
                if above:
                    rows.push[k, i] = HELD * (v - upper)
                if below:
                    rows.push[k, NU + i] = HELD * (lower - v)
    return new


@inlined_flat
def weigh(rows: Rows, slack: Array) -> tuple[float, float, bool]:
    """Set W and `push` of all rows except the changes', `residual` being a·y; return the sum of |λ r|, the greatest
    violation, and whether the active rows have changed.
    """
    total, worst, new, last = 0.0, 0.0, False, rows.b.shape[0] - 1
    for k in range(last + 1):
        for j in range(0 if k == last else BOUNDS, rows.span[k, 1]):
            r, multiplier = rows.residual[k, j] - rows.b[k, j], rows.change[k, j]
            weight = SLACK_WEIGHT * slack[2 * j + 1] if k == last else WEIGHT[j]
            push = multiplier + weight * r
            new = new or (push > 0.0) != (rows.W[k, j] > 0.0)
            total += abs(multiplier * r)
            worst = max(worst, r)
            rows.W[k, j], rows.push[k, j] = (weight, push) if push > 0.0 else (0.0, 0.0)
    return total, worst, new


@inlined_flat
def estimate(path: Path, rows: Rows, count: int, by: Point) -> None:
    """Set the multipliers to those after a step."""
    values(path, by, count, rows.dt)
    last = rows.b.shape[0] - 1
    for k in range(last + 1):
        for j in range(0 if k == last else BOUNDS, rows.span[k, 1]):
            rows.change[k, j] = max(rows.push[k, j] + rows.W[k, j] * rows.dt[k, j], 0.0)


@inlined_flat
def step_on(path: Path, rows: Rows, bounded: Bounded, at: Point, by: Point) -> None:
    """Take a step; held changes reach their bounds, and the states follow the changes."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            at.v[k, i] += by.v[k, i]
            if rows.W[k, i] > 0.0:
                at.v[k, i] = bounded.upper[k, i]
            elif rows.W[k, NU + i] > 0.0:
                at.v[k, i] = bounded.lower[k, i]
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
    for i in range(2):
        at.sigma[i] += by.sigma[i]


@inlined_flat
def cost_of(there: Mask, rows: Rows, setting: Setting, r: Array, c0: float, c1: float, count: int) -> float:
    """Return the greatest cost of the Lagrangian's gradient by the changes that are not held."""
    square, slack = 0.0, setting.slack
    for k in range(there.size):
        for i in range(NU):
            if there[k] and rows.W[k, i] + rows.W[k, NU + i] == 0.0:
                square += r[k, i] ** 2
    square /= setting.curvature
    return 0.5 * (square + (c0**2 / slack[1] + c1**2 / slack[3] if count == ALL else 0.0))


@inlined
def multiplied(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, count: int, rows: Rows, factors: Factors,
    at: Point, by: Point, gx: Array, gv: Array, r: Array
) -> bool:  # fmt: skip
    """Return whether `at` reaches a proved solution with the first `count` rows within TURNS rounds.

    The multipliers are in the `change` of `rows`; the weights of the changes' rows show which of them are held.
    """
    most = 0.5 * setting.curvature * setting.accuracy**2
    rows.change[: bounded.there.size, :BOUNDS] = 0.0
    new = True
    for rounds in range(TURNS):
        gradients(path, errors, setting.cost, at, gx, gv)
        c0, c1 = left_over(path, setting.slack, at, gx, gv, rows.change, count, r)
        values(path, at, count, rows.residual)
        moved = hold(rows, bounded, at, r)
        total, worst, others = weigh(rows, setting.slack)
        gap, aim = total + cost_of(bounded.there, rows, setting, r, c0, c1, count), GAP if rounds < SOON else 1.0
        if not (moved or others) and worst < PRIMAL and gap < aim * most:
            return True
        new = new or moved or others
        if not np.isfinite(total) or (rounds >= GIVES_UP and (moved or others)):
            break
        if new:
            factorise(path, setting.cost, setting.slack, rows.W, bounded.there, count, factors)
            new = False
        direction(path, factors, setting.slack, at, gx, gv, rows.push, count, by)
        estimate(path, rows, count, by)
        step_on(path, rows, bounded, at, by)
    return False
