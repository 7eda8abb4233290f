"""Exchange of a sweep's held bounds, one after the other, until they are those of the solution.

First, changes that are pushed away from their bounds are released. Then violated bounds and rows enter, each with a
multiplier t up to

    full        that at which it holds:  t = violation / (-a·dz)
    partial     that at which another multiplier changes its sign: the other one leaves, and this one enters again

(D. Goldfarb and A. Idnani, Mathematical Programming 27, 1983.) Every step raises the dual cost. `responses` has the
responses to the items.
"""

from typing import NamedTuple

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat, merged
from mpc.tracking.compiled.records import Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.responses import (
    BOUND,
    GONE,
    ITEMS,
    LAST,
    Items,
    compare,
    copy_item,
    remove,
    respond,
    solve_items,
)
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.rows import WIDTH, values
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, FORCE, FREE, LOWER, NU, NX, SUPPLY, UPPER
from mpc.tracking.compiled.structured_qp.stage import advance

MORE = 16  # steps beyond one per sample, at most
PUSHES = 1e-5  # [-] of the allowed residual gradient: less counts as no push
BREAKS = 1e-12  # [bar], [rad], [N]: less violates no bound
ROW_BREAKS = 1e-8  # [bar], [rad], [N]: less violates no row
FLAT = 1e-10  # [-] of its terms: less counts as no slope
HUGE = 1e30  # no bound, and no end of a step


class Active(NamedTuple):
    """Active set and the point at which it holds; the last lines are those of the slacks."""

    base: Signs  # (N + 1, 2) held in the sweep's solution
    held: Signs  # (N + 1, 2) held now
    lower: Array  # (N + 1, 2)
    upper: Array  # (N + 1, 2)
    z: Array  # (N + 1, 2) changes and slacks
    r: Array  # (N + 1, 2) gradient of the Lagrangian without the bounds' multipliers
    dz: Array  # (N + 1, 2)
    dr: Array  # (N + 1, 2)
    b: Array  # (N + 1, 12) of the rows
    value: Array  # (N + 1, 12) of the rows
    xi: Array  # (N + 1, 6)
    first: Array  # (N, 2) gradient of the cost at the origin
    other: Point  # a point for comparison
    items: Items


@merged
def let_go(path: Path, setting: Setting, sweep: Sweep, a: Active) -> int:
    """Release changes that are pushed away from their bounds, and return the number of items; -1: too many."""
    size, least, items = 0, PUSHES * setting.accuracy * setting.curvature, a.items
    while size >= 0:
        worst, sample, muscle = least, -1, 0
        for k in range(a.r.shape[0]):
            for i in range(NU):
                push = pushes_in_vain(k, i, a)
                if push > worst:
                    worst, sample, muscle = push, k, i
        if sample < 0:
            return size
        size = add_gone(path, setting.slack, sweep, sample, muscle, size, a)
        if size > 0:
            for q in range(size):
                items.step[q] = -a.r[items.sample[q], items.muscle[q]]
            solve_items(size, items)
            direct(size, False, a)
            walk(size, 1.0, 0.0, a)
    return -1


@merged
def pushes_in_vain(k: int, i: int, a: Active) -> float:
    """Return the push of a held change away from its bound."""
    if a.held[k, i] == FREE or not a.lower[k, i] < a.upper[k, i]:
        return 0.0
    return float(-a.r[k, i] if a.held[k, i] == LOWER else a.r[k, i])


@inlined_flat
def add_gone(path: Path, slack: Array, sweep: Sweep, k: int, i: int, size: int, a: Active) -> int:
    """Release a change of the base, add its item, and return the number of items; -1: too many."""
    items = a.items
    if size == LAST:
        return -1
    a.held[k, i] = FREE
    items.kind[size], items.sample[size], items.muscle[size], items.side[size] = GONE, k, i, 0
    items.multiplier[size] = 0.0
    respond(path, sweep, a.base, slack, size, items, a.xi)
    compare(path, size, size, items, a.xi)
    return size + 1


@merged
def exchanged(path: Path, setting: Setting, sweep: Sweep, begun: int, at: Point, a: Active) -> int:
    """Let violated bounds and rows enter until there are none, and return the number of items, `begun` at first; -1: no
    solution found.
    """
    size, steps, items, violation = begun, 0, a.items, 0.0
    while size >= 0 and steps < path.A.shape[0] + MORE:
        if violation == 0.0:
            violation = most_broken(path, size, at, a)
            if violation == 0.0:
                return size
            respond(path, sweep, a.base, setting.slack, LAST, items, a.xi)
            compare(path, size, LAST, items, a.xi)
            items.multiplier[LAST] = 0.0
        slope = find_step(size, a)
        q, k, i = longest(size, a)
        share, full = items.step[LAST], violation / slope if slope > 0.0 else HUGE
        if not min(share, full) < HUGE:
            return -1
        walk(size, min(share, full), min(share, full), a)
        steps += 1
        if full <= share:
            violation = 0.0
            size = enter(size, a)
        else:
            violation -= share * slope
            size = leave(path, setting.slack, sweep, size, q, k, i, a)
    return -1


