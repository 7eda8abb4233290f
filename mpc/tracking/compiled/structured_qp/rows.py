"""Rows of the QP, a·y ≤ b, with the distances t > 0 and multipliers λ > 0 of `interior`.

The rows of a sample k (w and δx of k + 1), in this order, and in a last line those of both slacks:

    0…3    v_i ≤ upper,  -v_i ≤ -lower            changes: the slew
    4…7    w_i ≤ …,  -w_i ≤ …                     commands: the supply
    8, 9   δθ - s ≤ …,  -δθ - s ≤ …               the joint range
    10, 11 -D_i δx - s_F ≤ F_i - F_min            taut cables
    N      -s ≤ 0,  -s_F ≤ 0
"""

from typing import NamedTuple

from allocator.calculus import Array, Mask
from mpc.codegen.jit import inlined_flat
from mpc.tracking.compiled.records import Bounded, Bounds, Indices, Path, Point
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, FORCE, JOINTS, NU, NX, NXI, STIFFNESSES, SUPPLY
from mpc.tracking.compiled.structured_qp.stage import changed, first_of

RESOLVED = 1e-10  # [bar], [rad], [N] below which a residual counts as 0
NEAR = 0.03  # least product t λ, as a share of their mean
WIDTH = BOUNDS * (0.04,) + BOUNDS * (0.1,) + 2 * JOINTS * (0.02,) + NU * (4.0,)  # least t at first [bar], [rad], [N]


class Rows(NamedTuple):
    """Arrays (N + 1, 12) of the rows; `span` has the range of rows in each line."""

    span: Indices  # (N + 1, 2) first, and one past the last
    b: Array
    t: Array
    multiplier: Array  # λ
    W: Array  # λ/t
    residual: Array  # a·y - b + t
    push: Array  # λ + Δλ - W a·Δy
    dt: Array
    change: Array  # Δλ


@inlined_flat
def values(path: Path, at: Point, count: int, value: Array) -> None:
    """Set `value` to a·y at a point."""
    N, xi, v, sigma = at.v.shape[0], at.xi, at.v, at.sigma
    for k in range(N):
        for i in range(NU):
            value[k, i], value[k, NU + i] = v[k, i], -v[k, i]
        if count >= SUPPLY:
            for i in range(NU):
                w = xi[k + 1, NX + i]
                value[k, BOUNDS + i], value[k, BOUNDS + NU + i] = w, -w
        if count == ALL:
            for i in range(JOINTS):
                angle = xi[k + 1, i]
                value[k, SUPPLY + i], value[k, SUPPLY + JOINTS + i] = angle - sigma[0], -angle - sigma[0]
            for i in range(NU):
                value[k, FORCE + i] = -changed(path.slope, k + 1, STIFFNESSES + i, xi) - sigma[1]
    value[N, 0], value[N, 1] = -sigma[0], -sigma[1]


@inlined_flat
def sides(path: Path, u: Array, bounds: Bounds, bounded: Bounded, b: Array) -> None:
    """Set `b` for a path with the commands `u` (N, 2)."""
    N = u.shape[0]
    for k in range(N):
        for i in range(NU):
            b[k, i], b[k, NU + i] = bounded.upper[k, i], -bounded.lower[k, i]
            # pressures outside the supply may return later
            b[k, BOUNDS + i] = max(bounds.high - u[k, i], 0.0)
            b[k, BOUNDS + NU + i] = -min(bounds.low - u[k, i], 0.0)
            b[k, FORCE + i] = path.y[k + 1, STIFFNESSES + i] - bounds.min_force
        for i in range(JOINTS):
            b[k, SUPPLY + i] = first_of(bounds.right, i) - path.x[k + 1, i]
            b[k, SUPPLY + JOINTS + i] = path.x[k + 1, i] - first_of(bounds.left, i)
    b[N, 0], b[N, 1] = 0.0, 0.0


@inlined_flat
def none(rows: Rows, at: Point) -> None:
    """Begin at the origin without rows."""
    at.xi[:], at.v[:], at.sigma[:] = 0.0, 0.0, 0.0
    rows.multiplier[:], rows.t[:], rows.W[:], rows.push[:], rows.span[:] = 0.0, 1.0, 0.0, 0.0, 0


