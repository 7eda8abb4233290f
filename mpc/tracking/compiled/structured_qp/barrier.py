"""Search for the active limits of a far QP by a barrier.

If the solution jumps between the bounds of the slew, most of them change from one QP to the next, and an exchange one
by one takes hundreds of steps. A few sweeps of a primal-dual interior point find most of them at once (S. J. Wright,
Primal-Dual Interior-Point Methods, 1997); the exchange corrects and proves them. With a distance t and a multiplier λ
for each limit a·z ≤ b,

    (H + Σ λ/t a aᵀ) Δz = -∇ - Σ (μ/t + λ/t (a·z + t - b)) a,    Δt = b - a·(z + Δz) - t,    Δλ = μ/t - λ - λ/t Δt

Slews, supplies and soft rows of a sample charge its changes, commands and states; `slackened` adds the slacks.

A search near the solution resumes at the point of a sweep, with the multipliers of what it holds. All products t λ are
then equal, as on the central path, and about 9 sweeps follow. Any other search begins at the origin, with 11 to 15.
"""

from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.commands import HUGE
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.active import Active
from mpc.tracking.compiled.structured_qp.barrier_limits import (
    charge,
    charge_row,
    distance,
    is_limit,
    moved_on,
    pushed_back,
    row_of,
    shortened,
    side_of,
    slackened,
)
from mpc.tracking.compiled.structured_qp.certificate import adjoint, gradients, soften
from mpc.tracking.compiled.structured_qp.responses import Items, set_limit, slack_of, width
from mpc.tracking.compiled.structured_qp.riccati import Sweep, backward, forward, take_charges
from mpc.tracking.compiled.structured_qp.sizes import (
    ALL,
    BOUND,
    FORCE,
    FREE,
    GONE,
    HIGH,
    LIMIT_LINES,
    LOWER,
    NU,
    NXI,
    RANGE,
    SIDES,
    SPARE,
    SUPPLY,
    UPPER,
)

TURNS = 48  # sweeps, at most
NEAR = 0.04  # [bar] least distance from a bound at the beginning
RESUMED = 1.0  # [bar²] product t λ by the curvature of a change, where a search resumes
HOPEFUL = 0.1  # share of its steps; after a shorter one it begins at the origin
SHARE, WIDE = 0.003, 1.0  # [bar] product there, by the steepest gradient: usually, and after short steps
SHORT, STALLED = 0.02, 3  # share below which a step is short, and the number of such steps for a new beginning
CENTRED = 0.1  # of the product in the first turn; later, the less the longer the last step was
LEAST_CENTRED, MOST_CENTRED = 0.01, 0.8
KEPT = 0.99  # of the way to a limit, at most
STUCK = 1e-4  # share of a step; after a shorter one the products grow, and the present limits are taken
COARSE, FINE = 1e-4, 1e-6  # [bar²] product t λ by the curvature of a change at the end; the fine one with soft rows;
# a greater one may hold a limit that is not active, and to release it may break a hundred others
UNSURE = 100.0  # [bar²] product by the curvature, above which the limits found are those of another problem
HELD = 0.001  # [bar²] λ/t of an active limit, by the curvature and times that product, at least
LATE = 12  # turns, after which violated soft rows join the others at the point; before, it begins anew with them


@inlined
def guessed(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, near: bool, fine: bool, at: Point, sweep: Sweep,
    a: Active
) -> int:  # fmt: skip
    """Set the held changes of the sweep to those that the barrier finds, and the point to its last one; name items for
    the other active limits, and return their number. `near` the solution the search resumes at the point and the held
    changes; a `fine` one ends at a smaller product. It begins anew with soft rows when one is violated, and when its
    steps are short.
    """
    lines, product, centred, stalls, start = 0, 0.0, CENTRED, 0, SHARE
    if near:
        lines, product = SIDES, resumed(path, setting, bounded, at, sweep, a)
    else:
        at.xi[:], at.v[:] = 0.0, 0.0
    for turn in range(TURNS):
        wanted = LIMIT_LINES if lines == LIMIT_LINES or soften(path, setting, at) > 0.0 else SIDES
        if stalls == STALLED:
            lines, stalls, start = 0, STALLED + 1, WIDE
        if wanted > lines:
            first_line = SIDES if lines == SIDES and turn >= LATE else 0
            if first_line == 0:
                product, centred = begun(path, errors, setting, bounded, start, at, sweep), CENTRED
            placed(path, setting, bounded, product, first_line, wanted, at, sweep, a.items)
            lines = wanted
        if product < enough(fine, lines) * setting.curvature or not product < HUGE:
            break
        gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
        take_charges(setting.cost, sweep)
        weigh(path, setting, bounded, centred * product, lines, at, sweep, a.items)
        backward(path, setting.cost, bounded, at, sweep)
        forward(path, sweep, at, a.r)
        if lines == LIMIT_LINES:
            slackened(path, setting, centred * product, at, sweep, a.items, a.xi)
        product, share = moved(path, setting, bounded, centred * product, lines, at, sweep, a.items)
        centred = min(max((1.0 - share) ** 2, LEAST_CENTRED), MOST_CENTRED)
        if near and not share > HOPEFUL:
            near, lines = False, 0
        if not share > STUCK and stalls > STALLED:
            break
        if not share > SHORT and stalls < STALLED:
            stalls = stalls + 1 if share > STUCK else STALLED
    take_charges(setting.cost, sweep)
    if not product < UNSURE * setting.curvature:  # far from the end, or it has diverged: nothing is held
        at.xi[:], at.v[:] = 0.0, 0.0
        return 0
    least = HELD / enough(fine, lines) * setting.curvature
    named = name_soft(least, sweep, a.items) if lines == LIMIT_LINES else 0
    return hold_active(least, named, sweep, a.items)


