"""Active set of the exchange, the point at which it holds, and its changes: limits that enter and leave."""

from typing import Annotated, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.commands import HUGE
from mpc.tracking.compiled.records import Bounded, Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.responses import (
    Items,
    copy_item,
    discard,
    find_item,
    new_items,
    respond,
    set_limit,
    solve_items,
)
from mpc.tracking.compiled.structured_qp.riccati import Sweep, end_of, within
from mpc.tracking.compiled.structured_qp.sizes import BOUND, FREE, GONE, HIGH, LOWER, NU, NX, NXI, RANGE, SPARE, UPPER
from mpc.tracking.compiled.structured_qp.stage import advance, curvature

FLAT = 1e-10  # [-] of its terms: less counts as no slope
AWAY = 1e-3  # [bar] beyond a limit: less does not count


class Active(NamedTuple):
    """Active set and the point at which it holds; the last lines are those of the slacks."""

    held: Annotated[Signs, "N + 1", "m"]  # of the sweep's base, held now
    guess: Annotated[Signs, "N + 1", "m"]  # the active set
    z: Annotated[Array, "N + 1", "m"]  # changes and slacks
    r: Annotated[Array, "N + 1", "m"]  # gradient of the Lagrangian without the multipliers of what is held
    dz: Annotated[Array, "N + 1", "m"]
    dr: Annotated[Array, "N + 1", "m"]
    xi: Annotated[Array, "N + 1", "xi"]
    items: Items


@inlined
def new_active(N: int, blocks: int) -> Active:
    """Return an uninitialised active set."""
    sides, numbers = np.empty((2, N + 1, NU), np.int8), np.empty((4, N + 1, NU))
    return Active(
        sides[0], sides[1], numbers[0], numbers[1], numbers[2], numbers[3], np.empty((N + 1, NXI)),
        new_items(N, blocks * NU + SPARE),
    )  # fmt: skip


@inlined_flat
def take_base(setting: Setting, size: int, at: Point, sweep: Sweep, a: Active) -> None:
    """Take the result of a sweep, and the gradient by the slacks without rows."""
    N = at.v.shape[0]
    for k in range(N):
        for i in range(NU):
            a.held[k, i], a.z[k, i] = sweep.held[k, i], at.v[k, i]
    for i in range(NU):
        slack = i < 2
        a.r[N, i] = setting.slack[2 * i] + setting.slack[2 * i + 1] * at.sigma[i] if slack else 0.0
        a.held[N, i] = LOWER if not slack or find_item(GONE, N, i, size, a.items) < 0 else FREE
        sweep.held[N, i] = LOWER


@inlined_flat
def lead_on(path: Path, at: Point, a: Active) -> None:
    """Set the point to that of the changes."""
    N = path.A.shape[0]
    for k in range(N):
        for i in range(NU):
            at.v[k, i] = a.z[k, i]
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
    at.sigma[0], at.sigma[1] = a.z[N, 0], a.z[N, 1]


@inlined_flat
def direct(size: int, enters: bool, a: Active) -> None:
    """Set the direction to the sum of the items' responses times their steps, plus that of the entering item."""
    items, dz, dr, last = a.items, a.dz, a.dr, a.items.kind.size - 1
    for k in range(dz.shape[0]):
        for i in range(NU):
            dz[k, i] = items.z[last, k, i] if enters else 0.0
            dr[k, i] = items.r[last, k, i] if enters else 0.0
    for q in range(size):
        step = items.step[q]
        for k in range(dz.shape[0]):
            for i in range(NU):
                dz[k, i] += step * items.z[q, k, i]
                dr[k, i] += step * items.r[q, k, i]


@inlined_flat
def find_step(size: int, a: Active) -> float:
    """Set the direction for a multiplier of the entering item, and return the decrease of its violation per unit."""
    items, K, last = a.items, a.items.K, a.items.kind.size - 1
    for q in range(size):
        items.step[q] = -K[q, last]
    solve_items(size, items)
    slope, terms = -K[last, last], abs(K[last, last])
    for q in range(size):
        slope -= items.step[q] * K[last, q]
        terms += abs(items.step[q] * K[last, q])
    direct(size, True, a)
    return slope if slope > FLAT * terms else 0.0


@inlined_flat
def walk(size: int, share: float, entering: float, a: Active) -> None:
    """Move by this share of the direction."""
    for q in range(size):
        a.items.multiplier[q] += share * a.items.step[q]
    a.items.multiplier[a.items.kind.size - 1] += entering
    for k in range(a.z.shape[0]):
        for i in range(NU):
            a.z[k, i] += share * a.dz[k, i]
            a.r[k, i] += share * a.dr[k, i]


@inlined_flat
def longest(bounded: Bounded, size: int, least: float, a: Active) -> tuple[int, int, int]:
    """Set the last `step` to the length of the direction up to which no multiplier changes its sign; return the
    blocking one: the number of an item, or -1 and a held change.
    """
    items, share, first, sample, muscle = a.items, HUGE, -1, 0, 0
    for q in range(size):
        step, multiplier = items.step[q], max(items.multiplier[q], 0.0)
        if items.kind[q] != GONE and step < -least and multiplier < -share * step:
            share, first = -multiplier / step, q
    for k in range(a.r.shape[0]):
        for i in range(NU):
            if a.held[k, i] != FREE and bounded.lower[k, i] < bounded.upper[k, i]:
                sign = 1.0 if a.held[k, i] < 0 else -1.0
                pushed, change = max(sign * a.r[k, i], 0.0), sign * a.dr[k, i]
                if change < -least and pushed < -share * change:
                    share, first, sample, muscle = -pushed / change, -1, k, i
    items.step[items.kind.size - 1] = share
    return first, sample, muscle


