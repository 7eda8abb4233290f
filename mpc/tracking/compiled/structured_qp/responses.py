"""Responses of a sweep's solution to further conditions, by one pass backward and forward: O(N), without factorisation.

A sweep has solved the QP with a set of changes held, the base. The further conditions are *items*:

    a change of the base is released    z = d with d_j = 1, the free ones of the base move for the least cost
    a limit holds                       z = -H⁻¹ a, a the limit's gradient, as if its multiplier had grown by 1

H⁻¹ belongs to the free changes of the base; r = H z + a is the response of the Lagrangian's gradient, 0 for free
changes. The slacks s and s_F are two more changes, in the line N, held at 0 in the base; only their rows respond to
them. K, the items' values in each other's responses, reduces the rest to a small symmetric matrix: positive for
released changes, negative for holding items (R. J. Vanderbei's quasi-definite).

The limits of a sample k that items can hold are changes and commands, and the soft rows a·y ≤ b:

    BOUND       ±v_i ≤ …                              changes: the slew
    SUPPLY      ±w_i ≤ …                              commands of k + 1: the supply
    RANGE …     δθ - s ≤ …,  then  -δθ - s ≤ …        the joint range, in the state k + 1
    FORCE …     -D_i δx - s_F ≤ F_i - F_min           taut cables
"""

from typing import Annotated, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounds, Indices, Path
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.sizes import (
    BOUND,
    FORCE,
    GONE,
    JOINTS,
    NU,
    NX,
    NXI,
    RANGE,
    STIFFNESSES,
    SUPPLY,
)
from mpc.tracking.compiled.structured_qp.stage import (
    advance,
    answered,
    changed,
    clear,
    first_of,
    gone_along,
    linear_before,
)


class Items(NamedTuple):
    """Items, as lines of arrays; the last one is the entering item."""

    z: Annotated[Array, "M", "N + 1", "m"]
    r: Annotated[Array, "M", "N + 1", "m"]
    K: Annotated[Array, "M", "M"]
    kind: Annotated[Indices, "M"]  # GONE, BOUND, SUPPLY, or which soft row
    sample: Annotated[Indices, "M"]
    muscle: Annotated[Indices, "M"]  # of a change
    side: Annotated[Indices, "M"]  # of a bound: 1 above, -1 below
    multiplier: Annotated[Array, "M"]
    step: Annotated[Array, "M"]  # of the multipliers, or of the released changes
    L: Annotated[Array, "M", "M"]  # factor of K
    order: Annotated[Indices, "M"]  # of factorisation
    known: Annotated[Indices, 1]  # number of valid lines of the factor
    p: Annotated[Array, "xi"]  # a gradient by ξ


@inlined
def new_items(N: int, M: int) -> Items:
    """Return uninitialised items."""
    lines, few, counts = np.empty((2, M, N + 1, NU)), np.empty((2, M, M)), np.empty((5, M), np.int64)
    numbers = np.empty((2, M))
    return Items(
        lines[0], lines[1], few[0], counts[0], counts[1], counts[2], counts[3], numbers[0], numbers[1], few[1],
        counts[4], np.zeros(1, np.int64), np.empty(NXI),
    )  # fmt: skip


@inlined_flat
def respond(path: Path, slack: Array, sweep: Sweep, size: int, c: int, items: Items, xi: Array) -> None:
    """Set the response to the item `c`, and its K with the first `size` items and the entering one."""
    N, kind, last, muscle = path.A.shape[0], items.kind[c], items.sample[c], items.muscle[c]
    for k in range(N + 1):
        clear(items.z, items.r, c, k)
    if last < N:
        respond_at_rest(path, sweep, c, items)
    for i in range(NXI):
        xi[0, i] = 0.0
    for k in range(N):
        if last < N:
            gone_along(sweep.R, sweep.D, sweep.feedback, sweep.held, k, c, xi, items.z, items.r)
            advance(path.A, path.B, k, xi)
        else:
            for i in range(NXI):
                xi[k + 1, i] = 0.0
    if kind >= RANGE:
        items.r[c, N, slack_of(kind)] = -1.0
    elif last == N and kind == GONE:
        items.z[c, N, muscle], items.r[c, N, muscle] = 1.0, slack[1 + 2 * muscle]
    elif last == N:
        items.r[c, N, muscle] = 1.0 * items.side[c]
    for q in range(size):
        items.K[q, c] = answer(path, q, c, items, xi)
        items.K[c, q] = items.K[q, c]
    enters = items.kind.size - 1
    items.K[enters, c] = answer(path, enters, c, items, xi)
    items.K[c, enters] = items.K[enters, c]
    items.K[c, c] = answer(path, c, c, items, xi)


@inlined_flat
def respond_at_rest(path: Path, sweep: Sweep, c: int, items: Items) -> None:
    """Set z of the item `c` to the changes at ξ = 0, and r to the gradient there, by a backward pass."""
    kind, last, muscle, side, p = items.kind[c], items.sample[c], items.muscle[c], items.side[c], items.p
    for i in range(NXI):
        p[i] = 0.0
    if kind >= RANGE:
        row_push(path.slope, last, kind, 1.0, p)
    elif kind == SUPPLY:
        p[NX + muscle] = 1.0 * side
    for k in range(last, -1, -1):
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            items.r[c, k, i] = p[NX + i]
        if k == last and kind == BOUND:
            items.r[c, k, muscle] += 1.0 * side
        gone = muscle if k == last and kind == GONE else -1
        answered(sweep.R, sweep.D, sweep.inverse, sweep.held, k, c, gone, p, items.z, items.r)


