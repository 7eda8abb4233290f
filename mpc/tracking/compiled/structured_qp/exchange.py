"""Exchange of a sweep's held limits, one after the other, until they are those of the solution.

First, the base takes the limits that it can hold, and items hold others that the barrier named, with its multipliers.
Those that are pushed away from are released. Then violated limits enter, each with a multiplier t up to

    full        that at which it holds:  t = violation / (-a·dz)
    partial     that at which another multiplier changes its sign: the other one leaves, and this one enters again

(D. Goldfarb and A. Idnani, Mathematical Programming 27, 1983.) Every step raises the dual cost, so no set occurs twice
and the method terminates. A solution always exists, because v = 0 is within slew and supply and the other limits have
slacks. `responses` has the responses to the items, a Schur complement of the sweep (R. A. Bartlett and L. T. Biegler,
Optimization and Engineering 7, 2006). With CROWDED items, or before there is no room for more, a new sweep takes the
present set as its base with the multipliers unchanged; only soft rows and slacks remain items.
"""

from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.commands import HUGE
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.active import (
    FLAT,
    Active,
    astray,
    direct,
    drop,
    end,
    enter,
    find_step,
    lead_on,
    leave,
    longest,
    release,
    take_base,
    walk,
)
from mpc.tracking.compiled.structured_qp.certificate import (
    ROW_BREAKS,
    adjoint,
    gap,
    gradients,
    increase,
    lagrangian,
    over,
    priced,
    soften,
)
from mpc.tracking.compiled.structured_qp.responses import (
    Items,
    copy_item,
    find_item,
    name_item,
    respond,
    row_side,
    row_value,
    set_limit,
    slack_of,
    solve_items,
    width,
)
from mpc.tracking.compiled.structured_qp.riccati import BREAKS, Sweep, backward, forward
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUND, FREE, GONE, HIGH, NU, NX, RANGE, SUPPLY, UPPER
from mpc.tracking.compiled.structured_qp.stage import curvature

CROWDED = 16  # items for a new sweep
AGAIN = 3  # further sweeps for an answer without a proof, at most
PUSHES = 1e-5  # [-] of the allowed residual gradient: less counts as no push
REAL = 1e-6  # [-] of the multiplier of an item: a smaller change of another one is rounding
EACH = 3  # exchanges that a run of violated bounds takes, about; with fewer left, another search follows
ROUNDED = 100.0  # [-] of the least violations: up to here, a new sweep tells whether it is one


@inlined
def based(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, named: int, at: Point, sweep: Sweep, a: Active
) -> int:  # fmt: skip
    """Make the changes that the sweep holds the base, let the `named` items hold with them, and return the number of
    items.
    """
    N, items, last, size = path.A.shape[0], a.items, a.items.kind.size - 1, 0
    at.sigma[:], a.z[:], items.multiplier[last], items.known[0] = 0.0, 0.0, 0.0, 0
    set_limit(last, BOUND, 0, 0, 0, items)
    swept(path, errors, setting, bounded, named, at, sweep, a)
    for q in range(named - 1, -1, -1):
        if items.kind[q] >= RANGE:
            a.r[N, slack_of(items.kind[q])] -= items.multiplier[q]
        name_item(q, last - named + q, items)
    for q in range(last - named, last):
        size = admitted(path, setting, bounded, q, size, at, sweep, a)
    return size


@inlined
def admitted(
    path: Path, setting: Setting, bounded: Bounded, q: int, size: int, at: Point, sweep: Sweep, a: Active
) -> int:  # fmt: skip
    """Let the item `q` hold, and return the number of items then.

    If what holds already determines it, such as the slews of an arc that ends exactly at the supply, one of these
    leaves: the first whose multiplier becomes 0 while that of the item grows.
    """
    items, last = a.items, a.items.kind.size - 1
    if items.kind[q] == GONE:
        return release(path, setting.slack, sweep, items.sample[q], items.muscle[q], size, a)
    name_item(q, last, items)
    lead_on(path, at, a)
    respond(path, setting.slack, sweep, size, last, items, a.xi)
    slope, least = find_step(size, a), FLAT / setting.curvature if items.kind[q] == SUPPLY else 0.0
    if slope <= least and size < q:
        first, k, i = longest(bounded, size, REAL, a)
        if items.step[last] < HUGE:  # the multiplier that becomes 0 may have the wrong sign: the barrier has rounded it
            share = -a.r[k, i] / a.dr[k, i] if first < 0 else -items.multiplier[first] / items.step[first]
            walk(size, share, share, a)
            size = leave(path, setting.slack, sweep, size, first, k, i, a)
            slope = find_step(size, a)
    enters = slope > least and size <= q
    step = over(path, setting, bounded, last, items, at) / slope if enters else -items.multiplier[last]
    walk(size, step, step, a)
    if enters:
        copy_item(last, size, size, items)
        size += 1
    items.multiplier[last] = 0.0
    return size


