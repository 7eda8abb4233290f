"""Solution of [L] for one target, by guesses until one is proved optimal.

`point` solves [L] for the free variables by orthogonal bases of the rows. The rows of level k, less their part in the
earlier levels' bases, are L Q with Q orthonormal, and L z ≈ b_k is a small least-squares problem (L = U R).
`violations` uses the earlier levels' `multipliers` to find each level's gain from moving the other variables: free ones
beyond a bound belong at it, and fixed ones become free if the first level with a gradient pulls them inside. The slack
of a one-sided row is treated as a variable; an idle row has a free slack and is left out.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls
from collections.abc import Callable
from math import sqrt

from allocator.allocation.box.kernel.box_qp import PATIENCE, box_qp, face, flip

MOST_ROUNDS = 20_000  # of guesses; 1 is usual
MOST_FIRST = 1_000  # of rounds for the first guess; 3 to 15 are usual
GAP = 1e4  # of the weights of one level and the next, in the QP of the first guess
RANK = 1e-20  # (1e-10)² of a level's longest row: a row with a smaller remainder depends on the others
CANCELLED = 1e-2  # of a row's square: a smaller remainder is orthogonalised again
MISSED = 1e-13  # of the scale: a residual below it is rounding
CANCELS = 1e-11  # of the size of column times multipliers: a gradient below it is rounding
OUTSIDE = 1e-12  # of the unit of x: a smaller violation of a bound is on it
EXCEEDED = 1e-9  # of a one-sided row's scale: above `RANK`'s, or nearly dependent rows never settle


def prepare(levels, work):
    """Fill the sizes of each level, and the matrix of the first guess's QP, which depend only on the rows."""
    A, weights, H = levels.A, work.weights, work.H
    measure(levels, work)
    weigh(levels, work)
    for j in range(A.shape[1]):
        for c in range(j + 1):
            H[j, c] = 1.0 if j == c else 0.0
            for i in range(len(A)):
                H[j, c] += weights[i] * A[i, j] * A[i, c]
            H[c, j] = H[j, c]


def measure(levels, work):
    """Fill the sizes of each level."""
    A, ends, sizes = levels.A, levels.ends, work.sizes
    begin, m = 0, A.shape[1]
    for k in range(len(ends)):
        sizes[0, k], sizes[1, k], sizes[2, k] = 0.0, 0.0, 0.0
        for i in range(begin, ends[k]):
            total, square, greatest = 0.0, 0.0, 0.0
            for j in range(m):
                total += abs(A[i, j])
                square += A[i, j] * A[i, j]
                greatest = max(greatest, abs(A[i, j]))
            sizes[0, k], sizes[1, k] = max(sizes[0, k], total), max(sizes[1, k], square)
            sizes[2, k] += greatest
        begin = ends[k]


def weigh(levels, work):
    """Fill `work.weights` with those of the rows in the first guess's QP; the centre has 1.

    One-sided rows have none: they are idle.
    """
    ends, sizes, weights = levels.ends, work.sizes, work.weights
    weight, end = 1.0, len(levels.b)
    for k in range(len(ends) - 1, -1, -1):
        weight *= GAP
        begin = ends[k - 1] if k > 0 else 0
        for i in range(begin, end):
            weights[i] = 0.0 if levels.onesided[i] or sizes[1, k] == 0.0 else weight / sizes[1, k]
        end = begin


def scale(levels, work):
    """Fill `work.scales` with the scales of each level's residuals and gradients, for x near 1; of zeros 1."""
    b, ends, sizes, scales = levels.b, levels.ends, work.sizes, work.scales
    begin, K = 0, len(levels.ends)
    for k in range(K):
        greatest = 0.0
        for i in range(begin, ends[k]):
            greatest = max(greatest, abs(b[i]))
        scales[0, k] = greatest + sizes[0, k] if greatest + sizes[0, k] > 0.0 else 1.0
        scales[1, k] = scales[0, k] * sizes[2, k] if sizes[2, k] > 0.0 else 1.0
        begin = ends[k]
    scales[0, K], scales[1, K] = 1.0, 1.0


def solve(levels, box, x, side, mu, warm, work):
    """Solve [L] for one target; return the number of guesses, 0 if they did not end. Call `prepare` first.

    `side` (m + p): of each variable -1 at lo, 0 free, +1 at hi; of each row -1 if active, 0 if idle. Its contents are
    the first guess if `warm`; else a QP with weights instead of levels makes it.
    """
    lo, hi, right, tries = box.lo, box.hi, work.right, work.tries
    m, p = len(x), len(levels.b)
    for i in range(p):
        if not levels.onesided[i]:
            side[m + i] = -1
        elif not warm:
            side[m + i] = 0
    for j in range(m):
        if lo[j] >= hi[j]:
            side[j] = -1
        elif not warm:
            side[j] = 0
    scale(levels, work)
    rounds = 0 if warm else guess(levels, box, x, side, work)
    tries[0], tries[1] = m + p + 1, PATIENCE
    for step in range(MOST_ROUNDS):
        for j in range(m):
            x[j] = 0.0 if side[j] == 0 else (lo[j] if side[j] < 0 else hi[j])
        point(levels, box.centre, side, x, work)
        multipliers(levels, mu, work)
        last = violations(levels, box, x, side, mu, work)
        count = 0
        for j in range(m + p):
            count += 1 if right[j] != side[j] else 0
        if count == 0:
            for j in range(m):
                x[j] = min(max(x[j], lo[j]), hi[j])
            return rounds + step + 1
        flip(side, right, m + p, count, last, tries)
    return 0


