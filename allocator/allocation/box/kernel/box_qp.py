"""Strictly convex QPs in a box by block principal pivoting: min ½ xᵀH x - gᵀx for lo ≤ x ≤ hi."""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls
from math import sqrt

PATIENCE = 3  # rounds without fewer violations before Murty's rule
POSITIVE = 1e-14  # of a diagonal entry: least remainder in Cholesky's factor


def box_qp(box, x, side, most, work):
    """Solve the QP of `work.H`, `work.g` from the guess `side`; return the rounds, 0 if none of `most` was right.

    `side` of a variable is -1 at lo, 0 free, +1 at hi.
    """
    H, g, right, tries = work.H, work.g, work.right, work.tries
    lo, hi = box.lo, box.hi
    m = len(x)
    tries[0], tries[1] = m + 1, PATIENCE
    for step in range(most):
        for j in range(m):
            x[j] = 0.0 if side[j] == 0 else (lo[j] if side[j] < 0 else hi[j])
        face(x, side, work)
        count, last = 0, 0
        for j in range(m):
            right[j] = side[j]
            if side[j] == 0:
                if x[j] < lo[j]:
                    right[j] = -1
                elif x[j] > hi[j]:
                    right[j] = 1
            elif lo[j] < hi[j]:
                gradient = -g[j]
                for i in range(m):
                    gradient += H[j, i] * x[i]
                if gradient * side[j] > 0.0:
                    right[j] = 0
            if right[j] != side[j]:
                count, last = count + 1, j
        if count == 0:
            return step + 1
        flip(side, right, m, count, last, tries)
    return 0


def face(x, side, work):
    """Move the free variables of `x`, which are 0, to the minimum without bounds, by Cholesky's factor."""
    H, g, C, z, free = work.H, work.g, work.C, work.z, work.free
    n = 0
    for j in range(len(x)):
        if side[j] == 0:
            free[n] = j
            n += 1
    for r in range(n):
        row = free[r]
        rest = g[row]
        for i in range(len(x)):
            rest -= H[row, i] * x[i]
        for s in range(r):
            part = H[row, free[s]]
            for t in range(s):
                part -= C[r, t] * C[s, t]
            C[r, s] = part * C[s, s]
            rest -= C[r, s] * z[s]
        square = H[row, row]
        for t in range(r):
            square -= C[r, t] * C[r, t]
        C[r, r] = 1.0 / sqrt(max(square, POSITIVE * H[row, row]))
        z[r] = rest * C[r, r]
    for r in range(n - 1, -1, -1):
        for s in range(r + 1, n):
            z[r] -= C[s, r] * z[s]
        z[r] *= C[r, r]
    for r in range(n):
        x[free[r]] = z[r]


def flip(side, right, size, count, last, tries):
    """Make the next guess: `count` of `size` entries differ from `right`, the last of them at `last`."""
    if count < tries[0]:
        tries[0], tries[1] = count, PATIENCE
    else:
        tries[1] -= 1
    if tries[1] >= 0:
        for j in range(size):
            side[j] = right[j]
    else:
        side[last] = right[last]
