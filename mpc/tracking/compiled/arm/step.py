"""Template of an arm's step: linearisation and the rollout of an answer; `solve` has the QP between them.

`mpc.tracking.compiled.arm.module` replaces the lines below that begin with `FORMULAS` by the sizes of the arm and the
arm's formulas: n joints, m muscles, and functions that fill flat arrays, matrices by columns:

    outputs          (q, P) ↦ y = (svec K, F)
    output_slopes    (q, P) ↦ y, its Jacobian by q and P

and `advance`, the motion over a sample (`mpc.model.arm.compiled.motion`). The array c holds the formulas' numbers.
Pressures are in Pa, decisions z in bar, as in `mpc.tracking.qp.condense`. A path is a motion and its derivatives:
x (N+1, 2n + m), S (N, 2n, 2n + 2m) the Jacobian of the next (q, ω) by (q, ω), P and u, y (N+1, p) and slope
(N+1, n + m, p) of y by (q, P). The response of pressures to commands is always the same.
"""

from typing import Any

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.commands import finite, limit
from mpc.tracking.compiled.records import Indices
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, NX

FORMULAS: Any = None
advance = outputs = output_slopes = FORMULAS

n, m = JOINTS, NU


@compiled
def linearise(
    c: Array, h: float, decay: Array, bounds: Array, u_last: Array, x0: Array, asked: Array, d: Array,
    u: Array, x: Array, S: Array, y: Array, slope: Array,
) -> None:  # fmt: skip
    """Fill in `u`, the commands `asked` (N, m) [Pa] moved to within the limits, and their path.

    `decay` (substeps, 3, m) is the remaining share of a pressure's error at beginning, middle and end of each step `h`
    [s]; `bounds` (3,) are the supply and the greatest change [Pa].
    """
    for k in range(u.shape[0]):
        for j in range(m):
            u[k, j] = asked[k, j]
    limit(bounds[0], bounds[1], bounds[2], u_last, 1.0, u)
    for i in range(NX):
        x[0, i] = x0[i]
    for k in range(u.shape[0]):
        advance(c, h, decay, x[k], u[k], d[k], x[k + 1], S[k])
    for k in range(x.shape[0]):
        output_slopes(x[k, :n], x[k, 2 * n :], c, y[k], slope[k].reshape(-1))


@inlined
def roll(c: Array, h: float, decay: Array, x0: Array, u: Array, d: Array, x: Array, y: Array) -> None:
    """Fill in the motion from `x0` under `u` without derivatives."""
    for i in range(NX):
        x[0, i] = x0[i]
    for k in range(u.shape[0]):
        advance(c, h, decay, x[k], u[k], d[k], x[k + 1], None)
    for k in range(x.shape[0]):
        outputs(x[k, :n], x[k, 2 * n :], c, y[k])


@compiled
def rollout(
    c: Array, h: float, decay: Array, bounds: Array, u_last: Array, x0: Array, d: Array, u: Array, starts: Indices,
    z: Array, moved: Array, x: Array, y: Array,
) -> bool:  # fmt: skip
    """Fill in `u` changed by `z`, `moved` to within the limits, and its motion; return whether that is finite."""
    for j in range(m):
        change, block = 0.0, 0
        for k in range(u.shape[0]):
            if block < starts.size and starts[block] == k:
                change += BAR * z[block * m + j]
                block += 1
            moved[k, j] = u[k, j] + change
    limit(bounds[0], bounds[1], bounds[2], u_last, 1.0, moved)
    roll(c, h, decay, x0, moved, d, x, y)
    return finite(x) and finite(y)
