"""The QP without its rows is solved by an active set where few changes are free: from vertex to vertex, on columns.

Where a joint that is disturbed is driven along its slew, nearly all changes are at a bound, and noise moves those
samples by one or two at which a command turns. Sweeps that guess all of the set anew then go in circles, since the
Hessian's condition is 10⁶ and more; an interior point takes half a dozen factorisations. But a column H e_j of the
Hessian, for a change j that leaves its bound, costs a rollout and its adjoint, O(N), and what is solved has the size of
the few that are free:

    H_FF p = -r_F,     z ← z + a p,  r ← r + a H_·F p,     r = H z + f

A primal active-set method (J. Nocedal and S. J. Wright, Numerical Optimization, 2006, algorithm 16.3): the step a goes
as far as to the first bound, which then holds; where it goes all the way, that change is let go which pushes most in
vain. It begins in the vertex that is guessed and gives up after TURNS steps or with FEW columns; it is the caller's
business to prove the answer.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined, merged
from mpc.tracking.compiled.records import Bounded, Cost, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.newton import adjoint, gradients
from mpc.tracking.compiled.structured_qp.riccati import FREE, LOWER, UPPER
from mpc.tracking.compiled.structured_qp.stage import advance, changed, linear_before

FEW = 16  # columns
TURNS = 24  # steps
PUSHES = 1e-3  # [-] of the gradient that is allowed to be left: less pushes nothing


class Columns(NamedTuple):
    """The columns are those of the Hessian for changes that have left their bounds."""

    H: Array  # (FEW, N, 2)
    place: Any  # (FEW, 2) sample and muscle of each
    number: Any  # (N, 2) of each change's column, -1 if there is none
    L: Array  # (FEW, FEW) Cholesky's factor of H_FF
    p: Array  # (FEW,)
    free: Any  # (FEW,) columns of what is free


@inlined
def new_columns(N: int) -> Columns:
    """Return columns that are not set yet."""
    integers = np.int64
    return Columns(
        np.empty((FEW, N, 2)), np.empty((FEW, 2), integers), np.empty((N, 2), integers), np.empty((FEW, FEW)),
        np.empty(FEW), np.empty(FEW, integers),
    )  # fmt: skip


@inlined
def few_free(there: Any, held: Any) -> bool:
    """Return whether no more than half of the columns are needed to begin with."""
    number = 0
    for k in range(there.size):
        if there[k]:
            number += (held[k, 0] == FREE) + (held[k, 1] == FREE)
    return number <= FEW // 2


@inlined
def along_edges(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, held: Any, c: Columns, gx: Array,
    gv: Array, r: Array
) -> bool:  # fmt: skip
    """Return whether `at` comes to the solution of the QP without rows; `held` (N, 2) is the set to begin with, and
    becomes the one that is found.
    """
    least, size = PUSHES * setting.accuracy * setting.curvature, 0
    begin(path, bounded, held, at)
    gradients(path, errors, setting.cost, at, gx, gv)
    adjoint(path, gx, gv, r)
    c.number[:] = -1
    for k in range(bounded.there.size):
        for i in range(2):
            if held[k, i] == FREE:
                size = add_column(path, setting.cost, k, i, size, at.xi, c)
    for _ in range(TURNS):
        if step_to_bound(bounded, held, size, at.v, c, r):
            continue
        k, i = wrong_most(bounded, held, r, least)
        if k < 0:
            return True
        held[k, i] = FREE
        if c.number[k, i] < 0:
            if size == FEW:
                return False
            size = add_column(path, setting.cost, k, i, size, at.xi, c)
    return False


@inlined
def begin(path: Path, bounded: Bounded, held: Any, at: Point) -> None:
    """Set the point to the vertex that is `held`; what is free begins at 0."""
    for i in range(6):
        at.xi[0, i] = 0.0
    for k in range(bounded.there.size):
        for i in range(2):
            side, lower, upper = held[k, i], bounded.lower[k, i], bounded.upper[k, i]
            at.v[k, i] = lower if side == LOWER else upper if side == UPPER else 0.0
            at.xi[k + 1, 4 + i] = at.xi[k, 4 + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)


@inlined
def add_column(path: Path, cost: Cost, k: int, i: int, size: int, xi: Array, c: Columns) -> int:
    """Add the column of the change `i` of the sample `k`, and return how many there are now; `xi` is lost."""
    N, H = c.number.shape[0], c.H[size]
    c.number[k, i], c.place[size, 0], c.place[size, 1] = size, k, i
    for j in range(6):
        xi[k, j] = 0.0
    for m in range(k, N):
        xi[m + 1, 4], xi[m + 1, 5] = 1.0 - i, 1.0 * i
        advance(path.A, path.B, m, xi)
    p = np.empty(6)
    for j in range(6):
        p[j] = cost.e[j - 4] * xi[N, j] if j > 3 else 0.0
        for m in range(6):
            p[j] += cost.end[j, m] * xi[N, m]
    for m in range(N - 1, -1, -1):
        linear_before(p, path.A, path.B, m)
        H[m, 0], H[m, 1] = p[4], p[5]
        if m > k:
            charge(path.slope, m, cost, xi, p)
    H[k, i] += cost.change[i]
    return size + 1


@merged
def charge(slope: Array, k: int, cost: Cost, xi: Array, p: Array) -> None:
    """Add to `p` (6,) the gradient of what ξ[k] costs."""
    for i in range(4):
        p[i] += cost.x[i] * xi[k, i]
    for m in range(3):
        if cost.y[m] != 0.0:
            y = cost.y[m] * changed(slope, k, m, xi)
            for i in range(4):
                p[i] += y * slope[k, m, i]
    for i in range(2):
        p[4 + i] += cost.e[i] * xi[k, 4 + i]


@inlined
def step_to_bound(bounded: Bounded, held: Any, size: int, v: Array, c: Columns, r: Array) -> bool:
    """Go to the least cost in what is free, or to the first bound on the way there, which then holds; return whether
    there was one.
    """
    number, N = 0, v.shape[0]
    for j in range(size):
        if held[c.place[j, 0], c.place[j, 1]] == FREE:
            c.free[number] = j
            number += 1
    if number == 0:
        return False
    solve_free(number, c, r)
    share, first = 1.0, -1
    for a in range(number):
        k, i, p = c.place[c.free[a], 0], c.place[c.free[a], 1], c.p[a]
        bound = bounded.upper[k, i] if p > 0.0 else bounded.lower[k, i]
        if (bound - v[k, i]) / p < share:
            share, first = (bound - v[k, i]) / p, a
    for a in range(number):
        j, p = c.free[a], share * c.p[a]
        v[c.place[j, 0], c.place[j, 1]] += p
        for k in range(N):
            r[k, 0] += p * c.H[j, k, 0]
            r[k, 1] += p * c.H[j, k, 1]
    if first < 0:
        return False
    k, i = c.place[c.free[first], 0], c.place[c.free[first], 1]
    held[k, i], v[k, i] = (UPPER, bounded.upper[k, i]) if c.p[first] > 0.0 else (LOWER, bounded.lower[k, i])
    return True


@inlined
def solve_free(number: int, c: Columns, r: Array) -> None:
    """Set p to the solution of H_FF p = -r_F by Cholesky's factorisation."""
    L, p = c.L, c.p
    for a in range(number):
        k, i = c.place[c.free[a], 0], c.place[c.free[a], 1]
        rest = -r[k, i]
        for b in range(a + 1):
            total = c.H[c.free[b], k, i]
            for m in range(b):
                total -= L[a, m] * L[b, m]
            if b < a:
                L[a, b] = total / L[b, b]
                rest -= L[a, b] * p[b]
            else:
                L[a, a] = np.sqrt(total)
        p[a] = rest / L[a, a]
    for a in range(number - 1, -1, -1):
        for b in range(a + 1, number):
            p[a] -= L[b, a] * p[b]
        p[a] /= L[a, a]


@inlined
def wrong_most(bounded: Bounded, held: Any, r: Array, least: float) -> tuple[int, int]:
    """Return sample and muscle of the change whose gradient pushes it away from its bound most, (-1, 0) for none."""
    worst, sample, muscle = least, -1, 0
    for k in range(bounded.there.size):
        for i in range(2):
            if bounded.lower[k, i] < bounded.upper[k, i]:
                push = -r[k, i] if held[k, i] == LOWER else r[k, i] if held[k, i] == UPPER else 0.0
                if push > worst:
                    worst, sample, muscle = push, k, i
    return sample, muscle


__all__ = ["Columns", "along_edges", "few_free", "new_columns"]
