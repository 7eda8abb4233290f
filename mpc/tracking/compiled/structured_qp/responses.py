"""A sweep's solution answers to what is asked of it besides, in one pass backward and forward: O(N), without factors.

A sweep has solved the QP with a set of changes held, the base. What is asked besides are *items*:

    a change of the base is let go      z = d with d_j = 1, by which the free ones of the base move for the least cost
    a free change is held at its bound  z = -H⁻¹ a, a = ± e_j, as if its multiplier had grown by 1
    a row holds                         the same, a the row's gradient

H⁻¹ being that of what is free in the base; r = H z + a is what the gradient of the Lagrangian answers, 0 there. The
slacks s and s_F are two changes more, of the line N, held at 0 in the base; no stage answers to them but their rows.
With what the items' own rows and gradients say to each other's answers, K, all else about them is a small symmetric
matrix: positive where changes are let go, negative where something holds (quasi-definite).
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined, merged
from mpc.tracking.compiled.records import Path
from mpc.tracking.compiled.structured_qp.riccati import FREE, Sweep
from mpc.tracking.compiled.structured_qp.stage import advance, changed, linear_before

FEW = 24  # items, the one that enters included
GONE, BOUND, SOFT = -1, 0, 8  # kinds: let go, held at a bound; the first of the soft rows, as in `rows`


class Items(NamedTuple):
    """The items are lines of arrays, of which the last is for the one that enters."""

    z: Array  # (FEW, N + 1, 2)
    r: Array  # (FEW, N + 1, 2)
    K: Array  # (FEW, FEW)
    kind: Any  # (FEW,) GONE, BOUND, or which row
    sample: Any  # (FEW,)
    muscle: Any  # (FEW,)
    side: Any  # (FEW,) of a bound
    multiplier: Array  # (FEW,)
    step: Array  # (FEW,)
    L: Array  # (FEW, FEW) factor of K
    order: Any  # (FEW,) in which it is factorised


@inlined
def new_items(N: int) -> Items:
    """Return items that are not set yet."""
    lines, few, counts = np.empty((2, FEW, N + 1, 2)), np.empty((2, FEW, FEW)), np.empty((5, FEW), np.int64)
    numbers = np.empty((2, FEW))
    return Items(
        lines[0], lines[1], few[0], counts[0], counts[1], counts[2], counts[3], numbers[0], numbers[1], few[1],
        counts[4],
    )  # fmt: skip


@inlined
def respond(path: Path, sweep: Sweep, base: Any, slack: Array, c: int, items: Items, xi: Array) -> None:
    """Set what answers to the item `c`, and `xi` (N + 1, 6) to where its changes lead."""
    N, kind, last, muscle = path.A.shape[0], items.kind[c], items.sample[c], items.muscle[c]
    z, r = items.z, items.r
    z[c, N, 0], z[c, N, 1], r[c, N, 0], r[c, N, 1] = 0.0, 0.0, 0.0, 0.0
    if kind == BOUND and (last == N or base[last, muscle] != FREE):
        # what was let go before: nothing answers
        for k in range(N):
            z[c, k, 0], z[c, k, 1], r[c, k, 0], r[c, k, 1] = 0.0, 0.0, 0.0, 0.0
        xi[:] = 0.0
        r[c, last, muscle] = 1.0 * items.side[c]
    elif last == N:
        for k in range(N):
            z[c, k, 0], z[c, k, 1], r[c, k, 0], r[c, k, 1] = 0.0, 0.0, 0.0, 0.0
        xi[:] = 0.0
        z[c, N, muscle], r[c, N, muscle] = 1.0, slack[1 + 2 * muscle]
    else:
        if kind >= SOFT:
            r[c, N, (kind - SOFT) // 2] = -1.0
        back(path, sweep, base, c, items)
        forth(path, sweep, base, c, items, xi)


@inlined
def back(path: Path, sweep: Sweep, base: Any, c: int, items: Items) -> None:
    """Set z of the item `c` to what the changes are where ξ is 0, and r to the gradient there."""
    N, kind, last, muscle, p = path.A.shape[0], items.kind[c], items.sample[c], items.muscle[c], np.zeros(6)
    R, D, inverse, z, r = sweep.R, sweep.D, sweep.inverse, items.z, items.r
    for k in range(last + 1, N):
        z[c, k, 0], z[c, k, 1], r[c, k, 0], r[c, k, 1] = 0.0, 0.0, 0.0, 0.0
    if kind > BOUND:
        row_gradient(path.slope, last, kind, p)
    for k in range(last, -1, -1):
        linear_before(p, path.A, path.B, k)
        g0, g1, v0, v1 = p[4], p[5], 0.0, 0.0
        if k == last and kind == BOUND:
            g0, g1 = (1.0 * items.side[c], g1) if muscle == 0 else (g0, 1.0 * items.side[c])
        elif k == last and kind == GONE:
            v0, v1 = 1.0 - muscle, 1.0 * muscle
            if base[k, 1 - muscle] == FREE:
                v0, v1 = (v0, -inverse[k, 2] * D[k, 1]) if muscle == 0 else (-inverse[k, 0] * D[k, 1], v1)
        if k != last or kind != GONE:
            v0, v1 = -inverse[k, 0] * g0 - inverse[k, 1] * g1, -inverse[k, 1] * g0 - inverse[k, 2] * g1
        z[c, k, 0], z[c, k, 1] = v0, v1
        r[c, k, 0], r[c, k, 1] = g0 + D[k, 0] * v0 + D[k, 1] * v1, g1 + D[k, 1] * v0 + D[k, 2] * v1
        for i in range(6):
            p[i] += R[k, 0, i] * v0 + R[k, 1, i] * v1


@merged
def row_gradient(slope: Array, k: int, kind: int, p: Array) -> None:
    """Set `p` (6,) to the gradient of the row `kind` by ξ[k + 1]."""
    for i in range(6):
        p[i] = 0.0
    if kind < SOFT:
        p[4 + kind % 2] = 1.0 if kind < 6 else -1.0
    elif kind < 10:
        p[0] = 1.0 if kind == 8 else -1.0
    else:
        for i in range(4):
            p[i] = -slope[k + 1, kind - 9, i]


@inlined
def forth(path: Path, sweep: Sweep, base: Any, c: int, items: Items, xi: Array) -> None:
    """Set z and r of the item `c` from where ξ is 0 to where they lead."""
    R, D, feedback, z, r = sweep.R, sweep.D, sweep.feedback, items.z, items.r
    for i in range(6):
        xi[0, i] = 0.0
    for k in range(path.A.shape[0]):
        v0, v1, g0, g1 = 0.0, 0.0, 0.0, 0.0
        for i in range(6):
            v0 += feedback[k, 0, i] * xi[k, i]
            v1 += feedback[k, 1, i] * xi[k, i]
            g0 += R[k, 0, i] * xi[k, i]
            g1 += R[k, 1, i] * xi[k, i]
        z[c, k, 0] += v0
        z[c, k, 1] += v1
        r[c, k, 0] = 0.0 if base[k, 0] == FREE else r[c, k, 0] + g0 + D[k, 0] * v0 + D[k, 1] * v1
        r[c, k, 1] = 0.0 if base[k, 1] == FREE else r[c, k, 1] + g1 + D[k, 1] * v0 + D[k, 2] * v1
        xi[k + 1, 4], xi[k + 1, 5] = xi[k, 4] + z[c, k, 0], xi[k, 5] + z[c, k, 1]
        advance(path.A, path.B, k, xi)


@inlined
def compare(path: Path, size: int, c: int, items: Items, xi: Array) -> None:
    """Set K of the item `c`, whose answer leads to `xi`, with itself, the first `size`, and the one that enters."""
    for q in range(FEW):
        if q < size or q == c or q == FEW - 1:
            k, i, kind = items.sample[q], items.muscle[q], items.kind[q]
            if kind == GONE:
                said = items.r[c, k, i]
            elif kind == BOUND:
                said = items.side[q] * items.z[c, k, i]
            else:
                said = row_value(path.slope, k, kind, xi)
                if kind >= SOFT:
                    said -= items.z[c, path.A.shape[0], (kind - SOFT) // 2]
            items.K[q, c] = items.K[c, q] = said


@merged
def row_value(slope: Array, k: int, kind: int, xi: Array) -> float:
    """Return the value of the row `kind` of the sample k, without its slack."""
    if kind < SOFT:
        return float(xi[k + 1, 4 + kind % 2] if kind < 6 else -xi[k + 1, 4 + kind % 2])
    if kind < 10:
        return float(xi[k + 1, 0] if kind == 8 else -xi[k + 1, 0])
    return -changed(slope, k + 1, kind - 9, xi)


@inlined
def remove(size: int, c: int, items: Items) -> int:
    """Remove the item `c` of the first `size`, and return how many are left: the last one takes its place."""
    if c != size - 1:
        copy_item(size - 1, c, size - 1, items)
    return size - 1


@inlined
def copy_item(source: int, target: int, size: int, items: Items) -> None:
    """Copy an item over another one, of `size` before it; what the one that enters has to say to it, too."""
    for k in range(items.z.shape[1]):
        for i in range(2):
            items.z[target, k, i], items.r[target, k, i] = items.z[source, k, i], items.r[source, k, i]
    items.kind[target], items.sample[target], items.muscle[target] = (
        items.kind[source], items.sample[source], items.muscle[source],
    )  # fmt: skip
    items.side[target], items.multiplier[target] = items.side[source], items.multiplier[source]
    own = items.K[source, source]
    for q in range(FEW):
        if q < size or q == FEW - 1:
            items.K[target, q] = items.K[q, target] = items.K[source, q]
    items.K[target, target] = own


__all__ = [
    "BOUND", "FEW", "GONE", "SOFT", "Items", "compare", "copy_item", "new_items", "remove", "respond", "row_gradient",
    "row_value",
]  # fmt: skip
