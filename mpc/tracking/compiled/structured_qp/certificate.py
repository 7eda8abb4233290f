"""Certificate that a point within its limits solves the QP, by the multipliers of the active limits, in two passes.

A step of the last sweep's feedback takes the gradient by its free changes to 0. The duality gap is half the gradient
times that step, plus the multipliers after it times the distance from each limit. A remaining gradient r, where a
released change or a multiplier of the wrong sign leaves one, adds ½ rᵀH⁻¹r ≤ ½|r|²/c, c the charge on each change of a
command. H's eigenvalues are no less, hence c |z - z*|² ≤ 2 gap: an answer that passes is no farther than ACCURACY from
the solution. Where z is off its limits by rounding, this holds for the QP with the limits moved to z.

The step counts instead of |r|²/c for all changes because the strong directions of H have 10⁴ times the curvature c, and
the rounding of single precision in them is a gradient, but no distance.
"""

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Cost, Errors, Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.responses import Items, row_push, row_side, row_value, slack_of
from mpc.tracking.compiled.structured_qp.riccati import BREAKS, Sweep, end_of
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUND, FREE, HIGH, NU, NX, NXI, NY, RANGE, SUPPLY
from mpc.tracking.compiled.structured_qp.stage import advance, answered, changed, gone_along, linear_before

ROW_BREAKS = 1e-8  # [bar], [rad], [N]: less violates no row


@inlined
def lagrangian(path: Path, errors: Errors, setting: Setting, size: int, at: Point, items: Items, sweep: Sweep) -> None:
    """Set `gx` and `gv` of the sweep to the gradient at the point, with the multipliers of the first `size` items and
    of the entering one.
    """
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    for q in range(size):
        pushed(path, q, items, sweep)
    if items.multiplier[items.kind.size - 1] > 0.0:
        pushed(path, items.kind.size - 1, items, sweep)


@inlined_flat
def pushed(path: Path, q: int, items: Items, sweep: Sweep) -> None:
    """Add the multiplier of the item `q` to the gradient of the Lagrangian."""
    k, i, kind, multiplier = items.sample[q], items.muscle[q], items.kind[q], items.multiplier[q]
    if k >= sweep.gv.shape[0]:
        return
    if kind >= RANGE:
        row_push(path.slope, k, kind, multiplier, sweep.gx[k + 1])
    elif kind == SUPPLY:
        sweep.gx[k + 1, NX + i] += items.side[q] * multiplier
    elif kind == BOUND:
        sweep.gv[k, i] += items.side[q] * multiplier


@inlined_flat
def over(path: Path, setting: Setting, bounded: Bounded, q: int, items: Items, at: Point) -> float:
    """Return the violation of the limit of the item `q`; negative within the limit."""
    k, i, kind, above = items.sample[q], items.muscle[q], items.kind[q], items.side[q] > 0
    if kind >= RANGE:
        beyond = row_value(path.slope, k, kind, at.xi) - row_side(path, setting.bounds, k, kind)
        return float(beyond - at.sigma[slack_of(kind)])
    if kind == SUPPLY:
        w = at.xi[k + 1, NX + i]
        return float(w - bounded.high[k, i] if above else bounded.low[k, i] - w)
    v = at.sigma[i] if k == at.v.shape[0] else at.v[k, i]
    return float(v - bounded.upper[k, i] if above else bounded.lower[k, i] - v)


@inlined
def gap(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, size: int, held: Signs, at: Point, items: Items,
    sweep: Sweep, xi: Array
) -> float:  # fmt: skip
    """Return the bound of the cost of the point minus the dual cost.

    The multipliers are those of the items, and the gradient's at the limits `held` (N + 1, 2). The entering item's
    response and `xi` are overwritten.
    """
    slack, last, square = setting.slack, items.kind.size - 1, 0.0
    c0, c1 = slack[0] + slack[1] * at.sigma[0], slack[2] + slack[3] * at.sigma[1]
    lagrangian(path, errors, setting, size, at, items, sweep)
    total = stepped_back(path, last, sweep, items, xi)
    for q in range(size):
        kind, multiplier = items.kind[q], items.multiplier[q]
        if kind >= SUPPLY:
            total += abs(multiplier * away(over(path, setting, bounded, q, items, at), kind))
        if kind >= RANGE:
            c0 -= multiplier if slack_of(kind) == 0 else 0.0
            c1 -= multiplier if slack_of(kind) == 1 else 0.0
    for i in range(NU):
        later = 0.0  # remaining gradient by the commands from here on
        for k in range(at.v.shape[0] - 1, -1, -1):
            if not bounded.there[k]:
                continue
            g, v, side, command = items.r[last, k, i], at.v[k, i], held[k, i], abs(sweep.held[k, i]) == HIGH
            if side != FREE and side * g <= 0.0:
                beyond = (at.xi[k + 1, NX + i] if command else v) - end_of(bounded, side, k, i)
                total += abs(g * away(beyond, BOUND))
                g = 0.0
            later += g if command else 0.0
            g = later if command else later + g
            pushes = (v == bounded.lower[k, i] and g >= 0.0) or (v == bounded.upper[k, i] and g <= 0.0)
            square += 0.0 if pushes else g * g
    c0 = 0.0 if at.sigma[0] == 0.0 and c0 > 0.0 else c0
    c1 = 0.0 if at.sigma[1] == 0.0 and c1 > 0.0 else c1
    square = square / setting.curvature + c0 * c0 / slack[1] + c1 * c1 / slack[3]
    return float(total + 0.5 * square)


