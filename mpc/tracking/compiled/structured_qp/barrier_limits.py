"""Limits in the barrier: their distances and multipliers, and their charges on a sample.

The arrays of the items are unused before an exchange. Their lines `z` hold the distances t, their lines `r` the
multipliers λ of the limits of each sample k:

    0, 1    changes, the slew below and above; for k = N the slacks, σ ≥ 0
    2, 3    commands, the supply below and above
    4 …     soft rows, as many to a line as there are muscles

Slacks in the barrier: two more unknowns of a sweep, at its border.

A slack σ enters all soft rows of its kind, a·ξ - σ ≤ b, so that it couples all samples. With y the response of the
changes to it, and w = λ/t,

    (ρ₂ + λ_σ/σ + Σ w - Σ w a·y) Δσ = -∇_σ,        y = H⁻¹ Σ w a

for both slacks together. While its rows weigh little against its own terms, y is left out.
"""

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat, merged
from mpc.tracking.compiled.records import Bounded, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.responses import Items, row_push, row_side, row_value, slack_of
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.sizes import (
    ALL,
    FORCE,
    FREE,
    HIGH,
    JOINTS,
    LIMIT_LINES,
    LOW,
    LOWER,
    NU,
    NX,
    NXI,
    RANGE,
    SIDES,
    UPPER,
)
from mpc.tracking.compiled.structured_qp.stage import advance, answered, gone_along, linear_before

COUPLED = 0.1  # [-] of the slack's own curvature: more is solved with the changes


@inlined
def slackened(path: Path, setting: Setting, product: float, at: Point, sweep: Sweep, items: Items, xi: Array) -> None:
    """Move the slacks, and the changes with them, from where a sweep has moved the changes alone.

    The first four entries of `step` are the sums of pushes and of curvatures of the rows, as `weigh` sets them.
    """
    g0, own0 = by_slack(setting, product, at, items, 0)
    g1, own1 = by_slack(setting, product, at, items, 1)
    rows0, rows1 = items.step[2], items.step[3]
    g0, g1, h00, h01, h11 = g0 - items.step[0], g1 - items.step[1], own0 + rows0, 0.0, own1 + rows1
    if rows0 > COUPLED * own0:
        g0 -= pulled(path, items, 0, sweep.xi)
        respond_to_slack(path, sweep, items, 0, xi)
        h00 -= pulled(path, items, 0, xi)
    if rows1 > COUPLED * own1:
        g1 -= pulled(path, items, 1, sweep.xi)
        respond_to_slack(path, sweep, items, 1, xi)
        h11 -= pulled(path, items, 1, xi)
        h01 = -pulled(path, items, 0, xi) if rows0 > COUPLED * own0 else 0.0
    det = h00 * h11 - h01 * h01
    s0, s1 = (h01 * g1 - h11 * g0) / det, (h01 * g0 - h00 * g1) / det
    at.sigma[0] += s0
    at.sigma[1] += s1
    s0, s1 = s0 if rows0 > COUPLED * own0 else 0.0, s1 if rows1 > COUPLED * own1 else 0.0
    if s0 != 0.0 or s1 != 0.0:
        follow(path, s0, s1, at, sweep, items)