@inlined_flat
def enter(bounded: Bounded, size: int, sweep: Sweep, a: Active) -> int:
    """Let the entering item hold, and return the number of items then."""
    items, last = a.items, a.items.kind.size - 1
    kind, k, i, above = items.kind[last], items.sample[last], items.muscle[last], items.side[last]
    if kind < RANGE and a.held[k, i] == FREE and abs(sweep.held[k, i]) == (UPPER if kind == BOUND else HIGH):
        a.held[k, i] = above * (UPPER if kind == BOUND else HIGH)
        a.r[k, i] = -above * items.multiplier[last]
        if kind == BOUND:
            a.z[k, i] = end_of(bounded, a.held[k, i], k, i)
        return discard(size, find_item(GONE, k, i, size, items), items)
    copy_item(last, size, size, items)
    return size + 1


@inlined_flat
def leave(path: Path, slack: Array, sweep: Sweep, size: int, q: int, k: int, i: int, a: Active) -> int:
    """Release the item `q`, or for -1 the change `i` of the sample k; return the number of items."""
    if q >= 0:
        return discard(size, q, a.items)
    add_gone(path, slack, sweep, k, i, size, a)
    return size + 1


@inlined_flat
def release(path: Path, slack: Array, sweep: Sweep, k: int, i: int, size: int, a: Active) -> int:
    """Release a change of the base, move it to where it is not pushed, and return the number of items then."""
    items = a.items
    add_gone(path, slack, sweep, k, i, size, a)
    for q in range(size + 1):
        items.step[q] = -a.r[items.sample[q], items.muscle[q]] if items.kind[q] == GONE else 0.0
    solve_items(size + 1, items)
    direct(size + 1, False, a)
    walk(size + 1, 1.0, 0.0, a)
    return size + 1


@inlined_flat
def drop(size: int, q: int, a: Active) -> int:
    """Remove a holding item while the others hold, and return the number of items then."""
    items, last = a.items, a.items.kind.size - 1
    copy_item(q, last, size, items)
    size = discard(size, q, items)
    find_step(size, a)
    walk(size, -items.multiplier[last], -items.multiplier[last], a)
    return size


@inlined_flat
def add_gone(path: Path, slack: Array, sweep: Sweep, k: int, i: int, size: int, a: Active) -> None:
    """Release a change of the base, which becomes the next item."""
    items = a.items
    a.held[k, i] = FREE
    set_limit(size, GONE, k, i, 0, items)
    items.multiplier[size] = 0.0
    respond(path, slack, sweep, size, size, items, a.xi)


@inlined_flat
def end(path: Path, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active) -> None:
    """Set the point to the result of the active set, within slew and supply, and `guess` to the set."""
    N, items = path.A.shape[0], a.items
    for k in range(N):
        for i in range(NU):
            a.guess[k, i] = a.held[k, i]
    for q in range(size):
        kind, sample, muscle = items.kind[q], items.sample[q], items.muscle[q]
        if kind != GONE and kind < RANGE and sample < N and a.guess[sample, muscle] == FREE:
            a.guess[sample, muscle] = items.side[q] * (UPPER if kind == BOUND else HIGH)
    for k in range(N):
        for i in range(NU):
            v, w, held = a.z[k, i], at.xi[k, NX + i], a.guess[k, i]
            if held != FREE:
                v = end_of(bounded, held, k, i) - (w if abs(held) == HIGH else 0.0)
            at.v[k, i] = within(bounded, v, w, k, i)
            at.xi[k + 1, NX + i] = w + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
    for i in range(2):
        at.sigma[i] = max(a.z[N, i], 0.0)


@inlined_flat
def astray(bounded: Bounded, held: Signs, sweep: Sweep, at: Point, r: Array) -> tuple[float, int]:
    """Return how far at most a free change is beyond its limits or a held one pushed away from them [bar], and how many
    runs of such changes there are: a few exchanges often correct a whole run.
    """
    furthest, runs = 0.0, 0
    for i in range(NU):
        before = 0
        for k in range(at.v.shape[0]):
            v, w, side = at.v[k, i], at.xi[k + 1, NX + i], held[k, i]
            push = (1.0 if side > 0 else -1.0) * r[k, i] / curvature(sweep.D, k, i) if side != FREE else 0.0
            beyond = max(max(bounded.lower[k, i] - v, v - bounded.upper[k, i]), push)
            beyond = max(max(bounded.low[k, i] - w, w - bounded.high[k, i]), beyond)
            beyond = beyond if bounded.lower[k, i] < bounded.upper[k, i] else 0.0
            furthest = max(furthest, beyond)
            wrong = 1 if beyond > AWAY else 0
            runs += wrong * (1 - before)
            before = wrong
    return furthest, runs