@inlined_flat
def enough(fine: bool, lines: int) -> float:
    """Return the product at the end [bar²]; a limit held wrongly moves many others if soft rows hold."""
    return FINE if fine or lines == LIMIT_LINES else COARSE


@inlined_flat
def resumed(path: Path, setting: Setting, bounded: Bounded, at: Point, sweep: Sweep, a: Active) -> float:
    """Set the multipliers to those of the held changes, or to a share of the distances, and release the changes; return
    the products with the distances, which are equal.
    """
    items, product = a.items, RESUMED * setting.curvature
    for k in range(at.v.shape[0]):
        for i in range(NU):
            held = sweep.held[k, i]
            sweep.held[k, i] = FREE if bounded.lower[k, i] < bounded.upper[k, i] else LOWER
            if sweep.held[k, i] == FREE:
                for line in range(SIDES):
                    push = (-a.r[k, i] if held > 0 else a.r[k, i]) if held == side_of(line) else 0.0
                    away = max(distance(path, setting, bounded, at, line, k, i), NEAR)
                    items.r[line, k, i] = max(push, product / away)
                    items.z[line, k, i] = product / items.r[line, k, i]
    return product


@inlined
def begun(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, start: float, at: Point, sweep: Sweep
) -> float:  # fmt: skip
    """Set the point to the origin, and release the changes; return `start` times the steepest gradient there."""
    at.xi[:], at.v[:], steepest = 0.0, 0.0, 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.g)
    for k in range(at.v.shape[0]):
        for i in range(NU):
            steepest = max(steepest, abs(sweep.g[k, i]))
            sweep.held[k, i] = FREE if bounded.lower[k, i] < bounded.upper[k, i] else LOWER
    return start * steepest


@inlined_flat
def placed(
    path: Path, setting: Setting, bounded: Bounded, product: float, first_line: int, lines: int, at: Point,
    sweep: Sweep, items: Items
) -> None:  # fmt: skip
    """Set the distances of the lines from `first_line` on, at least so far that a step can be long, and the multipliers
    that give this product with them. Slacks are those of the central path, with ρ as their multipliers, or the least
    ones.
    """
    soften(path, setting, at)
    N = at.v.shape[0]
    for j in range(2):
        at.sigma[j] = max(at.sigma[j], product / setting.slack[2 * j])
        items.z[0, N, j], items.r[0, N, j] = at.sigma[j], product / at.sigma[j]
    for k in range(N):
        for line in range(first_line, lines):
            for i in range(NU):
                if is_limit(sweep, line, k, i):
                    least = NEAR if line < SIDES else width(row_of(line, i))
                    items.z[line, k, i] = max(distance(path, setting, bounded, at, line, k, i), least)
                    items.r[line, k, i] = product / items.z[line, k, i]


@inlined_flat
def weigh(
    path: Path, setting: Setting, bounded: Bounded, product: float, lines: int, at: Point, sweep: Sweep, items: Items
) -> None:  # fmt: skip
    """Add the curvatures of the limits to the charges of the sweep, and their pushes to the gradients; set the first
    four entries of `step` to the sums of pushes and curvatures of the rows of each slack.
    """
    for j in range(4):
        items.step[j] = 0.0
    for k in range(at.v.shape[0]):
        for line in range(SIDES):
            for i in range(NU):
                if is_limit(sweep, line, k, i):
                    weight = items.r[line, k, i] / items.z[line, k, i]
                    away = distance(path, setting, bounded, at, line, k, i)
                    push = pushed_back(items, product, weight, away, line, k, i)
                    charge(sweep, line, k, i, weight, push)
        for line in range(SIDES, lines):
            for i in range(NU):
                if is_limit(sweep, line, k, i):
                    weight, kind = items.r[line, k, i] / items.z[line, k, i], row_of(line, i)
                    away = distance(path, setting, bounded, at, line, k, i)
                    push = pushed_back(items, product, weight, away, line, k, i)
                    charge_row(path, sweep, kind, k, weight, push)
                    items.step[slack_of(kind)] += push
                    items.step[2 + slack_of(kind)] += weight


