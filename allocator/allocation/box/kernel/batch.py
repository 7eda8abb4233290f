"""Loops over many targets, and the residual that proves an answer.

Row matrices `A` (maps, p, m) hold all levels, which end at `ends` (K); target i takes the map `which[i]`, with `b` (N,
p) and the bounds `lo`, `hi` and the `centre` (N, m). Multipliers `mu` (N, K + 1, p) belong to the earlier levels' rows.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls
from collections.abc import Callable

from allocator.allocation.box.kernel import levels as one
from allocator.allocation.box.kernel.box_qp import box_qp
from allocator.allocation.box.kernel.data import Box, Levels
from allocator.allocation.box.kernel.levels import CANCELS, MOST_ROUNDS, measure, prepare, scale, solve


def residual(levels, box, x, mu, pull, near, held, work):
    """Return the greatest remaining gradient of any level, in fractions of its scale.

    `pull` is the weight of ‖x - c‖² in the last level; with 0 it is a level of its own. `held` (m + p) is scratch
    memory. Call `levels.measure` and `levels.scale` first.
    """
    ends, scales, factors = levels.ends, work.scales, work.rhs
    K, begin, worst = len(ends), 0, 0.0
    for j in range(len(x)):
        held[j] = box.lo[j] >= box.hi[j]
    for i in range(len(levels.b)):
        held[len(x) + i] = not levels.onesided[i]
    for k in range(K + 1 if pull == 0.0 else K):
        end, largest = ends[k] if k < K else begin, 0.0
        for i in range(end):
            factors[i] = mu[k, i]
            largest = max(largest, abs(mu[k, i]))
            if i >= begin:  # the level's own rows, from the answer itself
                excess = -slack(i, levels, x)
                factors[i] = max(excess, 0.0) if levels.onesided[i] else excess
                worst = max(worst, abs(factors[i] - mu[k, i]) / scales[0, k])
        to_centre = 1.0 if k == K else (pull if k == K - 1 else 0.0)
        worst = max(worst, of_variables(k, end, levels, box, x, mu, to_centre, largest, near, held, work))
        worst = max(worst, of_rows(k, end, levels, x, mu, largest, near, held, work))
        begin = end
    return worst


def slack(i, levels, x):
    """Return b - A x of row `i`."""
    left = levels.b[i]
    for j in range(len(x)):
        left -= levels.A[i, j] * x[j]
    return left


def of_variables(k, end, levels, box, x, mu, to_centre, greatest, near, held, work):
    """Return the remaining gradient of level k; `held` are the variables that an earlier level holds at a bound."""
    A, factors, worst = levels.A, work.rhs, 0.0
    for j in range(len(x)):
        gradient = to_centre * (x[j] - box.centre[j])
        felt, size = gradient, abs(gradient)
        for i in range(end):
            gradient += A[i, j] * factors[i]
            felt += A[i, j] * mu[k, i]
            size += abs(A[i, j]) * greatest
        low, high = x[j] <= box.lo[j] + near, x[j] >= box.hi[j] - near
        wrong = abs(gradient)
        if low or high:
            wrong = max(-gradient if low else gradient, 0.0)
        if not held[j]:
            worst = max(worst, wrong / (work.scales[1, k] + size))
            held[j] = (low or high) and abs(felt) > CANCELS * size
    return worst


def of_rows(k, end, levels, x, mu, greatest, near, held, work):
    """Return the violation by one-sided rows' multipliers: they must be ≥ 0, and 0 where a row is not at its bound."""
    worst, level, m = 0.0, 0, len(x)
    for i in range(end):
        if i >= levels.ends[level]:
            level += 1
        if not held[m + i]:
            at = slack(i, levels, x) <= near * work.scales[0, level]
            wrong = max(-work.rhs[i], 0.0) if at else abs(work.rhs[i])
            worst = max(worst, wrong / (work.scales[0, k] + greatest))
            held[m + i] = at and abs(mu[k, i]) > CANCELS * greatest
    return worst


PROOF: tuple[Callable[..., object], ...] = (residual, slack, of_variables, of_rows)


def allocate_batch(A, b, onesided, ends, lo, hi, centre, which, warm, x, side, mu, rounds, work):
    """Solve [L] for N targets.

    Fills `x` (N, m), `side` (N, m + p; as in `levels.solve`), `mu` and `rounds` (N), 0 if no guess was right. With
    `warm` the first guess has the previous target's sides.
    """
    for i in range(len(which)):
        levels = Levels(A[which[i]], b[i], onesided, ends)
        if i == 0 or (which[i] != which[i - 1] and not warm):
            prepare(levels, work)
        elif which[i] != which[i - 1]:
            measure(levels, work)
        if warm and i > 0:
            repeat(side[i - 1], side[i])
        rounds[i] = solve(levels, Box(lo[i], hi[i], centre[i]), x[i], side[i], mu[i], warm and i > 0, work)


def repeat(last, side):
    """Copy the sides of the last target."""
    for j in range(len(side)):
        side[j] = last[j]


def weigh_batch(A, b, onesided, ends, lo, hi, centre, which, pull, warm, x, side, mu, rounds, work):
    """Solve N strictly convex QPs, ‖A x - b‖² + pull ‖x - c‖² in the box; arguments are as in `allocate_batch`."""
    p, m = len(onesided), len(work.g)
    for i in range(len(which)):
        rows, box = A[which[i]], Box(lo[i], hi[i], centre[i])
        levels = Levels(rows, b[i], onesided, ends)
        if i == 0 or which[i] != which[i - 1]:
            for j in range(m):
                for c in range(j + 1):
                    entry = pull if j == c else 0.0
                    for r in range(p):
                        entry += rows[r, j] * rows[r, c]
                    work.H[j, c] = work.H[c, j] = entry
        weigh_box(levels, box, pull, side[i - 1] if warm and i > 0 else side[i], warm and i > 0, side[i], work)
        rounds[i] = box_qp(box, x[i], side[i], MOST_ROUNDS, work)
        missed(levels, box, x[i], mu[i])


def weigh_box(levels, box, pull, last, warm, side, work):
    """Fill the linear term of the QP, and the first guess: the `last` target's sides if `warm`."""
    for j in range(len(box.lo)):
        work.g[j] = pull * box.centre[j]
        for r in range(len(levels.b)):
            work.g[j] += levels.A[r, j] * levels.b[r]
        side[j] = -1 if box.lo[j] >= box.hi[j] else (last[j] if warm else 0)


def missed(levels, box, x, mu):
    """Move `x` into the box, and fill `mu` with what the rows miss."""
    for j in range(len(x)):
        x[j] = min(max(x[j], box.lo[j]), box.hi[j])
    for r in range(len(levels.b)):
        mu[0, r], mu[1, r] = -slack(r, levels, x), 0.0


def residual_batch(A, b, onesided, ends, lo, hi, centre, which, x, mu, pull, near, out, held, work):
    """Fill `out` (N) with the residuals of optimality of `allocator.allocation.box.certificate`.

    Arguments are those of `allocate_batch`; `pull` is that of `weigh_batch`, 0 where ‖x - c‖² is a level of its own; a
    variable within `near` of a bound is on it.
    """
    for i in range(len(which)):
        levels = Levels(A[which[i]], b[i], onesided, ends)
        if i == 0 or which[i] != which[i - 1]:
            measure(levels, work)
        scale(levels, work)
        out[i] = residual(levels, Box(lo[i], hi[i], centre[i]), x[i], mu[i], pull, near, held, work)


FUNCTIONS: tuple[Callable[..., object], ...] = (*one.FUNCTIONS, *PROOF, repeat, weigh_box, missed)
