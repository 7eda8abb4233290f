"""Limits of a sample k that items can hold (`responses`): changes and commands, and the soft rows a·y ≤ b.

BOUND       ±v_i ≤ …                              changes: the slew
SUPPLY      ±w_i ≤ …                              commands of k + 1: the supply
RANGE …     δθ - s ≤ …,  then  -δθ - s ≤ …        the joint range, in the state k + 1
FORCE …     -D_i δx - s_F ≤ F_i - F_min           taut cables
"""

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat
from mpc.tracking.compiled.records import Bounds, Path
from mpc.tracking.compiled.structured_qp.sizes import FORCE, JOINTS, NX, RANGE, STIFFNESSES, SUPPLY
from mpc.tracking.compiled.structured_qp.stage import changed, first_of

WIDTHS = 0.04, 0.1, 0.02, 4.0  # equivalent violations of slew, supply, range, force [bar], [bar], [rad], [N]


@inlined_flat
def width(kind: int) -> float:
    """Return the violation of this kind that counts as much as those of others."""
    return WIDTHS[3] if kind >= FORCE else WIDTHS[2] if kind >= RANGE else WIDTHS[1] if kind == SUPPLY else WIDTHS[0]


@inlined_flat
def row_push(slope: Array, k: int, kind: int, by: float, p: Array) -> None:
    """Add to `p` (6,), a gradient by ξ[k + 1], that of the soft row `kind` times `by`."""
    if kind >= FORCE:
        for i in range(NX):
            p[i] -= by * slope[k + 1, STIFFNESSES + kind - FORCE, i]
    elif kind >= RANGE + JOINTS:
        p[kind - RANGE - JOINTS] -= by
    else:
        p[kind - RANGE] += by


@inlined_flat
def row_value(slope: Array, k: int, kind: int, xi: Array) -> float:
    """Return the value of the soft row `kind` without its slack."""
    if kind >= FORCE:
        return float(-changed(slope, k + 1, STIFFNESSES + kind - FORCE, xi))
    if kind >= RANGE + JOINTS:
        return float(-xi[k + 1, kind - RANGE - JOINTS])
    return float(xi[k + 1, kind - RANGE])


@inlined_flat
def row_side(path: Path, bounds: Bounds, k: int, kind: int) -> float:
    """Return the side b of the soft row `kind`."""
    if kind >= FORCE:
        return float(path.y[k + 1, STIFFNESSES + kind - FORCE] - bounds.min_force)
    if kind >= RANGE + JOINTS:
        i = kind - RANGE - JOINTS
        return float(path.x[k + 1, i] - first_of(bounds.left, i))
    i = kind - RANGE
    return float(first_of(bounds.right, i) - path.x[k + 1, i])


@inlined_flat
def slack_of(kind: int) -> int:
    """Return which slack a soft row has: 0 is s, 1 is s_F."""
    return 1 if kind >= FORCE else 0