@inlined_flat
def answer(path: Path, q: int, c: int, items: Items, xi: Array) -> float:
    """Return the entry of K for the item `q` and the response to `c`, whose states are `xi`."""
    k, i, kind = items.sample[q], items.muscle[q], items.kind[q]
    if kind == GONE:
        return float(items.r[c, k, i])
    if kind == BOUND:
        return float(items.side[q] * items.z[c, k, i])
    if kind == SUPPLY:
        return float(items.side[q] * xi[k + 1, NX + i])
    return float(row_value(path.slope, k, kind, xi) - items.z[c, path.A.shape[0], slack_of(kind)])


@inlined_flat
def solve_items(size: int, items: Items) -> None:
    """Replace `step` (size,) by the solution x of K x = step; K is factorised as L D Lᵀ, released changes first.

    Lines of L are kept up to the first that a change of the items has touched.
    """
    K, L, order, x, number, known = items.K, items.L, items.order, items.step, 0, 0
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
            total = K[p, order[n]]
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
def discard(size: int, c: int, items: Items) -> int:
    """Remove the item `c` of the first `size`, and return how many remain; the last one takes its place."""
    forget(c, items)
    if c != size - 1:
        copy_item(size - 1, c, size - 1, items)
    return size - 1


@inlined_flat
def forget(c: int, items: Items) -> None:
    """Mark the lines of the factor from the item `c` on as invalid."""
    for m in range(items.known[0]):
        if items.order[m] == c:
            items.known[0] = m
            return


@inlined_flat
def copy_item(source: int, target: int, size: int, items: Items) -> None:
    """Copy an item over another one, with its K for the first `size` items and the entering one."""
    for k in range(items.z.shape[1]):
        for i in range(NU):
            items.z[target, k, i], items.r[target, k, i] = items.z[source, k, i], items.r[source, k, i]
    name_item(source, target, items)
    own, enters = items.K[source, source], items.kind.size - 1
    for q in range(size):
        items.K[target, q] = items.K[source, q]
        items.K[q, target] = items.K[source, q]
    items.K[target, enters] = items.K[source, enters]
    items.K[enters, target] = items.K[source, enters]
    items.K[target, target] = own


@inlined_flat
def set_limit(q: int, kind: int, k: int, i: int, side: int, items: Items) -> None:
    """Set the limit of an item."""
    items.kind[q], items.sample[q], items.muscle[q], items.side[q] = kind, k, i, side


@inlined_flat
def name_item(source: int, target: int, items: Items) -> None:
    """Copy the limit of an item and its multiplier, without its response."""
    items.kind[target], items.sample[target] = items.kind[source], items.sample[source]
    items.muscle[target], items.side[target] = items.muscle[source], items.side[source]
    items.multiplier[target] = items.multiplier[source]


@inlined_flat
def find_item(kind: int, k: int, i: int, size: int, items: Items) -> int:
    """Return the number of an item among the first `size`, or -1."""
    for q in range(size):
        if items.kind[q] == kind and items.sample[q] == k and items.muscle[q] == i:
            return q
    return -1


WIDTHS = 0.04, 0.1, 0.02, 4.0  # equivalent violations of slew, supply, range, force [bar], [bar], [rad], [N]


@inlined_flat
def width(kind: int) -> float:
    """Return the violation of this kind that counts as much as those of others."""
    return WIDTHS[3] if kind >= FORCE else WIDTHS[2] if kind >= RANGE else WIDTHS[1] if kind == SUPPLY else WIDTHS[0]


@inlined_flat
def row_push(slope: Array, k: int, kind: int, by: float, p: Array) -> None:
    """Add to `p` (6,), a gradient by ξ[k + 1], that of the soft row `kind` times `by`."""
    if kind >= FORCE:
        for i in range(NX):
            p[i] -= by * slope[k + 1, STIFFNESSES + kind - FORCE, i]
    elif kind >= RANGE + JOINTS:
        p[kind - RANGE - JOINTS] -= by
    else:
        p[kind - RANGE] += by


@inlined_flat
def row_value(slope: Array, k: int, kind: int, xi: Array) -> float:
    """Return the value of the soft row `kind` without its slack."""
    if kind >= FORCE:
        return float(-changed(slope, k + 1, STIFFNESSES + kind - FORCE, xi))
    if kind >= RANGE + JOINTS:
        return float(-xi[k + 1, kind - RANGE - JOINTS])
    return float(xi[k + 1, kind - RANGE])


@inlined_flat
def row_side(path: Path, bounds: Bounds, k: int, kind: int) -> float:
    """Return the side b of the soft row `kind`."""
    if kind >= FORCE:
        return float(path.y[k + 1, STIFFNESSES + kind - FORCE] - bounds.min_force)
    if kind >= RANGE + JOINTS:
        i = kind - RANGE - JOINTS
        return float(path.x[k + 1, i] - first_of(bounds.left, i))
    i = kind - RANGE
    return float(first_of(bounds.right, i) - path.x[k + 1, i])


@inlined_flat
def slack_of(kind: int) -> int:
    """Return which slack a soft row has: 0 is s, 1 is s_F."""
    return 1 if kind >= FORCE else 0