def guess(levels, box, x, side, work):
    """Guess the sides by the QP with weights instead of levels; return its rounds."""
    A, b, g, weights = levels.A, levels.b, work.g, work.weights
    for j in range(len(x)):
        g[j] = box.centre[j]
    for i in range(len(b)):
        pull = weights[i] * b[i]
        for j in range(len(x)):
            g[j] += pull * A[i, j]
    return box_qp(box, x, side, MOST_FIRST, work)


def point(levels, centre, side, x, work):
    """Move the free variables of `x`, which are 0, to the solution of [L] without bounds, the fixed ones held."""
    A, b, ends = levels.A, levels.b, levels.ends
    Q, B, z, step, rhs, first, free = work.Q, work.B, work.z, work.step, work.rhs, work.first, work.free
    p, m, n = len(b), len(x), 0
    for j in range(m):
        if side[j] == 0:
            free[n] = j
            n += 1
    for i in range(p):
        counts = 1.0 if side[m + i] != 0 else 0.0
        rhs[i] = counts * b[i]
        for j in range(m):
            rhs[i] -= counts * A[i, j] * x[j]
        for c in range(n):
            B[i, c] = counts * A[i, free[c]]
    rank, begin = 0, 0
    for k in range(len(ends)):
        first[k] = rank
        rank = basis(begin, ends[k], n, rank, work.sizes[1, k], work)
        least_squares(begin, ends[k], first[k], rank, work)
        begin = ends[k]
    first[len(ends)] = rank
    for t in range(rank):
        step[t] = z[t]
        for c in range(n):
            step[t] -= Q[t, c] * centre[free[c]]
    for c in range(n):
        moved = centre[free[c]]
        for t in range(rank):
            moved += step[t] * Q[t, c]
        x[free[c]] = moved


def basis(begin, end, n, rank, longest, work):
    """Extend the orthonormal rows Q by those of B[begin:end], the longest first; return their number.

    The components of all rows from `begin` on along the new ones are moved to L.
    """
    Q, B, L, used = work.Q, work.B, work.L, work.used
    for i in range(begin, len(B)):
        used[i] = False
    while rank < n:
        best, chosen = RANK * longest, -1
        for i in range(begin, end):
            if used[i]:
                continue
            square = 0.0
            for c in range(n):
                square += B[i, c] * B[i, c]
            if square > best:
                best, chosen = square, i
        if chosen < 0:
            return rank
        if best < CANCELLED * longest:
            best = again(B, Q, L, chosen, n, rank)
        shrink = 1.0 / sqrt(best)
        for c in range(n):
            Q[rank, c] = B[chosen, c] * shrink
        used[chosen] = True
        for i in range(begin, len(B)):
            part = 0.0
            if not used[i]:
                for c in range(n):
                    part += B[i, c] * Q[rank, c]
                for c in range(n):
                    B[i, c] -= part * Q[rank, c]
            L[i, rank] = part
        L[chosen, rank] = best * shrink
        rank += 1
    return rank


def again(B, Q, L, row, n, rank):
    """Orthogonalise a row of B to Q[:rank] again, since small remainders have lost digits; return its square."""
    for t in range(rank):
        part = 0.0
        for c in range(n):
            part += B[row, c] * Q[t, c]
        L[row, t] += part
        for c in range(n):
            B[row, c] -= part * Q[t, c]
    square = 0.0
    for c in range(n):
        square += B[row, c] * B[row, c]
    return square


