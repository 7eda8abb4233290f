"""Many targets are solved, and their answers proved, one after the other.

Row matrices `A` (maps, p, m) hold all levels, which end at `ends` (K); target i takes the map `which[i]`, with `b`
(N, p) and the bounds `lo`, `hi` and the `centre` (N, m). Multipliers `mu` (N, K + 1, p) are of the earlier levels'
rows.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls
from collections.abc import Callable

from allocator.mechanism.kernel import levels as one
from allocator.mechanism.kernel import residual as proof
from allocator.mechanism.kernel.box_qp import box_qp
from allocator.mechanism.kernel.data import Box, Levels
from allocator.mechanism.kernel.levels import MOST_ROUNDS, prepare, scale, solve
from allocator.mechanism.kernel.residual import residual, slack


def allocate_batch(A, b, onesided, ends, lo, hi, centre, which, warm, x, side, mu, rounds, work):
    """Solve [L] for N targets.

    Filled are `x` (N, m), `side` (N, m + p; as in `levels.solve`), `mu` and `rounds` (N), 0 where no guess was right.
    With `warm` the guess begins with the previous target's sides.
    """
    for i in range(len(which)):
        levels = Levels(A[which[i]], b[i], onesided, ends)
        if i == 0 or which[i] != which[i - 1]:
            prepare(levels, work)
        if warm and i > 0:
            for j in range(side.shape[1]):
                side[i, j] = side[i - 1, j]
        rounds[i] = solve(levels, Box(lo[i], hi[i], centre[i]), x[i], side[i], mu[i], warm and i > 0, work)


def weigh_batch(A, b, onesided, ends, lo, hi, centre, which, pull, warm, x, side, mu, rounds, work):
    """Solve N strictly convex QPs, ‖A x - b‖² + pull ‖x - c‖² in the box; arguments are as in `allocate_batch`."""
    m, p = A.shape[2], A.shape[1]
    for i in range(len(which)):
        rows = A[which[i]]
        if i == 0 or which[i] != which[i - 1]:
            for j in range(m):
                for c in range(j + 1):
                    entry = pull if j == c else 0.0
                    for r in range(p):
                        entry += rows[r, j] * rows[r, c]
                    work.H[j, c] = work.H[c, j] = entry
        for j in range(m):
            work.g[j] = pull * centre[i, j]
            for r in range(p):
                work.g[j] += rows[r, j] * b[i, r]
            side[i, j] = -1 if lo[i, j] >= hi[i, j] else (side[i - 1, j] if warm and i > 0 else 0)
        rounds[i] = box_qp(Box(lo[i], hi[i], centre[i]), x[i], side[i], MOST_ROUNDS, work)
        levels = Levels(rows, b[i], onesided, ends)
        for j in range(m):
            x[i, j] = min(max(x[i, j], lo[i, j]), hi[i, j])
        for r in range(p):
            mu[i, 0, r], mu[i, 1, r] = -slack(r, levels, x[i]), 0.0


def residual_batch(A, b, onesided, ends, lo, hi, centre, which, x, mu, pull, near, out, held, work):
    """Fill `out` (N) with the residuals of optimality that `allocator.mechanism.certificate` explains.

    Arguments are those of `allocate_batch`; `pull` is that of `weigh_batch`, 0 where ‖x - c‖² is a level of its own; a
    variable within `near` of a bound is on it.
    """
    for i in range(len(which)):
        levels = Levels(A[which[i]], b[i], onesided, ends)
        if i == 0 or which[i] != which[i - 1]:
            prepare(levels, work)
        scale(levels, work)
        out[i] = residual(levels, Box(lo[i], hi[i], centre[i]), x[i], mu[i], pull, near, held, work)


FUNCTIONS: tuple[Callable[..., object], ...] = (*one.FUNCTIONS, *proof.FUNCTIONS)