@merged
def most_broken(path: Path, size: int, at: Point, a: Active) -> float:
    """Set the entering item to the most violated bound, or row if there is none, and return the violation, 0.0 without
    any.
    """
    N, worst, violation, items = path.A.shape[0], 0.0, 0.0, a.items
    for k in range(N + 1):
        for i in range(NU):
            if a.held[k, i] == FREE:
                below, above = a.lower[k, i] - a.z[k, i], a.z[k, i] - a.upper[k, i]
                over, width = max(below, above), WIDTH[0] if k < N else WIDTH[SUPPLY if i == 0 else FORCE]
                if over > max(worst * width, BREAKS):
                    violation, worst = over, over / width
                    items.kind[LAST], items.sample[LAST], items.muscle[LAST] = BOUND, k, i
                    items.side[LAST] = LOWER if below > above else UPPER
    if violation > 0.0:
        return violation
    lead_on(path, at, a)
    values(path, at, ALL, a.value)
    for k in range(N):
        for j in range(BOUNDS, ALL):
            over = a.value[k, j] - a.b[k, j]
            if over > max(worst * WIDTH[j], ROW_BREAKS) and not is_item(k, j, size, items):
                violation, worst = over, over / WIDTH[j]
                items.kind[LAST], items.sample[LAST], items.muscle[LAST] = j, k, 0
    return violation


@merged
def is_item(k: int, j: int, size: int, items: Items) -> bool:
    """Return whether the row j of the sample k is one of the items."""
    found = False
    for q in range(size):
        if items.kind[q] == j and items.sample[q] == k:
            found = True
    return found


@merged
def lead_on(path: Path, at: Point, a: Active) -> None:
    """Set the point to that of the changes."""
    N = path.A.shape[0]
    for k in range(N):
        for i in range(NU):
            at.v[k, i] = a.z[k, i]
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
    at.sigma[0], at.sigma[1] = a.z[N, 0], a.z[N, 1]


@merged
def find_step(size: int, a: Active) -> float:
    """Set the direction for a multiplier of the entering item, and return the decrease of its violation per unit."""
    items, K = a.items, a.items.K
    for q in range(size):
        items.step[q] = -K[q, LAST]
    solve_items(size, items)
    slope, terms = -K[LAST, LAST], abs(K[LAST, LAST])
    for q in range(size):
        slope -= items.step[q] * K[LAST, q]
        terms += abs(items.step[q] * K[LAST, q])
    direct(size, True, a)
    return slope if slope > FLAT * terms else 0.0


@inlined_flat
def direct(size: int, enters: bool, a: Active) -> None:
    """Set the direction to the sum of the items' responses times their steps, plus that of the entering item."""
    items, dz, dr = a.items, a.dz, a.dr
    for k in range(dz.shape[0]):
        for i in range(NU):
            dz[k, i] = items.z[LAST, k, i] if enters else 0.0
            dr[k, i] = items.r[LAST, k, i] if enters else 0.0
    for q in range(size):
        step = items.step[q]
        for k in range(dz.shape[0]):
            for i in range(NU):
                dz[k, i] += step * items.z[q, k, i]
                dr[k, i] += step * items.r[q, k, i]


@merged
def longest(size: int, a: Active) -> tuple[int, int, int]:
    """Set the last `step` to the length of the direction up to which no multiplier changes its sign; return the
    blocking one: the number of an item, or ITEMS and a held change.
    """
    items, share, first, sample, muscle = a.items, HUGE, ITEMS, 0, 0
    for q in range(size):
        step, multiplier = items.step[q], items.multiplier[q]
        if items.kind[q] != GONE and step < 0.0 and multiplier < -share * step:
            share, first = -multiplier / step, q
    for k in range(a.r.shape[0]):
        for i in range(NU):
            if a.held[k, i] != FREE and a.base[k, i] != FREE and a.lower[k, i] < a.upper[k, i]:
                sign = 1.0 if a.held[k, i] == LOWER else -1.0
                push, change = max(sign * a.r[k, i], 0.0), sign * a.dr[k, i]
                if change < 0.0 and push < -share * change:
                    share, first, sample, muscle = -push / change, ITEMS, k, i
    items.step[LAST] = share
    return first, sample, muscle


@inlined_flat
def walk(size: int, share: float, entering: float, a: Active) -> None:
    """Move by this share of the direction."""
    for q in range(size):
        a.items.multiplier[q] += share * a.items.step[q]
    a.items.multiplier[LAST] += entering
    for k in range(a.z.shape[0]):
        for i in range(NU):
            a.z[k, i] += share * a.dz[k, i]
            a.r[k, i] += share * a.dr[k, i]


@merged
def enter(size: int, a: Active) -> int:
    """Let the entering item hold, and return the number of items then; -1: too many."""
    items = a.items
    k, i, side = items.sample[LAST], items.muscle[LAST], items.side[LAST]
    if items.kind[LAST] == BOUND:
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
def leave(path: Path, slack: Array, sweep: Sweep, size: int, q: int, k: int, i: int, a: Active) -> int:
    """Release the item `q`, or for ITEMS the change `i` of the sample k; return the number of items; -1: too many."""
    items = a.items
    if q == ITEMS:
        return add_gone(path, slack, sweep, k, i, size, a)
    if items.kind[q] == BOUND:
        a.held[items.sample[q], items.muscle[q]] = FREE
    return remove(size, q, items)