def least_squares(begin, end, first, rank, work):
    """Solve L z ≈ right-hand side for z[first:rank], over the rows begin:end, with z[:first] held; keep L = U R."""
    L, U, R, z, rhs = work.L, work.U, work.R, work.z, work.rhs
    for i in range(begin, end):
        for t in range(first):
            rhs[i] -= L[i, t] * z[t]
        for t in range(first, rank):
            U[i, t] = L[i, t]
    for t in range(first, rank):
        square = 0.0
        for i in range(begin, end):
            square += U[i, t] * U[i, t]
        shrink = 1.0 / sqrt(square)
        R[t, t], z[t] = shrink, 0.0
        for i in range(begin, end):
            U[i, t] *= shrink
            z[t] += U[i, t] * rhs[i]
        for i in range(begin, end):
            rhs[i] -= z[t] * U[i, t]
        for s in range(t + 1, rank):
            part = 0.0
            for i in range(begin, end):
                part += U[i, t] * U[i, s]
            R[t, s] = part
            for i in range(begin, end):
                U[i, s] -= part * U[i, t]
    for t in range(first, rank):  # again: a small residual has lost digits, and it decides feasibility
        part = 0.0
        for i in range(begin, end):
            part += U[i, t] * rhs[i]
        z[t] += part
        for i in range(begin, end):
            rhs[i] -= part * U[i, t]
    for t in range(rank - 1, first - 1, -1):
        for s in range(t + 1, rank):
            z[t] -= R[t, s] * z[s]
        z[t] *= R[t, t]


def multipliers(levels, mu, work):
    """Fill `mu` (K + 1, p): multipliers of earlier levels' rows that cancel each level's gradient along their bases.

    The level's own rows hold the residual A x - b, 0 if the level is met.
    """
    ends, rhs, scales = levels.ends, work.rhs, work.scales
    begin = 0
    for k in range(len(ends) + 1):
        end = ends[k] if k < len(ends) else begin
        missed = k == len(ends)
        for i in range(begin, end):
            missed = missed or abs(rhs[i]) > (EXCEEDED if levels.onesided[i] else MISSED) * scales[0, k]
        for i in range(len(rhs)):
            mu[k, i] = -rhs[i] if missed and begin <= i and i < end else 0.0
        if missed:
            earlier(k, begin, end, ends, mu, work)
        begin = end


def earlier(k, begin, end, ends, mu, work):
    """Fill `mu[k, :begin]`, from the residual in `mu[k, begin:end]`."""
    L, U, R, z, step, first = work.L, work.U, work.R, work.z, work.step, work.first
    for level in range(k - 1, -1, -1):
        top = ends[level]
        bottom = ends[level - 1] if level > 0 else 0
        for t in range(first[level], first[level + 1]):
            z[t] = -step[t] if k == len(ends) else 0.0  # of the last level, with the gradient x - c
            for i in range(top, end):
                z[t] -= L[i, t] * mu[k, i]
            for s in range(first[level], t):  # Rᵀ z = remaining gradient
                z[t] -= R[s, t] * z[s]
            z[t] *= R[t, t]
            for i in range(bottom, top):
                mu[k, i] += U[i, t] * z[t]


def violations(levels, box, x, side, mu, work):
    """Fill `work.right` with the correct sides of variables and rows; return the last that differs from `side`.

    A fixed variable must become free if the first level with a gradient above rounding would gain from it.
    """
    A, b, ends = levels.A, levels.b, levels.ends
    lo, hi, right, largest = box.lo, box.hi, work.right, work.largest
    K, m, last = len(ends), len(x), 0
    for k in range(K + 1):
        largest[k] = 0.0
        for i in range(len(b)):
            largest[k] = max(largest[k], abs(mu[k, i]))
    for j in range(m):
        right[j] = side[j]
        if side[j] == 0:
            if x[j] < lo[j] - OUTSIDE:
                right[j] = -1
            elif x[j] > hi[j] + OUTSIDE:
                right[j] = 1
        elif lo[j] < hi[j]:
            for k in range(K + 1):
                gradient = x[j] - box.centre[j] if k == K else 0.0
                size = abs(gradient)
                for i in range(ends[min(k, K - 1)]):
                    gradient += A[i, j] * mu[k, i]
                    size += abs(A[i, j]) * largest[k]
                if abs(gradient) > CANCELS * size:
                    right[j] = 0 if gradient * side[j] > 0.0 else side[j]
                    break
        if right[j] != side[j]:
            last = j
    level = 0
    for i in range(len(b)):
        right[m + i] = side[m + i]
        if i >= ends[level]:
            level += 1
        if levels.onesided[i]:
            right[m + i] = row_belongs(i, level, levels, x, side[m + i], mu, work)
        if right[m + i] != side[m + i]:
            last = m + i
    return last


def row_belongs(i, level, levels, x, now, mu, work):
    """Return the correct side of the one-sided row `i` of `level`: -1 active, 0 idle."""
    A, largest = levels.A, work.largest
    if now == 0:
        slack = levels.b[i]
        for j in range(len(x)):
            slack -= A[i, j] * x[j]
        return -1 if slack < -EXCEEDED * work.scales[0, level] else 0
    for k in range(level, len(levels.ends) + 1):
        if abs(mu[k, i]) > CANCELS * largest[k]:
            return 0 if mu[k, i] < 0.0 else -1
    return now


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *(prepare, measure, weigh, scale, solve, guess, point, basis, again, least_squares, multipliers, earlier),
    *(violations, row_belongs, box_qp, face, flip),
)