@inlined_flat
def moved(
    path: Path, setting: Setting, bounded: Bounded, product: float, lines: int, at: Point, sweep: Sweep, items: Items
) -> tuple[float, float]:  # fmt: skip
    """Shorten the step to keep distances and multipliers positive; return the mean of their products then, and the
    share of the step.
    """
    N, nearer, less, total, number = at.v.shape[0], KEPT, KEPT, 0.0, 0
    for k in range(N):
        most, most_dual = KEPT, KEPT  # of one sample: a single chain over all would be slower
        for line in range(LIMIT_LINES):
            for i in range(NU):
                if line < lines and is_limit(sweep, line, k, i):
                    away = distance(path, setting, bounded, at, line, k, i)
                    near, low = shortened(items, product, away, line, k, i)
                    most, most_dual = max(most, near), max(most_dual, low)
        nearer, less = max(nearer, most), max(less, most_dual)
    for j in range(2 if lines == LIMIT_LINES else 0):
        near, low = shortened(items, product, at.sigma[j], 0, N, j)
        nearer, less = max(nearer, near), max(less, low)
    whole, dual = KEPT / nearer, KEPT / less
    for k in range(N):
        products = 0.0
        for line in range(LIMIT_LINES):
            for i in range(NU):
                if line < lines and is_limit(sweep, line, k, i):
                    away = distance(path, setting, bounded, at, line, k, i)
                    products += moved_on(items, product, away, whole, dual, line, k, i)
                    number += 1
        total += products
    for j in range(2 if lines == LIMIT_LINES else 0):  # the slacks, σ ≥ 0
        moved_on(items, product, at.sigma[j], whole, dual, 0, N, j)
        at.sigma[j] = items.z[0, N, j]
    for k in range(N):
        for i in range(NU):
            at.v[k, i] -= (1.0 - whole) * sweep.v[k, i]
        for i in range(NXI):
            at.xi[k + 1, i] -= (1.0 - whole) * sweep.xi[k + 1, i]
    return total / max(number, 1), min(whole, dual)


@inlined_flat
def name_soft(least: float, sweep: Sweep, items: Items) -> int:
    """Name items for the slacks that are not 0, and for the active soft rows, with their multipliers; return their
    number.
    """
    N, number, unit = sweep.v.shape[0], 0, width(BOUND)
    for j in range(2):
        wide = width(FORCE if j == 1 else RANGE) / unit
        if items.r[0, N, j] / items.z[0, N, j] * wide**2 <= least:
            set_limit(number, GONE, N, j, 0, items)
            items.multiplier[number] = 0.0
            number += 1
    for k in range(N):
        for line in range(SIDES, LIMIT_LINES):
            for i in range(NU):
                kind = row_of(line, i)
                there = kind < ALL and number < items.kind.size - SPARE
                if there and items.r[line, k, i] / items.z[line, k, i] * (width(kind) / unit) ** 2 > least:
                    set_limit(number, kind, k, 0, 1, items)
                    items.multiplier[number] = items.r[line, k, i]
                    number += 1
    return number


@inlined_flat
def hold_active(least: float, named: int, sweep: Sweep, items: Items) -> int:
    """Hold each change at its active bound, and return the number of items. If both its slew and its supply are active,
    the supply becomes an item.

    On opposite sides they leave one value, the supply's bound of the sample before. Its multiplier then takes over what
    both have in common, so that one of them is left.
    """
    for i in range(NU):
        line, shared = 2, 0.0
        for k in range(sweep.v.shape[0] - 1, -1, -1):
            if sweep.held[k, i] != FREE:
                continue
            items.r[line, k, i] += shared
            shared = 0.0
            slew, supply = active_side(items, 0, least, k, i), active_side(items, 2, least, k, i)
            if slew * supply < 0:
                line, opposite = 3 if supply > 0 else 2, 1 if slew > 0 else 0
                shared = min(items.r[line, k, i], items.r[opposite, k, i])
                items.r[line, k, i] -= shared
                items.r[opposite, k, i] -= shared
                slew, supply = active_side(items, 0, least, k, i), active_side(items, 2, least, k, i)
            sweep.held[k, i] = slew * UPPER if slew != 0 else supply * HIGH
            if slew * supply > 0 and named < items.kind.size - SPARE:
                set_limit(named, SUPPLY, k, i, supply, items)
                items.multiplier[named] = items.r[2 if supply < 0 else 3, k, i]
                named += 1
    return named


@inlined_flat
def active_side(items: Items, line: int, least: float, k: int, i: int) -> int:
    """Return the side, -1, 0 or 1, at which a slew (line = 0) or supply (2) is active."""
    below, above = items.r[line, k, i] / items.z[line, k, i], items.r[line + 1, k, i] / items.z[line + 1, k, i]
    if max(below, above) <= least:
        return 0
    return -1 if below > above else 1
