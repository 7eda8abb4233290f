"""Responses of a sweep's solution to further conditions, by one pass backward and forward: O(N), without factorisation.

A sweep has solved the QP with a set of changes held, the base. The further conditions are *items*:

    a change of the base is released    z = d with d_j = 1, the free ones of the base move for the least cost
    a free change is held at its bound  z = -H⁻¹ a, a = ± e_j, as if its multiplier had grown by 1
    a row holds                         the same, a the row's gradient

H⁻¹ belongs to the free changes of the base; r = H z + a is the response of the Lagrangian's gradient, 0 for free
changes. The slacks s and s_F are two more changes, in the line N, held at 0 in the base; only their rows respond to
them. K, the items' values in each other's responses, reduces the rest to a small symmetric matrix: positive for
released changes, negative for holding items (R. J. Vanderbei's quasi-definite).
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat, merged
from mpc.tracking.compiled.records import Indices, Path, Signs
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.sizes import BOUNDS, FORCE, FREE, JOINTS, NU, NX, NXI, STIFFNESSES, SUPPLY
from mpc.tracking.compiled.structured_qp.stage import (
    advance,
    changed,
    clear,
    entry,
    gone_along,
    gone_back,
    linear_before,
    turned,
)

ITEMS = 96  # items, including the entering one
LAST = ITEMS - 1  # the entering one
GONE, BOUND = -1, 0  # kinds: released, held at a bound; or a row, as in `rows`


class Items(NamedTuple):
    """Items, as lines of arrays."""

    z: Array  # (ITEMS, N + 1, 2)
    r: Array  # (ITEMS, N + 1, 2)
    K: Array  # (ITEMS, ITEMS)
    kind: Indices  # (ITEMS,) GONE, BOUND, or which row
    sample: Indices  # (ITEMS,)
    muscle: Indices  # (ITEMS,) of a change
    side: Indices  # (ITEMS,) of a bound
    multiplier: Array  # (ITEMS,)
    step: Array  # (ITEMS,) of the multipliers, or of the released changes
    L: Array  # (ITEMS, ITEMS) factor of K
    order: Indices  # (ITEMS,) of factorisation
    known: Indices  # (1,) number of valid lines of the factor
    p: Array  # (6,) a gradient by ξ


@inlined
def new_items(N: int) -> Items:
    """Return uninitialised items."""
    lines, few, counts = np.empty((2, ITEMS, N + 1, NU)), np.empty((2, ITEMS, ITEMS)), np.empty((5, ITEMS), np.int64)
    numbers, p = np.empty((2, ITEMS)), np.empty(NXI)
    return Items(
        lines[0], lines[1], few[0], counts[0], counts[1], counts[2], counts[3], numbers[0], numbers[1], few[1],
        counts[4], np.zeros(1, np.int64), p,
    )  # fmt: skip


@inlined_flat
def respond(path: Path, sweep: Sweep, base: Signs, slack: Array, c: int, items: Items, xi: Array) -> None:
    """Set the response to the item `c`, and `xi` (N + 1, 6) to the states of its changes."""
    N, kind, last, muscle = path.A.shape[0], items.kind[c], items.sample[c], items.muscle[c]
    for k in range(N + 1):
        clear(items.z, items.r, c, k)
    if kind == BOUND and (last == N or base[last, muscle] != FREE):  # released before
        xi[:] = 0.0
        items.r[c, last, muscle] = 1.0 * items.side[c]
    elif last == N:
        xi[:] = 0.0
        items.z[c, N, muscle], items.r[c, N, muscle] = 1.0, slack[1 + 2 * muscle]
    else:
        if kind >= SUPPLY:
            items.r[c, N, 1 if kind >= FORCE else 0] = -1.0
        respond_at_rest(path, sweep, base, c, items)
        respond_along(path, sweep, base, c, items, xi)


@inlined_flat
def respond_at_rest(path: Path, sweep: Sweep, base: Signs, c: int, items: Items) -> None:
    """Set z of the item `c` to the changes at ξ = 0, and r to the gradient there: a pass backward."""
    kind, last, muscle, side, p = items.kind[c], items.sample[c], items.muscle[c], items.side[c], items.p
    R, D, inverse, z, r = sweep.R, sweep.D, sweep.inverse, items.z, items.r
    for i in range(NXI):
        p[i] = 0.0
    if kind > BOUND:
        row_gradient(path.slope, last, kind, p)
    for k in range(last, -1, -1):
        linear_before(p, path.A, path.B, k)
        if k < last or kind > BOUND:
            gone_back(inverse, R, k, c, p, z, r)
            continue
        for i in range(NU):
            z[c, k, i] = entry(D, k, i, muscle) if kind == GONE else 0.0
        if kind == BOUND:
            z[c, k, muscle] = r[c, k, muscle] = 1.0 * side
        turned(inverse, k, z, c)
        z[c, k, muscle] += 1.0 if kind == GONE else 0.0
        for i in range(NU):
            for j in range(NXI):
                p[j] += R[k, i, j] * z[c, k, i]


@inlined_flat
def respond_along(path: Path, sweep: Sweep, base: Signs, c: int, items: Items, xi: Array) -> None:
    """Add to z and r of the item `c` the response to their states: a pass forward."""
    R, D, feedback, z, r = sweep.R, sweep.D, sweep.feedback, items.z, items.r
    for i in range(NXI):
        xi[0, i] = 0.0
    for k in range(path.A.shape[0]):
        gone_along(R, D, feedback, base, k, c, xi, z, r)
        advance(path.A, path.B, k, xi)


@inlined_flat
def compare(path: Path, size: int, c: int, items: Items, xi: Array) -> None:
    """Set K of the item `c`, whose response has the states `xi`, with itself, the first `size` and the entering one."""
    N = path.A.shape[0]
    for q in range(ITEMS):
        wanted = q < size or q == LAST
        if wanted or q == c:
            k, i, kind = items.sample[q], items.muscle[q], items.kind[q]
            said = 0.0
            if kind == GONE:
                said = items.r[c, k, i]
            elif kind == BOUND:
                said = items.side[q] * items.z[c, k, i]
            else:
                said = row_value(path.slope, k, kind, xi)
                if kind >= SUPPLY:
                    said -= items.z[c, N, 1 if kind >= FORCE else 0]
            items.K[q, c] = said
            items.K[c, q] = said


@merged
def row_gradient(slope: Array, k: int, kind: int, p: Array) -> None:
    """Add to `p` (6,) the gradient of the row `kind` by ξ[k + 1]."""
    if kind < SUPPLY:
        above = kind < BOUNDS + NU
        p[NX + kind - (BOUNDS if above else BOUNDS + NU)] += 1.0 if above else -1.0
    elif kind < FORCE:
        above = kind < SUPPLY + JOINTS
        p[kind - (SUPPLY if above else SUPPLY + JOINTS)] += 1.0 if above else -1.0
    else:
        for i in range(NX):
            p[i] -= slope[k + 1, STIFFNESSES + kind - FORCE, i]


@inlined_flat
def row_value(slope: Array, k: int, kind: int, xi: Array) -> float:
    """Return the value of the row `kind` of the sample k, without its slack."""
    if kind < SUPPLY:
        above = kind < BOUNDS + NU
        w = xi[k + 1, NX + kind - (BOUNDS if above else BOUNDS + NU)]
        return float(w if above else -w)
    if kind < FORCE:
        above = kind < SUPPLY + JOINTS
        angle = xi[k + 1, kind - (SUPPLY if above else SUPPLY + JOINTS)]
        return float(angle if above else -angle)
    return -changed(slope, k + 1, STIFFNESSES + kind - FORCE, xi)


@inlined_flat
def solve_items(size: int, items: Items) -> None:
    """Replace `step` (size,) by the solution x of K x = step; K is factorised as L D Lᵀ, released changes first.

    Lines of L are kept up to the first that changed items affect.
    """
    L, order, x, number, known = items.L, items.order, items.step, 0, 0
    for turn in range(2):
        for q in range(size):
            if (items.kind[q] == GONE) == (turn == 0):
                if known == number and number < items.known[0] and order[number] == q:
                    known += 1
                order[number] = q
                number += 1
    for m in range(size):
        p = order[m]
        for n in range(m + 1 if m >= known else 0):
            total = items.K[p, order[n]]
            for j in range(n):
                total -= L[m, j] * L[n, j] * L[j, j]
            L[m, n] = total / L[n, n] if n < m else total
        for n in range(m):
            x[p] -= L[m, n] * x[order[n]]
    items.known[0] = size
    for m in range(size - 1, -1, -1):
        p = order[m]
        x[p] /= L[m, m]
        for n in range(m + 1, size):
            x[p] -= L[n, m] * x[order[n]]


@inlined_flat
def remove(size: int, c: int, items: Items) -> int:
    """Remove the item `c` of the first `size`, and return how many remain; the last one takes its place."""
    for m in range(items.known[0]):
        if items.order[m] == c:
            items.known[0] = m
            break
    if c != size - 1:
        copy_item(size - 1, c, size - 1, items)
    return size - 1


@inlined_flat
def copy_item(source: int, target: int, size: int, items: Items) -> None:
    """Copy an item over another one, with its K for the first `size` items and the entering one."""
    for k in range(items.z.shape[1]):
        for i in range(NU):
            items.z[target, k, i], items.r[target, k, i] = items.z[source, k, i], items.r[source, k, i]
    items.kind[target], items.sample[target] = items.kind[source], items.sample[source]
    items.muscle[target], items.side[target] = items.muscle[source], items.side[source]
    items.multiplier[target] = items.multiplier[source]
    own = items.K[source, source]
    for q in range(ITEMS):
        if q < size or q == LAST:
            items.K[target, q] = items.K[source, q]
            items.K[q, target] = items.K[source, q]
    items.K[target, target] = own