@inlined_flat
def follow(path: Path, s0: float, s1: float, at: Point, sweep: Sweep, items: Items) -> None:
    """Move the point and the step of a sweep by the responses to both slacks."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            v = s0 * items.z[LIMIT_LINES, k, i] if s0 != 0.0 else 0.0  # else its line is not set
            v += s1 * items.z[LIMIT_LINES + 1, k, i] if s1 != 0.0 else 0.0
            sweep.v[k, i] += v
            at.v[k, i] += v
            sweep.xi[k + 1, NX + i] = sweep.xi[k, NX + i] + sweep.v[k, i]
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, sweep.xi)
        advance(path.A, path.B, k, at.xi)


@inlined_flat
def by_slack(setting: Setting, product: float, at: Point, items: Items, j: int) -> tuple[float, float]:
    """Return the gradient by the slack j without its rows, and its own curvature."""
    N, rho, square = at.v.shape[0], setting.slack[2 * j], setting.slack[2 * j + 1]
    weight = items.r[0, N, j] / items.z[0, N, j]
    return rho + square * at.sigma[j] - pushed_back(items, product, weight, at.sigma[j], 0, N, j), square + weight


@inlined_flat
def respond_to_slack(path: Path, sweep: Sweep, items: Items, j: int, xi: Array) -> None:
    """Set the line z of the slack j to the response of the changes to it, and `xi` to that of the states."""
    N, c, p = sweep.v.shape[0], LIMIT_LINES + j, items.p
    for i in range(NXI):
        p[i], xi[0, i] = 0.0, 0.0
    for k in range(N - 1, -1, -1):
        for line in range(SIDES, LIMIT_LINES):
            for i in range(NU):
                kind = row_of(line, i)
                if kind < ALL and slack_of(kind) == j:
                    row_push(path.slope, k, kind, -items.r[line, k, i] / items.z[line, k, i], p)
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            items.r[c, k, i] = p[NX + i]
        answered(sweep.R, sweep.D, sweep.inverse, sweep.held, k, c, -1, p, items.z, items.r)
    for k in range(N):
        gone_along(sweep.R, sweep.D, sweep.feedback, sweep.held, k, c, xi, items.z, items.r)
        advance(path.A, path.B, k, xi)


@inlined_flat
def pulled(path: Path, items: Items, j: int, xi: Array) -> float:
    """Return Σ w a·ξ of the rows of the slack j."""
    total = 0.0
    for k in range(path.A.shape[0]):
        for line in range(SIDES, LIMIT_LINES):
            for i in range(NU):
                kind = row_of(line, i)
                if kind < ALL and slack_of(kind) == j:
                    total += items.r[line, k, i] / items.z[line, k, i] * row_value(path.slope, k, kind, xi)
    return total


@inlined_flat
def row_of(line: int, i: int) -> int:
    """Return the kind of a soft row by its place."""
    return RANGE + NU * (line - SIDES) + i


@inlined_flat
def side_of(line: int) -> int:
    """Return the state of a change that is held at the limit of a line."""
    below, above = (LOWER, UPPER) if line < 2 else (LOW, HIGH)
    return above if line == 1 or line == 3 else below


@merged
def is_limit(sweep: Sweep, line: int, k: int, i: int) -> bool:
    """Return whether a place in the arrays belongs to a limit."""
    if line < SIDES:
        return bool(sweep.held[k, i] == FREE)
    return row_of(line, i) < ALL


@merged
def distance(path: Path, setting: Setting, bounded: Bounded, at: Point, line: int, k: int, i: int) -> float:
    """Return the distance from a limit; negative beyond it."""
    if line >= SIDES:
        kind = row_of(line, i)
        away = row_side(path, setting.bounds, k, kind) - row_value(path.slope, k, kind, at.xi)
        return float(away + at.sigma[slack_of(kind)])
    v, w = at.v[k, i], at.xi[k + 1, NX + i]
    if line < 2:
        return float(v - bounded.lower[k, i] if line == 0 else bounded.upper[k, i] - v)
    return float(w - bounded.low[k, i] if line == 2 else bounded.high[k, i] - w)


@merged
def pushed_back(items: Items, product: float, weight: float, away: float, line: int, k: int, i: int) -> float:
    """Return the push of a limit of curvature `weight` and at the distance `away`; its t λ shall be `product`."""
    t = items.z[line, k, i]
    return float(product / t + weight * (t - away))


@merged
def shortened(items: Items, product: float, away: float, line: int, k: int, i: int) -> tuple[float, float]:
    """Return by how much more than a distance the whole step takes it back, and a multiplier; -Δt/t and -Δλ/λ."""
    t, near = items.z[line, k, i], away / items.z[line, k, i]
    return float(1.0 - near), float(near - product / (t * items.r[line, k, i]))


@merged
def moved_on(
    items: Items, product: float, away: float, whole: float, dual: float, line: int, k: int, i: int
) -> float:  # fmt: skip
    """Move a distance and a multiplier by these shares of their steps, and return their product then."""
    t, multiplier = items.z[line, k, i], items.r[line, k, i]
    items.z[line, k, i] = t + whole * (away - t)
    items.r[line, k, i] = multiplier + dual * ((product - multiplier * away) / t)
    return float(items.z[line, k, i] * items.r[line, k, i])


@merged
def charge(sweep: Sweep, line: int, k: int, i: int, weight: float, push: float) -> None:
    """Add the curvature of a slew or supply to the charges of the sweep, and its push to the gradients."""
    push = -push if line == 0 or line == 2 else push
    if line < 2:
        sweep.change[k, i] += weight
        sweep.gv[k, i] += push
    else:
        sweep.e[k, i] += weight
        sweep.gx[k + 1, NX + i] += push


@inlined_flat
def charge_row(path: Path, sweep: Sweep, kind: int, k: int, weight: float, push: float) -> None:
    """Do so for a soft row."""
    place = JOINTS + kind - FORCE
    if kind < FORCE:
        place = kind - RANGE if kind < RANGE + JOINTS else kind - RANGE - JOINTS
    sweep.rows[k + 1, place] += weight
    row_push(path.slope, k, kind, push, sweep.gx[k + 1])
