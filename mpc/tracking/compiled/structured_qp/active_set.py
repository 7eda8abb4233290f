"""Dual active-set method that starts from a sweep's set if only a few of its members are wrong.

Noise moves the samples at which a command turns by one or two. Sweeps that guess the whole set anew then cycle, since
the Hessian's condition number is 10⁶ and more, and an interior point needs about twelve factorisations. This method
needs only that of a sweep, and a Schur complement (R. A. Bartlett and L. T. Biegler, Optimization and Engineering 7,
2006); `exchange` has its steps. It gives up after a number of steps or with ITEMS items, and then the interior point
solves the QP.

If nearly all held changes are pushed away from their bounds, the joint was displaced, and the opposite bounds are a
better guess.
"""

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, merged
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.exchange import HUGE, Active, exchanged, let_go
from mpc.tracking.compiled.structured_qp.newton import adjoint, gradients
from mpc.tracking.compiled.structured_qp.responses import (
    BOUND,
    LAST,
    new_items,
    row_gradient,
    row_value,
)
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.rows import sides
from mpc.tracking.compiled.structured_qp.sizes import ALL, FORCE, FREE, LOWER, NU, NX, NXI, SUPPLY, UPPER
from mpc.tracking.compiled.structured_qp.stage import advance


@inlined
def new_active(N: int) -> Active:
    """Return an uninitialised active set."""
    sides, numbers, rows = np.empty((2, N + 1, NU), np.int8), np.empty((7, N + 1, NU)), np.empty((2, N + 1, ALL))
    xi, first = np.empty((2, N + 1, NXI)), np.empty((2, N, NU))
    return Active(
        sides[0], sides[1], numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], rows[0], rows[1],
        xi[0], first[0], Point(xi[1], first[1], numbers[6, 0]), new_items(N),
    )  # fmt: skip


@merged
def active_set(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, at: Point, sweep: Sweep, a: Active
) -> bool:  # fmt: skip
    """Move `at` from a sweep's solution, with the cost's gradient `sweep.r` by v, to that of the whole QP; return
    whether it is proved. The set `sweep.held` becomes the active set.
    """
    begin(path, setting, u, bounded, sweep, at, a)
    size = exchanged(path, setting, sweep, let_go(path, setting, sweep, a), at, a)
    if size < 0:
        at.sigma[0], at.sigma[1] = 0.0, 0.0
        return False
    end(path, bounded, at, sweep, a)
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    return proved_with_rows(path, setting, bounded, size, at, sweep, a)


@merged
def begin(path: Path, setting: Setting, u: Array, bounded: Bounded, sweep: Sweep, at: Point, a: Active) -> None:
    """Begin at the result of a sweep."""
    N, items = path.A.shape[0], a.items
    for k in range(N):
        for i in range(NU):
            a.base[k, i] = sweep.held[k, i]
            a.held[k, i] = sweep.held[k, i]
            a.lower[k, i], a.upper[k, i] = bounded.lower[k, i], bounded.upper[k, i]
            a.z[k, i] = at.v[k, i]
            a.r[k, i] = 0.0 if sweep.held[k, i] == FREE else sweep.r[k, i]
    for i in range(NU):
        a.base[N, i] = LOWER
        a.held[N, i] = LOWER
        a.lower[N, i], a.upper[N, i], a.z[N, i] = 0.0, HUGE if i < 2 else 0.0, 0.0
        a.r[N, i] = setting.slack[2 * i] if i < 2 else 0.0
    items.kind[LAST], items.sample[LAST], items.muscle[LAST], items.side[LAST] = BOUND, 0, 0, 0
    items.known[0] = 0
    sides(path, u, setting.bounds, bounded, a.b)


