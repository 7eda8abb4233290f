"""Limits in the barrier: their distances and multipliers, and their charges on a sample.

The arrays of the items are unused before an exchange. Their lines `z` hold the distances t, their lines `r` the
multipliers λ of the limits of each sample k:

    0, 1    changes, the slew below and above; for k = N the slacks, σ ≥ 0
    2, 3    commands, the supply below and above
    4 …     soft rows, as many to a line as there are muscles
"""

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat
from mpc.tracking.compiled.records import Bounded, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.responses import Items, row_push, row_side, row_value, slack_of
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.sizes import ALL, FORCE, FREE, JOINTS, NU, NX, NXI, RANGE, SIDES


@inlined_flat
def row_of(line: int, i: int) -> int:
    """Return the kind of a soft row by its place."""
    return RANGE + NU * (line - SIDES) + i


@inlined_flat
def is_limit(sweep: Sweep, line: int, k: int, i: int) -> bool:
    """Return whether a place in the arrays belongs to a limit."""
    if k == sweep.v.shape[0]:
        return line == 0 and i < 2
    if line < SIDES:
        return bool(sweep.held[k, i] == FREE)
    return row_of(line, i) < ALL


@inlined_flat
def distance(path: Path, setting: Setting, bounded: Bounded, at: Point, line: int, k: int, i: int) -> float:
    """Return the distance from a limit; negative beyond it."""
    if k == at.v.shape[0]:
        return float(at.sigma[i])
    if line >= SIDES:
        kind = row_of(line, i)
        return float(
            row_side(path, setting.bounds, k, kind) + at.sigma[slack_of(kind)] - row_value(path.slope, k, kind, at.xi)
        )
    v, w = at.v[k, i], at.xi[k + 1, NX + i]
    if line < 2:
        return float(v - bounded.lower[k, i] if line == 0 else bounded.upper[k, i] - v)
    return float(w - bounded.low[k, i] if line == 2 else bounded.high[k, i] - w)


@inlined_flat
def charge(path: Path, sweep: Sweep, p: Array, line: int, k: int, i: int, weight: float, push: float) -> None:
    """Add the curvature of a limit to the charges of the sweep, and its push to the gradients."""
    if line >= SIDES:
        charge_row(path, sweep, p, row_of(line, i), k, weight, push)
        return
    push = -push if line == 0 or line == 2 else push
    if line < 2:
        sweep.change[k, i] += weight
        sweep.gv[k, i] += push
    else:
        sweep.e[k, i] += weight
        sweep.gx[k + 1, NX + i] += push


@inlined_flat
def charge_row(path: Path, sweep: Sweep, p: Array, kind: int, k: int, weight: float, push: float) -> None:
    """Do so for a soft row."""
    place = JOINTS + kind - FORCE
    if kind < FORCE:
        place = kind - RANGE if kind < RANGE + JOINTS else kind - RANGE - JOINTS
    sweep.rows[k + 1, place] += weight
    for j in range(NXI):
        p[j] = 0.0
    row_push(path.slope, k, kind, push, p)
    for j in range(NXI):
        sweep.gx[k + 1, j] += p[j]


@inlined_flat
def pushed_back(items: Items, product: float, away: float, line: int, k: int, i: int) -> float:
    """Return the push of a limit at the distance `away`, where products t λ shall be `product`."""
    t, multiplier = items.z[line, k, i], items.r[line, k, i]
    return float((product + multiplier * (t - away)) / t)


@inlined_flat
def changes(
    path: Path, setting: Setting, bounded: Bounded, product: float, at: Point, items: Items, line: int, k: int, i: int
) -> tuple[float, float]:  # fmt: skip
    """Return Δt and Δλ of a limit, with the point where the whole step ends."""
    away = distance(path, setting, bounded, at, line, k, i)
    return away - items.z[line, k, i], pushed_back(items, product, away, line, k, i) - items.r[line, k, i]
