"""The two compiled halves of a step: before the QP solver, and after it.

This file is a template. `mpc.compiled.module` puts the law of the joint in the place of the lines below that begin with
`LAW`, as functions of scalars that return tuples: `stage` (x, u, d) ↦ (x after a substep, its Jacobian by x and u),
`outputs` x ↦ (y, its Jacobian) with y = (K, F1, F2), `advance` and `look` the same without Jacobians; Jacobians by
columns. The tuple c holds the numbers of the four.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.compiled.certificate import keeps_rows, proved
from mpc.compiled.commands import bounds, cumulated, deviations, limited
from mpc.compiled.condensing import condensed
from mpc.compiled.jit import compiled, inlined
from mpc.compiled.records import BoxQP, Path, Setting, Wish

LAW: Any = None
stage = outputs = advance = look = LAW

SOLVED, ROWS, REFUSED = 0, 1, 2


@compiled
def prepare(
    c: Any, setting: Setting, x0: Array, u: Array, d: Array, wish: Wish, last: Array
) -> tuple[Path, Array, BoxQP]:
    """Path, its commands (N, 2) [bar] and its QP about the commands `u` (N, 2) [Pa], moved to within the limits.

    `last` (2, 2) [Pa]: the command and the feed-forward of the sample before.
    """
    N, u_last, e_last, asked = u.shape[0], np.empty(2), np.empty(2), np.empty(u.shape)
    for i in range(2):
        u_last[i] = last[0, i] / BAR
        e_last[i] = (last[0, i] - last[1, i]) / BAR
        for k in range(N):
            asked[k, i] = u[k, i] / BAR
    moved = limited(setting.room, u_last, asked)
    x, A, B = slopes(c, x0, moved, d, setting.substeps)
    y, slope = read(c, x)
    path = Path(x, y, A, B, slope)
    errors = deviations(x, y, moved, wish, e_last)
    H, f = condensed(path, errors, setting.cost, setting.starts)
    lower, upper = bounds(setting, moved, u_last)
    return path, moved, BoxQP(H, f, lower, upper)


@compiled
def finish(
    c: Any, setting: Setting, path: Path, u: Array, qp: BoxQP, z: Array, multipliers: Array, u_last: Array, d: Array,
    tolerances: tuple[float, float, float],
) -> tuple[int, Array, Array, Array]:  # fmt: skip
    """SOLVED or why not, and then commands (N, 2) [Pa], states and outputs (K, F1, F2) that follow from `z`.

    `tolerances`: of rows left out, of bounds, of the gap.
    """
    if not proved(qp, z, multipliers, setting.cost.change, tolerances[1], tolerances[2]):
        return REFUSED, u, path.x, path.y
    if not keeps_rows(path, setting, u, z, tolerances[0]):
        return ROWS, u, path.x, path.y
    N, before = u.shape[0], np.empty(2)
    wanted = cumulated(setting.starts, z, N)
    for i in range(2):
        before[i] = u_last[i] / BAR
        for k in range(N):
            wanted[k, i] += u[k, i]
    moved = limited(setting.room, before, wanted)
    x = motion(c, path.x[0], moved, d, setting.substeps)
    y = np.empty((N + 1, 3))
    for k in range(N + 1):
        y[k, 0], y[k, 1], y[k, 2] = look(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c[3])
        for i in range(2):
            if k < N:
                moved[k, i] *= BAR
    return SOLVED, moved, x, y


@inlined
def motion(c: Any, start: Array, u: Array, d: Array, substeps: int) -> Array:
    """The states (N+1, 4). `advance`: (x, u, d) ↦ x after a substep."""
    N = u.shape[0]
    x = np.empty((N + 1, 4))
    x0, x1, x2, x3 = start[0], start[1], start[2], start[3]
    x[0, 0], x[0, 1], x[0, 2], x[0, 3] = x0, x1, x2, x3
    for k in range(N):
        for _ in range(substeps):
            x0, x1, x2, x3 = advance(x0, x1, x2, x3, u[k, 0], u[k, 1], d[k], c[2])
        x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], x[k + 1, 3] = x0, x1, x2, x3
    return x


@inlined
def slopes(c: Any, x0: Array, u: Array, d: Array, substeps: int) -> tuple[Array, Array, Array]:
    """x (N+1, 4), A (N, 4, 4), B (N, 4, 2). `stage`: (x, u, d) ↦ (x after a substep, its Jacobian by (x, u)' columns)."""
    N = u.shape[0]
    x, A, B = np.empty((N + 1, 4)), np.zeros((N, 4, 4)), np.zeros((N, 4, 2))
    for i in range(4):
        x[0, i] = x0[i]
    for k in range(N):
        for i in range(4):
            x[k + 1, i] = x[k, i]
            A[k, i, i] = 1.0
        for _ in range(substeps):
            now = x[k + 1]
            o = stage(now[0], now[1], now[2], now[3], u[k, 0], u[k, 1], d[k], c[0])
            for i in range(4):
                now[i] = o[i]
            chain(o, A[k])
            chain(o, B[k])
            for i in range(4):
                B[k, i, 0] += o[20 + i]
                B[k, i, 1] += o[24 + i]
    return x, A, B


@inlined
def chain(o: Any, S: Array) -> None:
    """S ← (∂x_next/∂x) S for the slope that begins at o[4], by columns."""
    for j in range(S.shape[1]):
        s0, s1, s2, s3 = S[0, j], S[1, j], S[2, j], S[3, j]
        for i in range(4):
            S[i, j] = o[4 + i] * s0 + o[8 + i] * s1 + o[12 + i] * s2 + o[16 + i] * s3


@inlined
def read(c: Any, x: Array) -> tuple[Array, Array]:
    """Outputs y (N+1, 3) = (K, F1, F2) and their gradients (N+1, 3, 4). `outputs`: x ↦ (y, ∂y/∂x by columns)."""
    y, slope = np.empty((x.shape[0], 3)), np.empty((x.shape[0], 3, 4))
    for k in range(x.shape[0]):
        o = outputs(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c[1])
        for i in range(3):
            y[k, i] = o[i]
            for j in range(4):
                slope[k, i, j] = o[3 + 3 * j + i]
    return y, slope


__all__ = ["REFUSED", "ROWS", "SOLVED", "finish", "prepare"]
