"""The proof that an answer to the QP without its rows solves the whole one: what `mpc.certified` asks, in one pass.

Every change of a command is charged for by itself, so that no eigenvalue of H is below that charge c: the term
½ rᵀH⁻¹r of the gap is at most ½|r|²/c. Neither slack is used where no soft limit is broken without it.
"""

import numpy as np

from allocator.calculus import Array
from mpc.compiled.commands import carried
from mpc.compiled.jit import inlined
from mpc.compiled.records import BoxQP, Path, Room, Setting


@inlined
def proved(qp: BoxQP, z: Array, multipliers: Array, setting: Setting) -> bool:
    """Whether `z` is within its bounds, and near enough to the least cost; False for what is not finite."""
    _, primal, share = setting.tolerances
    square, away, gain = 0.0, 0.0, 0.0
    for i in range(z.size):
        Hz = 0.0
        for j in range(z.size):
            Hz += qp.H[i, j] * z[j]
        push = multipliers[i]
        r = Hz + qp.f[i] + push
        square += r * r
        away += push * ((qp.upper[i] if push > 0.0 else qp.lower[i]) - z[i])
        gain -= z[i] * (0.5 * Hz + qp.f[i])
        if not qp.lower[i] - primal <= z[i] <= qp.upper[i] + primal:
            return False
    gap = 0.5 * square / setting.cost.change + away
    return abs(gap) <= share * max(abs(gain), 1.0)


@inlined
def proved_by_gradient(before: Array, after: Array, lower: Array, upper: Array, z: Array, setting: Setting) -> bool:
    """`proved`, from the cost's gradients at 0 and at `z`: those push at a bound that want to leave through it."""
    _, primal, share = setting.tolerances
    square, gain = 0.0, 0.0
    for i in range(z.size):
        if not lower[i] - primal <= z[i] <= upper[i] + primal:
            return False
        pushes = (z[i] == lower[i] and after[i] >= 0.0) or (z[i] == upper[i] and after[i] <= 0.0)
        square += 0.0 if pushes else after[i] * after[i]
        gain -= 0.5 * z[i] * (before[i] + after[i])
    return 0.5 * square / setting.cost.change <= share * max(abs(gain), 1.0)


@inlined
def keeps_rows(path: Path, setting: Setting, u: Array, z: Array) -> bool:
    """Whether the linear model under u + E z keeps supply, joint range and least forces, from ū's (N, 2) [bar]."""
    room, starts, tolerance = setting.room, setting.starts, setting.tolerances[0]
    dx, after, du = np.zeros(4), np.empty(4), np.zeros(2)
    block = 0
    for k in range(u.shape[0]):
        if block < starts.size and starts[block] == k:
            du[0] += z[2 * block]
            du[1] += z[2 * block + 1]
            block += 1
        for i in range(2):  # what is outside already need not come back at once
            if not min(room.low - u[k, i], 0.0) - tolerance <= du[i] <= max(room.high - u[k, i], 0.0) + tolerance:
                return False
        carried(path.A[k], path.B[k], dx, du, after)
        if not soft_kept(path.x[k + 1], path.y[k + 1], path.slope[k + 1], dx, room, tolerance):
            return False
    return True


@inlined
def soft_kept(x: Array, y: Array, slope: Array, dx: Array, room: Room, tolerance: float) -> bool:
    """Joint range and least forces in the state x + dx."""
    if not room.left - tolerance <= x[0] + dx[0] <= room.right + tolerance:
        return False
    for i in range(1, 3):
        F = y[i]
        for j in range(4):
            F += slope[i, j] * dx[j]
        if not F >= room.min_force - tolerance:
            return False
    return True


@inlined
def finite(array: Array) -> bool:
    """Whether all numbers of `array` (m, n) are finite."""
    for row in array:
        for value in row:
            if not np.isfinite(value):
                return False
    return True


__all__ = ["finite", "keeps_rows", "proved", "proved_by_gradient"]