@inlined
def swept(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active
) -> None:  # fmt: skip
    """Sweep with the multipliers of `size` items, and take the result as the base."""
    lagrangian(path, errors, setting, size, at, a.items, sweep)
    backward(path, setting.cost, bounded, at, sweep)
    forward(path, sweep, at, a.r)
    take_base(setting, size, at, sweep, a)


@inlined
def exchanged(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active,
    limit: int, final: bool
) -> tuple[bool, int, float]:  # fmt: skip
    """Move from the base with the first `size` items to the solution, in at most `limit` exchanges; return whether it
    is proved, the number of exchanges, and the bound of its suboptimality, unless another search follows.
    """
    most, taken, last = 0.5 * setting.curvature * setting.accuracy**2, limit, a.items.kind.size - 1
    tries, enters, again, exact, violation, items = 0, False, False, True, 0.0, a.items
    for step in range(limit):
        if again or size == last - 1 or crowd(path, size, items) >= CROWDED:
            size = rebased(path, errors, setting, bounded, size, enters, at, sweep, a)
            if size >= last - 1:
                taken = step
                break
            violation = max(over(path, setting, bounded, last, items, at), 0.0)
            again, exact = False, True
        if not enters:
            lead_on(path, at, a)
            if not final:
                _, runs = astray(bounded, a.held, sweep, at, a.r)
                if EACH * runs > limit - step:
                    taken = step
                    break
            left = let_go(path, setting, bounded, size, sweep, a)
            if left >= 0:
                size, exact = left, False
                continue
            violation = most_broken(path, setting, bounded, size, at, a)
            items.multiplier[last] = 0.0
            again = 0.0 < violation < ROUNDED * BREAKS and not exact
            if again:
                continue
            if violation > 0.0:
                respond(path, setting.slack, sweep, size, last, items, a.xi)
                enters = True
            else:
                end(path, bounded, size, at, sweep, a)
                found = gap(path, errors, setting, bounded, size, a.held, at, items, sweep, a.xi)
                if found <= most:
                    return True, step, found
        if enters:
            moved, enters, violation = stepped(path, setting, bounded, size, violation, sweep, a)
            if moved >= 0:
                size, exact = moved, False
                continue
        if tries == AGAIN:
            taken = step
            break
        tries += 1
        enters, again, items.multiplier[last] = False, True, 0.0
    lead_on(path, at, a)
    return False, taken, interrupted(path, errors, setting, bounded, size, at, sweep, a) if final else HUGE


@inlined
def stepped(
    path: Path, setting: Setting, bounded: Bounded, size: int, violation: float, sweep: Sweep, a: Active
) -> tuple[int, bool, float]:  # fmt: skip
    """Move along the direction of the entering item, to where it holds or another one leaves; return the number of
    items, -1 if nothing ends the direction, whether it still has to enter, and its remaining violation.
    """
    items, last = a.items, a.items.kind.size - 1
    slope = find_step(size, a)
    q, k, i = longest(bounded, size, 0.0, a)
    share, full = items.step[last], violation / slope if slope > 0.0 else HUGE
    if not min(share, full) < HUGE:
        return -1, True, violation
    walk(size, min(share, full), min(share, full), a)
    if share < full:
        return leave(path, setting.slack, sweep, size, q, k, i, a), True, violation - share * slope
    number = enter(bounded, size, sweep, a)
    items.multiplier[last] = 0.0
    return number, False, 0.0


@inlined_flat
def crowd(path: Path, size: int, items: Items) -> int:
    """Return the number of items that a new sweep would take."""
    number = 0
    for q in range(size):
        number += 1 if items.kind[q] < RANGE and items.sample[q] < path.A.shape[0] else 0
    return number


@inlined
def rebased(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, size: int, enters: bool, at: Point, sweep: Sweep,
    a: Active
) -> int:  # fmt: skip
    """Make the present set the base of a new sweep, with the multipliers of soft rows unchanged; return the number of
    items then. This removes the rounding errors of gradients and violations.
    """
    N, items, last = path.A.shape[0], a.items, a.items.kind.size - 1
    size = absorbed(size, sweep, a)
    lead_on(path, at, a)
    swept(path, errors, setting, bounded, size, at, sweep, a)
    for q in range(size):
        respond(path, setting.slack, sweep, q, q, items, a.xi)
        if items.kind[q] >= RANGE:
            a.r[N, slack_of(items.kind[q])] -= items.multiplier[q]
    if enters:
        respond(path, setting.slack, sweep, size, last, items, a.xi)
        if items.kind[last] >= RANGE:
            a.r[N, slack_of(items.kind[last])] -= items.multiplier[last]
    for q in range(size):
        k, i, gone = items.sample[q], items.muscle[q], items.kind[q] == GONE
        items.step[q] = -a.r[k, i] if gone else -over(path, setting, bounded, q, items, at)
    items.known[0] = 0
    solve_items(size, items)
    direct(size, False, a)
    walk(size, 1.0, 0.0, a)
    least = PUSHES * setting.accuracy * setting.curvature
    for q in range(size):
        if abs(items.multiplier[q]) < least:  # rounded; `let_go` releases the item of a negative one
            items.multiplier[q] = max(items.multiplier[q], 0.0)
    lead_on(path, at, a)
    return size


