"""The QP is solved by a dual active-set method from a sweep's set, where that is wrong in a few of its members.

Sweeps that guess all of the set anew then go in circles, since the Hessian's condition is 10⁶ and more, and an interior
point takes a dozen of factorisations. This one takes one: it lets go what its bound pushes in vain, and then lets the
bounds and rows enter that are broken, one after the other, each with as much of its multiplier t as

    full        it needs to hold:  t = violation / (-a·dz)
    partial     another multiplier allows before it changes its sign: that one goes, and the same one enters again

(D. Goldfarb and A. Idnani, Mathematical Programming 27, 1983; R. A. Bartlett and L. T. Biegler, Optimization and
Engineering 7, 2006, for the Schur complement of a set that is known nearly.) Every step raises the dual cost, and what
is broken no more and pushes nowhere in vain is the solution. What answers to whom is in `responses`. It gives up with
FEW items, or after STEPS; it is the caller's business to prove the answer.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined, merged
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.newton import BOUNDS, adjoint, gradients
from mpc.tracking.compiled.structured_qp.responses import (
    BOUND,
    FEW,
    GONE,
    SOFT,
    Items,
    compare,
    copy_item,
    new_items,
    remove,
    respond,
    row_gradient,
    row_value,
)
from mpc.tracking.compiled.structured_qp.riccati import FREE, LOWER, UPPER, Sweep
from mpc.tracking.compiled.structured_qp.rows import WIDTH, sides, values
from mpc.tracking.compiled.structured_qp.stage import advance

STEPS = 48
PUSHES = 1e-3  # [-] of the gradient that is allowed to be left: less pushes nothing
BREAKS = 1e-12  # [bar], [rad], [N]: less breaks no bound
ROW_BREAKS = 1e-8  # [bar], [rad], [N]: less breaks no row
FLAT = 1e-10  # [-] of its terms: less is no slope
LAST = FEW - 1  # the item that enters


class Active(NamedTuple):
    """The active set is what holds, and what is known of the point where it does; slacks are in the last lines."""

    base: Any  # (N + 1, 2) what is held in the sweep's solution
    held: Any  # (N + 1, 2) what is held now
    lower: Array  # (N + 1, 2)
    upper: Array  # (N + 1, 2)
    z: Array  # (N + 1, 2) changes and slacks
    r: Array  # (N + 1, 2) gradient of the Lagrangian without the bounds' multipliers
    dz: Array  # (N + 1, 2)
    dr: Array  # (N + 1, 2)
    b: Array  # (N + 1, 12) of the rows
    value: Array  # (N + 1, 12)
    xi: Array  # (N + 1, 6)
    items: Items


@merged
def new_active(N: int) -> Active:
    """Return an active set that is not set yet."""
    sides, numbers = np.empty((2, N + 1, 2), np.int8), np.empty((6, N + 1, 2))
    return Active(
        sides[0], sides[1], numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5],
        np.empty((N + 1, 12)), np.empty((N + 1, 12)), np.empty((N + 1, 6)), new_items(N),
    )  # fmt: skip


@merged
def active_set(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, count: int, at: Point, sweep: Sweep,
    a: Active
) -> bool:  # fmt: skip
    """Return whether `at` comes from a sweep's solution to that of the QP with the first `count` rows of every sample,
    proved; what is `held` of the sweep becomes what is held then.
    """
    begin(bounded, setting.slack, sweep, at, a)
    sides(path, u, setting.bounds, bounded, a.b)
    size = exchanged(path, setting, sweep, count, let_go(path, setting, sweep, a), at, a)
    if size < 0:
        return False
    end(path, bounded, at, sweep, a)
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    return proved_with_rows(path, setting, bounded, size, at, sweep, a)


@merged
def reversed_instead(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, first: Array, at: Point, other: Point, sweep: Sweep
) -> bool:  # fmt: skip
    """Reverse what is `held` of a sweep and pushed away from its bound, if most of it is and that costs less; return
    whether that is so. The cost's gradient by v is `r` of the sweep at the point and `first` (N, 2) at the origin.
    """
    N, held, r, wrong, number, cost, turned = at.v.shape[0], sweep.held, sweep.r, 0, 0, 0.0, 0.0
    other.xi[0, :] = 0.0
    for k in range(N):
        for i in range(2):
            side, lower, upper = held[k, i], bounded.lower[k, i], bounded.upper[k, i]
            if side != FREE and lower < upper:
                number += 1
                if side * r[k, i] > 0.0:
                    wrong += 1
                    side = -side
            cost += (first[k, i] + r[k, i]) * at.v[k, i]
            other.v[k, i] = lower if side == LOWER else upper if side == UPPER else 0.0
            other.xi[k + 1, 4 + i] = other.xi[k, 4 + i] + other.v[k, i]
        advance(path.A, path.B, k, other.xi)
    if 2 * wrong <= number:
        return False
    gradients(path, errors, setting.cost, other, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.g)
    for k in range(N):
        turned += (first[k, 0] + sweep.g[k, 0]) * other.v[k, 0] + (first[k, 1] + sweep.g[k, 1]) * other.v[k, 1]
    if turned >= cost:
        return False
    for k in range(N):
        for i in range(2):
            if held[k, i] * r[k, i] > 0.0 and bounded.lower[k, i] < bounded.upper[k, i]:
                held[k, i] = -held[k, i]
    return True


@merged
def begin(bounded: Bounded, slack: Array, sweep: Sweep, at: Point, a: Active) -> None:
    """Begin where a sweep has come to."""
    N, items = sweep.r.shape[0], a.items
    for k in range(N):
        for i in range(2):
            a.base[k, i] = a.held[k, i] = sweep.held[k, i]
            a.lower[k, i], a.upper[k, i] = bounded.lower[k, i], bounded.upper[k, i]
            a.z[k, i] = at.v[k, i]
            a.r[k, i] = 0.0 if sweep.held[k, i] == FREE else sweep.r[k, i]
    for i in range(2):
        a.base[N, i] = a.held[N, i] = LOWER
        a.lower[N, i], a.upper[N, i], a.z[N, i], a.r[N, i] = 0.0, np.inf, 0.0, slack[2 * i]
    items.kind[LAST], items.sample[LAST], items.muscle[LAST], items.side[LAST] = BOUND, 0, 0, 0


@merged
def end(path: Path, bounded: Bounded, at: Point, sweep: Sweep, a: Active) -> None:
    """Set the point to where the active set has come to, within its bounds."""
    for k in range(sweep.r.shape[0]):
        for i in range(2):
            side, lower, upper = a.held[k, i], bounded.lower[k, i], bounded.upper[k, i]
            within = min(max(a.z[k, i], lower), upper)
            at.v[k, i] = within if side == FREE else lower if side == LOWER else upper
            sweep.held[k, i] = side
            at.xi[k + 1, 4 + i] = at.xi[k, 4 + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
    at.sigma[0], at.sigma[1] = max(a.z[sweep.r.shape[0], 0], 0.0), max(a.z[sweep.r.shape[0], 1], 0.0)


@merged
def proved_with_rows(
    path: Path, setting: Setting, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active
) -> bool:  # fmt: skip
    """Return whether the point is the solution, by the multipliers of its rows: see `certificate`; the gradients `gx`
    and `gv` of the sweep are the cost's, of which the first is lost.
    """
    slack, items, total, square = setting.slack, a.items, 0.0, 0.0
    c0, c1 = slack[0] + slack[1] * at.sigma[0], slack[2] + slack[3] * at.sigma[1]
    p = np.empty(6)
    for q in range(size):
        kind, k, multiplier = items.kind[q], items.sample[q], items.multiplier[q]
        if kind > BOUND:
            row_gradient(path.slope, k, kind, p)
            for i in range(6):
                sweep.gx[k + 1, i] += multiplier * p[i]
            over = row_value(path.slope, k, kind, at.xi) - a.b[k, kind]
            if kind >= 10:
                over, c1 = over - at.sigma[1], c1 - multiplier
            elif kind >= SOFT:
                over, c0 = over - at.sigma[0], c0 - multiplier
            total += abs(multiplier * over)
    adjoint(path, sweep.gx, sweep.gv, sweep.r)
    for k in range(bounded.there.size):
        for i in range(2):
            g, v = sweep.r[k, i], at.v[k, i]
            pushes = (v == bounded.lower[k, i] and g >= 0.0) or (v == bounded.upper[k, i] and g <= 0.0)
            square += 0.0 if pushes or not bounded.there[k] else g * g
    c0, c1 = 0.0 if at.sigma[0] == 0.0 and c0 > 0.0 else c0, 0.0 if at.sigma[1] == 0.0 and c1 > 0.0 else c1
    rest = square / setting.curvature + c0 * c0 / slack[1] + c1 * c1 / slack[3]
    return total + 0.5 * rest <= 0.5 * setting.curvature * setting.accuracy**2


@merged
def let_go(path: Path, setting: Setting, sweep: Sweep, a: Active) -> int:
    """Let go what its bound pushes in vain, and return with how many items that was done; -1: there are too many."""
    size, least, items = 0, PUSHES * setting.accuracy * setting.curvature, a.items
    for _ in range(FEW):
        worst, sample, muscle = least, -1, 0
        for k in range(a.r.shape[0]):
            for i in range(2):
                if a.held[k, i] != FREE and a.lower[k, i] < a.upper[k, i]:
                    push = -a.r[k, i] if a.held[k, i] == LOWER else a.r[k, i]
                    if push > worst:
                        worst, sample, muscle = push, k, i
        if sample < 0:
            return size
        if size == LAST:
            return -1
        size = add_gone(path, setting.slack, sweep, sample, muscle, size, a)
        for q in range(size):
            items.step[q] = -a.r[items.sample[q], items.muscle[q]]
        solve_items(size, items)
        direct(size, 0.0, a)
        go(size, 1.0, 0.0, a)
    return -1


@merged
def add_gone(path: Path, slack: Array, sweep: Sweep, k: int, i: int, size: int, a: Active) -> int:
    """Let go a change of the base, add its item, and return how many there are."""
    items = a.items
    a.held[k, i] = FREE
    items.kind[size], items.sample[size], items.muscle[size], items.side[size] = GONE, k, i, 0
    items.multiplier[size] = 0.0
    respond(path, sweep, a.base, slack, size, items, a.xi)
    compare(path, size, size, items, a.xi)
    return size + 1


@merged
def exchanged(path: Path, setting: Setting, sweep: Sweep, count: int, begun: int, at: Point, a: Active) -> int:
    """Let enter what is broken of the bounds and the first `count` rows of every sample until nothing is, and return
    with how many items; -1: it has given up. There are those that it has `begun` with, -1 for too many.
    """
    size, steps, items, violation = begun, 0, a.items, 0.0
    while size >= 0 and steps < STEPS:
        if violation == 0.0:
            violation = most_broken(path, count, size, at, a)
            if violation == 0.0:
                return size
            respond(path, sweep, a.base, setting.slack, LAST, items, a.xi)
            compare(path, size, LAST, items, a.xi)
            items.multiplier[LAST] = 0.0
        slope = find_step(size, a)
        first = longest(size, a)
        share, full = items.step[LAST], violation / slope if slope > 0.0 else np.inf
        if not min(share, full) < np.inf:
            return -1
        go(size, min(share, full), min(share, full), a)
        steps += 1
        if full <= share:
            violation, size = 0.0, enter(size, a)
        else:
            violation -= share * slope
            size = leave(path, setting.slack, sweep, size, first, a)
    return -1


@merged
def most_broken(path: Path, count: int, size: int, at: Point, a: Active) -> float:
    """Set the item that enters to the bound or the row that is broken most, and return by how much; 0.0: none is."""
    N, worst, violation, items = path.A.shape[0], 0.0, 0.0, a.items
    for k in range(N + 1):
        for i in range(2):
            if a.held[k, i] == FREE:
                width = WIDTH[0] if k < N else WIDTH[SOFT + 2 * i]
                below, above = a.lower[k, i] - a.z[k, i], a.z[k, i] - a.upper[k, i]
                over = max(below, above)
                if over > max(worst * width, BREAKS):
                    violation, worst = over, over / width
                    items.kind[LAST], items.sample[LAST], items.muscle[LAST] = BOUND, k, i
                    items.side[LAST] = LOWER if below > above else UPPER
    if violation > 0.0 or count == BOUNDS:
        return violation
    values(path, lead_on(path, a, at), count, a.value)
    for k in range(N):
        for j in range(BOUNDS, count):
            over = a.value[k, j] - a.b[k, j]
            if over > ROW_BREAKS:
                if over > worst * WIDTH[j] and not is_item(k, j, size, items):
                    violation, worst = over, over / WIDTH[j]
                    items.kind[LAST], items.sample[LAST], items.muscle[LAST] = j, k, 0
    return violation


@merged
def is_item(k: int, j: int, size: int, items: Items) -> bool:
    """Return whether the row j of the sample k is one of the items."""
    for q in range(size):
        if items.kind[q] == j and items.sample[q] == k:
            return True
    return False


@merged
def lead_on(path: Path, a: Active, at: Point) -> Point:
    """Set the point to where the changes lead, and return it."""
    N = path.A.shape[0]
    for k in range(N):
        for i in range(2):
            at.v[k, i] = a.z[k, i]
            at.xi[k + 1, 4 + i] = at.xi[k, 4 + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
    at.sigma[0], at.sigma[1] = a.z[N, 0], a.z[N, 1]
    return at


@merged
def find_step(size: int, a: Active) -> float:
    """Set the direction in which a multiplier of the item that enters leads, and return by how much it breaks less."""
    items, K = a.items, a.items.K
    for q in range(size):
        items.step[q] = -K[q, LAST]
    solve_items(size, items)
    slope, terms = -K[LAST, LAST], abs(K[LAST, LAST])
    for q in range(size):
        slope -= items.step[q] * K[LAST, q]
        terms += abs(items.step[q] * K[LAST, q])
    direct(size, 1.0, a)
    return slope if slope > FLAT * terms else 0.0


@merged
def solve_items(size: int, items: Items) -> None:
    """Replace `step` (size,) by the solution x of K x = step; K is factorised as L D Lᵀ, what was let go first."""
    L, order, x, number = items.L, items.order, items.step, 0
    for turn in range(2):
        for q in range(size):
            if (items.kind[q] == GONE) == (turn == 0):
                order[number] = q
                number += 1
    for m in range(size):
        p = order[m]
        for n in range(m + 1):
            total = items.K[p, order[n]]
            for j in range(n):
                total -= L[m, j] * L[n, j] * L[j, j]
            L[m, n] = total / L[n, n] if n < m else total
        for n in range(m):
            x[p] -= L[m, n] * x[order[n]]
    for m in range(size - 1, -1, -1):
        p = order[m]
        x[p] /= L[m, m]
        for n in range(m + 1, size):
            x[p] -= L[n, m] * x[order[n]]


@merged
def direct(size: int, entering: float, a: Active) -> None:
    """Set the direction to what the items' steps make of their answers, and so much of what answers to the last."""
    items, dz, dr = a.items, a.dz, a.dr
    for k in range(dz.shape[0]):
        for i in range(2):
            dz[k, i], dr[k, i] = entering * items.z[LAST, k, i], entering * items.r[LAST, k, i]
    for q in range(size):
        step = items.step[q]
        for k in range(dz.shape[0]):
            for i in range(2):
                dz[k, i] += step * items.z[q, k, i]
                dr[k, i] += step * items.r[q, k, i]


