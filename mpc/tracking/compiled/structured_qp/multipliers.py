"""The QP is solved by a method of multipliers from a point that shows which of its rows bind, or nearly.

The quadratic part of a step has a weight W for each row that binds that stays as it is, where
`interior` has λ/t, which rounding spoils as soon as λ is great and t small. With r = a·y - b,

    binds:  λ + W r > 0,        λ ← max(λ + W (r + a Δy), 0)

(M. R. Hestenes, J. Optimization Theory and Applications 4, 1969). If the set that binds is right, every round divides
what is left by a number far above 1. A change of a command that is held at its bound has the weight HELD, so that it is
there after one round; its multiplier is what the gradient leaves there, and has no rounding of its own.

The changes' rows have no other multipliers; those of the rest are in `change` of `rows.Rows`.
"""

import numpy as np

from allocator.calculus import Array, Mask
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Errors, Indices, Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.newton import Factors, direction, factorise, gradients, left_over
from mpc.tracking.compiled.structured_qp.rows import Rows, values
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, JOINTS, LOWER, NU, NX, UPPER
from mpc.tracking.compiled.structured_qp.stage import advance

TURNS = 12  # at most
GIVES_UP = 2  # rounds after which what binds must not change any more
SOON = 6  # rounds after which rounding hides more of the gap
PRIMAL = 1e-7  # by which a row may be broken at the end [bar], [rad], [N]
GAP = 1e-3  # [-] of the gap that may be: the aim
HELD = 1e30  # [cost]/[bar]²
WEIGHT = BOUNDS * (0.0,) + BOUNDS * (1e12,) + 2 * JOINTS * (2.5e13,) + NU * (6e8,)  # [cost] a square of the row's unit
SLACK_WEIGHT = 100.0  # [-] weight of σ ≥ 0 in what the square of a slack costs


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
    """Set a `guess` (n,) to the changes that are held."""
    for block in range(starts.size):
        k = starts[block]
        for i in range(NU):
            guess[NU * block + i] = UPPER if rows.W[k, i] > 0.0 else LOWER if rows.W[k, NU + i] > 0.0 else 0


@inlined_flat
def hold(rows: Rows, bounded: Bounded, at: Point, r: Array) -> bool:
    """Hold the changes that break their bounds, let go those that `r` (N, 2) pushes inwards; set W and `push` of their
    rows, and return whether others are held than before.
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
    """Set W and `push` of all rows but the changes', `residual` being a·y; return the sum of |λ r|, the greatest
    violation, and whether other rows bind than before.
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
    """Set the multipliers to what a step makes of them."""
    values(path, by, count, rows.dt)
    last = rows.b.shape[0] - 1
    for k in range(last + 1):
        for j in range(0 if k == last else BOUNDS, rows.span[k, 1]):
            rows.change[k, j] = max(rows.push[k, j] + rows.W[k, j] * rows.dt[k, j], 0.0)


@inlined_flat
def step_on(path: Path, rows: Rows, bounded: Bounded, at: Point, by: Point) -> None:
    """Take a step; what is held comes to its bound, and the states to where the changes lead."""
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
    """Return what the gradient of the Lagrangian costs at most, by what is not held."""
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
    """Return whether `at` comes to the solution with the first `count` rows within TURNS rounds, proved.

    The multipliers are in the `change` of `rows`, the weights of the changes' rows say which of these are held.
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
