"""The kernel solves the lexicographic box-constrained least squares of a mechanism, exactly, by block pivoting.

Over x ∈ Rᵐ within [lo, hi], in the order of the levels k = 0 … K-1 and then of the centre c,

    first minimise ‖A_0 x - b_0‖²,  among all that do ‖A_1 x - b_1‖²,  …,  among all that do ‖x - c‖²          [L]

What an earlier level has achieved is an equality for the later ones, never a weight. Every variable is guessed to be
free, at lo or at hi. `point` solves [L] for the free ones by orthogonal bases of the rows: those of level k less their
part in the earlier levels' bases, are L Q with Q orthonormal, and L z ≈ b_k is a small least-squares problem (L = U R).
`violations` tells what each level would gain from moving the others, with the earlier levels' `multipliers`. Variables
beyond their bounds are fixed there, fixed ones that the first level to feel them pulls inside are freed, all at once;
after `_PATIENCE` rounds without fewer of them only the last one, Murty's rule. That ends: [L] is the limit of
Σ ε^k ‖A_k x - b_k‖² + ε^K ‖x - c‖² as ε → 0, whose matrix is positive definite over the ordered field of series in ε,
and over that the rule visits no guess twice.

J. J. Júdice and F. M. Pires, "A block principal pivoting algorithm for large-scale strictly monotone linear
complementarity problems", Computers & Operations Research 21(5), 1994; K. G. Murty, "Note on a Bard-type scheme for
solving the complementarity problem", Opsearch 11, 1974.

It is plain Python for arrays that numba compiles as it stands.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for arrays; types would say Any
from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np

MOST_ROUNDS = 20_000  # of guesses; some 3 are usual, 40 rare, 1000 seen at contrived corners
_PATIENCE = 3  # rounds without fewer violations before Murty's rule
_RANK = 1e-20  # (1e-10)² of a level's longest row: what is left of a row below it depends on the others
_CANCELLED = 1e-2  # of a row's square: what is left of it is made orthogonal once more
_MET = 1e-13  # of the scale: a residual below it is rounding
_CANCELS = 1e-11  # of column times multipliers, in size: a gradient below it is rounding
_OUTSIDE = 1e-12  # of the unit of x: a variable beyond its bound by less is on it


def allocate_batch(A, b, ends, lo, hi, centre, which, warm, x, side, mu, rounds):
    """Solve [L] for N targets.

    `A` (maps, p, m) holds the rows of all levels, which end at `ends` (K,); target i takes the map `which[i]`, with `b`
    (N, p) and the bounds `lo`, `hi` and the `centre` (N, m). Filled are `x` (N, m), `side` (N, m; -1 at lo, 0 free, +1
    at hi), the multipliers `mu` (N, K + 1, p) of the earlier levels' rows, and `rounds` (N), 0 where no guess of
    `MOST_ROUNDS` was right. With `warm` the guess begins with the previous target's sides, else with what `side` holds.
    """
    p, m = A.shape[1], A.shape[2]
    K = len(ends)
    work = (
        np.empty((m, m)),  # Q, rows
        np.empty((p, m)),  # B
        np.empty((p, m)),  # L
        np.empty((p, m)),  # U
        np.empty((m, m)),  # R, its diagonal inverted
        np.empty(m),  # z
        np.empty(m),  # the step from the centre along Q
        np.empty(p),  # right-hand side, and then what is left of it: b - A x
        np.empty(K + 1, np.int64),  # where the basis of each level begins
        np.empty(m, np.int64),  # the free variables
        np.empty(m, np.int64),  # where each variable belongs
        np.empty(K + 1),  # the greatest multiplier of each level
        np.empty(p, np.bool_),  # the rows that are in Q
    )
    sizes, scales = np.empty((3, K)), np.empty((2, K + 1))
    for i in range(len(which)):
        if i == 0 or which[i] != which[i - 1]:
            measure(A[which[i]], ends, sizes)
        if warm and i > 0:
            for j in range(m):
                side[i, j] = side[i - 1, j]
        scale(b[i], ends, sizes, scales)
        levels = (A[which[i]], b[i], ends, sizes, scales)
        rounds[i] = pivot(levels, (lo[i], hi[i], centre[i]), x[i], side[i], mu[i], work)


def measure(A, ends, sizes):
    """Fill `sizes` (3, K) with the greatest row sum, the greatest squared row and the gradient's size of each level."""
    begin = 0
    for k in range(len(ends)):
        sizes[0, k] = sizes[1, k] = sizes[2, k] = 0.0
        for i in range(begin, ends[k]):
            total, square, greatest = 0.0, 0.0, 0.0
            for j in range(A.shape[1]):
                total += abs(A[i, j])
                square += A[i, j] * A[i, j]
                greatest = max(greatest, abs(A[i, j]))
            sizes[0, k], sizes[1, k] = max(sizes[0, k], total), max(sizes[1, k], square)
            sizes[2, k] += greatest
        begin = ends[k]