@merged
def end(path: Path, bounded: Bounded, at: Point, sweep: Sweep, a: Active) -> None:
    """Set the point to the result of the active set, within its bounds."""
    N = path.A.shape[0]
    for k in range(N):
        for i in range(NU):
            held, lower, upper = a.held[k, i], bounded.lower[k, i], bounded.upper[k, i]
            within = min(max(a.z[k, i], lower), upper)
            at.v[k, i] = within if held == FREE else lower if held == LOWER else upper
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
            sweep.held[k, i] = held
        advance(path.A, path.B, k, at.xi)
    for i in range(2):
        at.sigma[i] = max(a.z[N, i], 0.0)


@merged
def proved_with_rows(
    path: Path, setting: Setting, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active
) -> bool:  # fmt: skip
    """Return whether the point is the solution, by the multipliers of its rows: see `certificate`. The sweep's `gx` and
    `gv` are the cost's gradients; the first is overwritten.
    """
    slack, items, p, total, square = setting.slack, a.items, a.items.p, 0.0, 0.0
    c0, c1 = slack[0] + slack[1] * at.sigma[0], slack[2] + slack[3] * at.sigma[1]
    for q in range(size):
        kind, sample, multiplier = items.kind[q], items.sample[q], items.multiplier[q]
        if kind > BOUND:
            for i in range(NXI):
                p[i] = 0.0
            row_gradient(path.slope, sample, kind, p)
            for i in range(NXI):
                sweep.gx[sample + 1, i] += multiplier * p[i]
            over = row_value(path.slope, sample, kind, at.xi) - a.b[sample, kind]
            if kind >= FORCE:
                over -= at.sigma[1]
                c1 -= multiplier
            elif kind >= SUPPLY:
                over -= at.sigma[0]
                c0 -= multiplier
            total += abs(multiplier * over)
    adjoint(path, sweep.gx, sweep.gv, sweep.r)
    for k in range(bounded.there.size):
        for i in range(NU):
            g, v = sweep.r[k, i], at.v[k, i]
            pushes = (v == bounded.lower[k, i] and g >= 0.0) or (v == bounded.upper[k, i] and g <= 0.0)
            square += 0.0 if pushes or not bounded.there[k] else g * g
    c0 = 0.0 if at.sigma[0] == 0.0 and c0 > 0.0 else c0
    c1 = 0.0 if at.sigma[1] == 0.0 and c1 > 0.0 else c1
    square /= setting.curvature
    square += c0 * c0 / slack[1] + c1 * c1 / slack[3]
    gap, most = total + 0.5 * square, 0.5 * setting.curvature * setting.accuracy**2
    return float(gap) <= most


@merged
def reversed_instead(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, sweep: Sweep, a: Active
) -> bool:
    """Reverse the sweep's held changes that are pushed away from their bounds, if most are and that costs less; return
    whether they were reversed. `sweep.r` is the cost's gradient by v at the point.
    """
    N, held, r, g, first, other = path.A.shape[0], sweep.held, sweep.r, sweep.g, a.first, a.other
    wrong, number, cost, turned = 0, 0, 0.0, 0.0
    for i in range(NXI):
        other.xi[0, i] = 0.0
    for k in range(N):
        for i in range(NU):
            side, lower, upper = held[k, i], bounded.lower[k, i], bounded.upper[k, i]
            if side != FREE and lower < upper:
                number += 1
                if side * r[k, i] > 0.0:
                    wrong += 1
                    side = -side
            cost += (first[k, i] + r[k, i]) * at.v[k, i]
            other.v[k, i] = lower if side == LOWER else upper if side == UPPER else 0.0
            other.xi[k + 1, NX + i] = other.xi[k, NX + i] + other.v[k, i]
        advance(path.A, path.B, k, other.xi)
    if 2 * wrong <= number:
        return False
    gradients(path, errors, setting.cost, other, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, g)
    for k in range(N):
        for i in range(NU):
            turned += (first[k, i] + g[k, i]) * other.v[k, i]
    if turned >= cost:
        return False
    for k in range(N):
        for i in range(NU):
            if held[k, i] * r[k, i] > 0.0 and bounded.lower[k, i] < bounded.upper[k, i]:
                held[k, i] = -held[k, i]
    return True