@inlined
def stepped_back(path: Path, line: int, sweep: Sweep, items: Items, xi: Array) -> float:
    """Return half the gradient times the step that takes it to 0 for the free changes; the step becomes the items' z
    in this line, and the gradient after it their r.
    """
    N, total, p = sweep.v.shape[0], 0.0, sweep.gx[sweep.v.shape[0]].copy()
    for k in range(N - 1, -1, -1):
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            items.r[line, k, i] = p[NX + i] + sweep.gv[k, i]
        answered(sweep.R, sweep.D, sweep.inverse, sweep.held, k, line, -1, p, items.z, items.r)
        for i in range(NU):
            total -= 0.5 * items.r[line, k, i] * items.z[line, k, i]
        if k > 0:
            for i in range(NXI):
                p[i] += sweep.gx[k, i]
    for i in range(NXI):
        xi[0, i] = 0.0
    for k in range(N):
        gone_along(sweep.R, sweep.D, sweep.feedback, sweep.held, k, line, xi, items.z, items.r)
        advance(path.A, path.B, k, xi)
    return total


@inlined_flat
def away(distance: float, kind: int) -> float:
    """Return the distance from a limit of this kind; 0 where it is rounding."""
    return distance if abs(distance) > (ROW_BREAKS if kind >= RANGE else BREAKS) else 0.0


@inlined_flat
def soften(path: Path, setting: Setting, at: Point) -> float:
    """Set the slacks to the least ones of the point, and return their cost."""
    at.sigma[0], at.sigma[1] = 0.0, 0.0
    for k in range(path.A.shape[0]):
        for kind in range(RANGE, ALL):
            which, value = slack_of(kind), row_value(path.slope, k, kind, at.xi)
            at.sigma[which] = max(at.sigma[which], value - row_side(path, setting.bounds, k, kind))
    return priced(setting, at)


@inlined_flat
def priced(setting: Setting, at: Point) -> float:
    """Return the cost of the slacks."""
    price = 0.0
    for i in range(2):
        price += (setting.slack[2 * i] + 0.5 * setting.slack[2 * i + 1] * at.sigma[i]) * at.sigma[i]
    return price


@inlined_flat
def gradients(path: Path, errors: Errors, cost: Cost, at: Point, gx: Array, gv: Array) -> None:
    """Set the gradient of the cost without rows at a point: `gx` (N+1, 6) by ξ_k, k > 0, `gv` (N, 2) by v_k."""
    N, xi = gv.shape[0], at.xi
    for k in range(1, N):
        for i in range(NX):
            gx[k, i] = cost.x[i] * (errors.x[k, i] + xi[k, i])
        for m in range(NY):
            if cost.y[m] != 0.0:
                y = cost.y[m] * (errors.y[k, m] + changed(path.slope, k, m, xi))
                for i in range(NX):
                    gx[k, i] += y * path.slope[k, m, i]
        for i in range(NU):
            gx[k, NX + i] = cost.e[i] * (errors.e[k - 1, i] + xi[k, NX + i])
    for i in range(NXI):
        gx[N, i] = cost.e[i - NX] * (errors.e[N - 1, i - NX] + xi[N, i]) if i >= NX else 0.0
        for j in range(NXI):
            gx[N, i] += cost.end[i, j] * (errors.end[j] + xi[N, j])
    for k in range(N):
        for i in range(NU):
            gv[k, i] = cost.change[i] * (errors.change[k, i] + at.v[k, i])


@inlined
def adjoint(path: Path, gx: Array, gv: Array, r: Array) -> None:
    """Set `r` (N, 2) to the gradient by v alone, ξ following from it."""
    N = gv.shape[0]
    p = gx[N].copy()
    for k in range(N - 1, -1, -1):
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            r[k, i] = p[NX + i] + gv[k, i]
        if k > 0:
            for i in range(NXI):
                p[i] += gx[k, i]


@inlined
def increase(path: Path, errors: Errors, setting: Setting, first: Array, at: Point, sweep: Sweep) -> float:
    """Return the cost of the changes minus that of the origin, where the gradient is `first`."""
    total = 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.g)
    for k in range(at.v.shape[0]):
        for i in range(NU):
            total += 0.5 * (first[k, i] + sweep.g[k, i]) * at.v[k, i]
    return total