def scale(b, ends, sizes, scales):
    """Fill `scales` (2, K + 1) with what counts as large for each level's residuals and gradients, x being near 1."""
    begin = 0
    for k in range(len(ends)):
        greatest = 0.0
        for i in range(begin, ends[k]):
            greatest = max(greatest, abs(b[i]))
        scales[0, k] = greatest + sizes[0, k]
        scales[1, k] = scales[0, k] * sizes[2, k]
        begin = ends[k]
    scales[0, len(ends)] = scales[1, len(ends)] = 1.0


def pivot(levels, box, x, side, mu, work):
    """Solve [L] for one target, from the guess `side`; return the number of rounds, 0 if the guesses did not end."""
    lo, hi, centre = box
    m, right = len(lo), work[10]
    for j in range(m):
        if lo[j] >= hi[j]:
            side[j] = -1
    fewest, patience = m + 1, _PATIENCE
    for step in range(MOST_ROUNDS):
        for j in range(m):
            x[j] = 0.0 if side[j] == 0 else (lo[j] if side[j] < 0 else hi[j])
        point(levels, centre, side, x, work)
        multipliers(levels, mu, work)
        count, last = violations(levels, box, x, side, mu, work)
        if count == 0:
            for j in range(m):
                x[j] = min(max(x[j], lo[j]), hi[j])
            return step + 1
        if count < fewest:
            fewest, patience = count, _PATIENCE
        else:
            patience -= 1
        if patience >= 0:
            for j in range(m):
                side[j] = right[j]
        else:
            side[last] = right[last]
    return 0


def point(levels, centre, side, x, work):
    """Move the free variables of `x`, which are 0, to the solution of [L] without bounds, the fixed ones held."""
    A, b, ends, sizes, _ = levels
    Q, B, _, _, _, z, step, rhs, first, free, _, _, _ = work
    p, m = A.shape
    n = 0
    for j in range(m):
        if side[j] == 0:
            free[n] = j
            n += 1
    for i in range(p):
        rhs[i] = b[i]
        for j in range(m):
            rhs[i] -= A[i, j] * x[j]
        for c in range(n):
            B[i, c] = A[i, free[c]]
    rank, begin = 0, 0
    for k in range(len(ends)):
        first[k] = rank
        rank = basis(begin, ends[k], n, rank, sizes[1, k], work)
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
    """Extend the orthonormal rows Q by those of B[begin:end], the longest first; return how many there are.

    All rows from `begin` on lose their part in the new ones, which goes to L.
    """
    Q, B, L, used = work[0], work[1], work[2], work[12]
    for i in range(begin, len(B)):
        used[i] = False
    while rank < n:
        best, chosen = _RANK * longest, -1
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
        if best < _CANCELLED * longest:
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
    """Make a row of B orthogonal to Q[:rank] once more, since what is small has lost digits; return its square."""
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
    L, U, R, z, rhs = work[2], work[3], work[4], work[5], work[7]
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
    for t in range(first, rank):  # once more: a small residual has lost digits, and it decides what can be had
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
    """Fill `mu` (K + 1, p): of the earlier levels' rows, so that each level's gradient vanishes along their bases.

    In the level's own rows stands the residual A x - b, 0 where the level is met.
    """
    _, _, ends, _, scales = levels
    rhs = work[7]
    begin = 0
    for k in range(len(ends) + 1):
        end = ends[k] if k < len(ends) else begin
        missed = k == len(ends)
        for i in range(begin, end):
            missed = missed or abs(rhs[i]) > _MET * scales[0, k]
        for i in range(len(rhs)):
            mu[k, i] = -rhs[i] if missed and begin <= i < end else 0.0
        if missed:
            earlier(k, begin, end, ends, mu, work)
        begin = end