@inlined_flat
def absorbed(size: int, sweep: Sweep, a: Active) -> int:
    """Let the sweep hold the held changes and commands, one limit each, and return the number of remaining items."""
    N, items, kept = sweep.v.shape[0], a.items, 0
    for k in range(N):
        for i in range(NU):
            sweep.held[k, i] = a.held[k, i]
    for q in range(size):
        kind, sample, muscle = items.kind[q], items.sample[q], items.muscle[q]
        if sample < N and kind == GONE:
            continue
        if sample < N and kind < RANGE and sweep.held[sample, muscle] == FREE:
            sweep.held[sample, muscle] = items.side[q] * (UPPER if kind == BOUND else HIGH)
            continue
        name_item(q, kept, items)
        kept += 1
    return kept


@inlined_flat
def let_go(path: Path, setting: Setting, bounded: Bounded, size: int, sweep: Sweep, a: Active) -> int:
    """Release the limit that is pushed away from and whose release alone lowers the cost most; return the number of
    items then, -1 without such a limit.
    """
    least, most, first, sample, muscle, items = PUSHES * setting.accuracy * setting.curvature, 0.0, -1, -1, 0, a.items
    N = path.A.shape[0]
    for q in range(size):
        pushed = -items.multiplier[q] if items.kind[q] != GONE else 0.0
        if pushed > least and pushed * pushed > -most * items.K[q, q]:
            most, first = -pushed * pushed / items.K[q, q] if items.K[q, q] < 0.0 else HUGE, q
    for k in range(N + 1):
        for i in range(NU):
            if a.held[k, i] != FREE and bounded.lower[k, i] < bounded.upper[k, i]:
                pushed = -a.r[k, i] if a.held[k, i] < 0 else a.r[k, i]
                if not pushed > least:
                    continue
                gain = pushed * pushed / (curvature(sweep.D, k, i) if k < N else setting.slack[1 + 2 * i])
                if gain > most:
                    most, first, sample, muscle = gain, -1, k, i
    if first >= 0:
        return drop(size, first, a)
    if sample < 0:
        return -1
    return release(path, setting.slack, sweep, sample, muscle, size, a)


@inlined_flat
def most_broken(path: Path, setting: Setting, bounded: Bounded, size: int, at: Point, a: Active) -> float:
    """Set the entering item to the most violated bound, or row if there is none, and return the violation, 0.0 without
    any.
    """
    N, worst, violation, items = path.A.shape[0], 0.0, 0.0, a.items
    last = items.kind.size - 1
    for k in range(N + 1):
        for i in range(NU):
            for kind in range(BOUND, RANGE):
                if not bounded.lower[k, i] < bounded.upper[k, i] or (kind == SUPPLY and k == N):
                    continue
                v = at.xi[k + 1, NX + i] if kind == SUPPLY else a.z[k, i]
                below = (bounded.low[k, i] if kind == SUPPLY else bounded.lower[k, i]) - v
                above = v - (bounded.high[k, i] if kind == SUPPLY else bounded.upper[k, i])
                broken, wide = max(below, above), width(kind)
                if not broken > max(worst * wide, BREAKS) or abs(a.held[k, i]) == (UPPER if kind == BOUND else HIGH):
                    continue
                if find_item(kind, k, i, size, items) < 0:
                    violation, worst = broken, broken / wide
                    set_limit(last, kind, k, i, -1 if below > above else 1, items)
    if violation > 0.0:
        return violation
    for k in range(N):
        for kind in range(RANGE, ALL):
            broken, wide = row_value(path.slope, k, kind, at.xi) - row_side(path, setting.bounds, k, kind), width(kind)
            broken -= at.sigma[slack_of(kind)]
            if broken > max(worst * wide, ROW_BREAKS) and find_item(kind, k, 0, size, items) < 0:
                violation, worst = broken, broken / wide
                set_limit(last, kind, k, 0, 1, items)
    return violation


@inlined
def interrupted(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active
) -> float:  # fmt: skip
    """Set the point to the changes within slew and supply, with the slacks that they need, or to the origin if that
    costs less; return the bound of its suboptimality, the primal cost minus the dual one. Costs are relative to that of
    the origin without slacks.
    """
    lead_on(path, at, a)
    dual = priced(setting, at) - gap(path, errors, setting, bounded, size, a.held, at, a.items, sweep, a.xi)
    at.xi[:], at.v[:] = 0.0, 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, a.dr)
    origin = soften(path, setting, at)
    lead_on(path, at, a)
    dual += increase(path, errors, setting, a.dr, at, sweep)
    end(path, bounded, size, at, sweep, a)
    primal = soften(path, setting, at) + increase(path, errors, setting, a.dr, at, sweep)
    if not primal < origin:
        at.xi[:], at.v[:] = 0.0, 0.0
        primal = soften(path, setting, at)
    return float(max(primal - dual, 0.0))