@merged
def longest(size: int, a: Active) -> int:
    """Set the last `step` to how far the direction may be gone before a multiplier changes its sign; return whose: an
    item's number, or FEW + 2 k + i for a change that is held.
    """
    items, share, first = a.items, np.inf, -1
    for q in range(size):
        if items.kind[q] != GONE and items.step[q] < 0.0 and items.multiplier[q] < -share * items.step[q]:
            share, first = -items.multiplier[q] / items.step[q], q
    for k in range(a.r.shape[0]):
        for i in range(2):
            if a.held[k, i] != FREE and a.base[k, i] != FREE and a.lower[k, i] < a.upper[k, i]:
                sign = 1.0 if a.held[k, i] == LOWER else -1.0
                push, change = max(sign * a.r[k, i], 0.0), sign * a.dr[k, i]
                if change < 0.0 and push < -share * change:
                    share, first = -push / change, FEW + 2 * k + i
    items.step[LAST] = share
    return first


@merged
def go(size: int, share: float, entering: float, a: Active) -> None:
    """Go this share of the direction."""
    for q in range(size):
        a.items.multiplier[q] += share * a.items.step[q]
    a.items.multiplier[LAST] += entering
    for k in range(a.z.shape[0]):
        for i in range(2):
            a.z[k, i] += share * a.dz[k, i]
            a.r[k, i] += share * a.dr[k, i]