@inlined_flat
def add(path: Path, rows: Rows, slack: Array, there: Mask, count: int, product: float, at: Point) -> int:
    """Add the missing ones of the first `count` rows of a sample, with products t λ of `product`; return the number of
    rows.
    """
    N, number, first = at.v.shape[0], 0, rows.span[0, 1]
    values(path, at, count, rows.residual)
    left0, left1 = slack[0], slack[2]
    for k in range(N):
        rows.span[k, 0], rows.span[k, 1] = 0 if there[k] else BOUNDS, count
        for j in range(max(first, rows.span[k, 0]), count):
            rows.t[k, j] = max(rows.b[k, j] - rows.residual[k, j], WIDTH[j])
            rows.multiplier[k, j] = product / rows.t[k, j]
        number += count - rows.span[k, 0]
        for i in range(2 * JOINTS):
            left0 -= rows.multiplier[k, SUPPLY + i]
        for i in range(NU):
            left1 -= rows.multiplier[k, FORCE + i]
    if count < ALL:
        return number
    rows.span[N, 1] = 2
    rows.multiplier[N, 0], rows.multiplier[N, 1] = max(left0, 0.1 * slack[0]), max(left1, 0.1 * slack[2])
    for i in range(2):
        rows.t[N, i] = at.sigma[i] = product / rows.multiplier[N, i]
    return number + 2


@inlined_flat
def measure(path: Path, at: Point, rows: Rows, count: int) -> tuple[float, float]:
    """Set residuals, W, and `push` for a step to the boundary; return the sum of the products t λ, and the greatest
    residual.
    """
    total, worst = 0.0, 0.0
    values(path, at, count, rows.residual)
    for k in range(rows.b.shape[0]):
        for j in range(rows.span[k, 0], rows.span[k, 1]):
            t, multiplier = rows.t[k, j], rows.multiplier[k, j]
            r, w = rows.residual[k, j] - rows.b[k, j] + t, multiplier / t
            r = r if abs(r) > RESOLVED else 0.0  # rounding, which W would turn into a large push
            rows.residual[k, j], rows.W[k, j], rows.push[k, j] = r, w, w * r
            total += t * multiplier
            worst = max(worst, abs(r))
    return total, worst


@inlined_flat
def row_steps(path: Path, rows: Rows, count: int, by: Point) -> float:
    """Set the rows' part of the step `by`; return the share of it at which a t or a λ is 0, at most 1."""
    share = 1.0
    values(path, by, count, rows.dt)
    for k in range(rows.b.shape[0]):
        for j in range(rows.span[k, 0], rows.span[k, 1]):
            t, multiplier, value = rows.t[k, j], rows.multiplier[k, j], rows.dt[k, j]
            dt, change = -rows.residual[k, j] - value, rows.push[k, j] - multiplier + rows.W[k, j] * value
            if t + share * dt < 0.0:
                share = -t / dt
            if multiplier + share * change < 0.0:
                share = -multiplier / change
            rows.dt[k, j], rows.change[k, j] = dt, change
    return share


@inlined_flat
def products_after(rows: Rows, share: float) -> float:
    """Return the sum of the products t λ after this share of the step."""
    total = 0.0
    for k in range(rows.b.shape[0]):
        for j in range(rows.span[k, 0], rows.span[k, 1]):
            multiplier = rows.multiplier[k, j] + share * rows.change[k, j]
            total += (rows.t[k, j] + share * rows.dt[k, j]) * multiplier
    return total


@inlined_flat
def aim_at(rows: Rows, product: float) -> None:
    """Correct `push` for products t λ of `product`, to second order."""
    for k in range(rows.b.shape[0]):
        for j in range(rows.span[k, 0], rows.span[k, 1]):
            rows.push[k, j] += (product - rows.dt[k, j] * rows.change[k, j]) / rows.t[k, j]


@inlined_flat
def go(rows: Rows, share: float, at: Point, by: Point) -> float:
    """Move by this share of the step; return the sum of the products t λ."""
    total = 0.0
    for k in range(at.v.shape[0]):
        for i in range(NXI):
            at.xi[k + 1, i] += share * by.xi[k + 1, i]
        for i in range(NU):
            at.v[k, i] += share * by.v[k, i]
    for i in range(2):
        at.sigma[i] += share * by.sigma[i]
    for k in range(rows.b.shape[0]):
        for j in range(rows.span[k, 0], rows.span[k, 1]):
            rows.t[k, j] += share * rows.dt[k, j]
            rows.multiplier[k, j] += share * rows.change[k, j]
            total += rows.t[k, j] * rows.multiplier[k, j]
    return total


@inlined_flat
def bring_near(rows: Rows, slack: Array, mean: float) -> None:
    """Raise products t λ far below their `mean` to NEAR of it; without this, one QP in a hundred stalls."""
    least, last = NEAR * mean, rows.b.shape[0] - 1
    for k in range(last + 1):
        for j in range(rows.span[k, 0], rows.span[k, 1]):
            t, multiplier = rows.t[k, j], rows.multiplier[k, j]
            if t * multiplier >= least:
                continue
            width, small = (least / slack[2 * j], 0.01 * slack[2 * j]) if k == last else (WIDTH[j], least / WIDTH[j])
            if multiplier > small:
                rows.t[k, j] = least / multiplier
            else:
                rows.t[k, j] = max(t, width if k == last else 1e-3 * width)
                rows.multiplier[k, j] = max(multiplier, least / rows.t[k, j])