def earlier(k, begin, end, ends, mu, work):
    """Fill `mu[k, :begin]`, from the residual in `mu[k, begin:end]`."""
    L, U, R, z, step, first = work[2], work[3], work[4], work[5], work[6], work[8]
    for level in range(k - 1, -1, -1):
        top = ends[level]
        bottom = ends[level - 1] if level > 0 else 0
        for t in range(first[level], first[level + 1]):
            z[t] = -step[t] if k == len(ends) else 0.0  # of the last level, whose gradient is x - c
            for i in range(top, end):
                z[t] -= L[i, t] * mu[k, i]
            for s in range(first[level], t):  # Rᵀ z = what is to vanish
                z[t] -= R[s, t] * z[s]
            z[t] *= R[t, t]
            for i in range(bottom, top):
                mu[k, i] += U[i, t] * z[t]


def violations(levels, box, x, side, mu, work):
    """Return how many variables are on the wrong side, and the last of them; `work` keeps where each belongs.

    A fixed one belongs inside if the first level whose gradient is not rounding would gain from that.
    """
    A, _, ends, _, _ = levels
    lo, hi, centre = box
    right = work[10]
    K, largest = len(ends), work[11]
    for k in range(K + 1):
        largest[k] = 0.0
        for i in range(len(mu[k])):
            largest[k] = max(largest[k], abs(mu[k, i]))
    count, last = 0, -1
    for j in range(len(x)):
        right[j] = side[j]
        if side[j] == 0:
            if x[j] < lo[j] - _OUTSIDE:
                right[j] = -1
            elif x[j] > hi[j] + _OUTSIDE:
                right[j] = 1
        elif lo[j] < hi[j]:
            for k in range(K + 1):
                gradient = x[j] - centre[j] if k == K else 0.0
                size = abs(gradient)
                for i in range(ends[min(k, K - 1)]):
                    gradient += A[i, j] * mu[k, i]
                    size += abs(A[i, j]) * largest[k]
                if abs(gradient) > _CANCELS * size:
                    right[j] = 0 if gradient * side[j] > 0.0 else side[j]
                    break
        if right[j] != side[j]:
            count, last = count + 1, j
    return count, last


def residual_batch(A, b, ends, lo, hi, centre, which, x, mu, near, out):
    """Fill `out` (N) with the residuals of optimality that `allocator.mechanism.certificate` explains.

    Arguments are those of `allocate_batch`; a variable within `near` of a bound is on it.
    """
    p, m = A.shape[1], A.shape[2]
    K = len(ends)
    sizes, scales = np.empty((3, K)), np.empty((2, K + 1))
    factors, held = np.empty(p), np.empty(m, np.bool_)
    for i in range(len(which)):
        if i == 0 or which[i] != which[i - 1]:
            measure(A[which[i]], ends, sizes)
        scale(b[i], ends, sizes, scales)
        levels, box = (A[which[i]], b[i], ends, sizes, scales), (lo[i], hi[i], centre[i])
        out[i] = residual(levels, box, x[i], mu[i], near, factors, held)


def residual(levels, box, x, mu, near, factors, held):
    """Return the greatest gradient that is left at any level, in fractions of its scale."""
    A, b, ends, _, scales = levels
    lo, hi, centre = box
    K, begin, worst = len(ends), 0, 0.0
    for j in range(len(x)):
        held[j] = lo[j] >= hi[j]
    for k in range(K + 1):
        end, largest = ends[k] if k < K else begin, 0.0
        for i in range(end):
            factors[i] = mu[k, i]
            largest = max(largest, abs(mu[k, i]))
            if i >= begin:  # the level's own rows, from the answer itself
                factors[i] = -b[i]
                for j in range(len(x)):
                    factors[i] += A[i, j] * x[j]
                worst = max(worst, abs(factors[i] - mu[k, i]) / scales[0, k])
        for j in range(len(x)):
            gradient = felt = x[j] - centre[j] if k == K else 0.0
            size = abs(gradient)
            for i in range(end):
                gradient += A[i, j] * factors[i]
                felt += A[i, j] * mu[k, i]
                size += abs(A[i, j]) * largest
            low, high = x[j] <= lo[j] + near, x[j] >= hi[j] - near
            wrong = abs(gradient)
            if low or high:
                wrong = max(-gradient if low else gradient, 0.0)
            if not held[j]:
                worst = max(worst, wrong / (scales[1, k] + size))
                held[j] = (low or high) and abs(felt) > _CANCELS * size
        begin = end
    return worst


_CALLEES = measure, scale, pivot, point, basis, again, least_squares, multipliers, earlier, violations, residual
FUNCTIONS: tuple[Callable[..., Any], ...] = _CALLEES

__all__ = ["FUNCTIONS", "MOST_ROUNDS", "allocate_batch", "residual_batch"]