@merged
def enter(size: int, a: Active) -> int:
    """Let the item that enters hold, and return how many there are then; -1: too many."""
    items = a.items
    kind, k, i, side = items.kind[LAST], items.sample[LAST], items.muscle[LAST], items.side[LAST]
    if kind == BOUND:
        a.held[k, i] = side
        a.z[k, i] = a.lower[k, i] if side == LOWER else a.upper[k, i]
        if a.base[k, i] != FREE:
            a.r[k, i] = -side * items.multiplier[LAST]
            for q in range(size):
                if items.kind[q] == GONE and items.sample[q] == k and items.muscle[q] == i:
                    return remove(size, q, items)
    if size == LAST:
        return -1
    copy_item(LAST, size, size, items)
    return size + 1


@merged
def leave(path: Path, slack: Array, sweep: Sweep, size: int, first: int, a: Active) -> int:
    """Let go what comes `first`, and return how many items there are then; -1: too many."""
    items = a.items
    if first < FEW:
        if items.kind[first] == BOUND:
            a.held[items.sample[first], items.muscle[first]] = FREE
        return remove(size, first, items)
    if size == LAST:
        return -1
    return add_gone(path, slack, sweep, (first - FEW) // 2, (first - FEW) % 2, size, a)


__all__ = ["Active", "active_set", "new_active", "reversed_instead"]
