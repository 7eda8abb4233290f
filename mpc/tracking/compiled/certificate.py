"""The certificate proves that an answer to the QP without its rows solves the whole one, in one pass.

With λ the gradient's own pushes at the bounds that bind, exactly, all that is left of the gap is ½ rᵀH⁻¹r, r being the
gradient by what is free. Every change of a command is charged for by itself, so that no eigenvalue of H is below that
charge c, and c |z - z*|² ≤ rᵀH⁻¹r ≤ |r|²/c: an answer that passes, |r|/c ≤ ACCURACY, is no farther than that from the
solution. Sweeps that settle come to 2e-9 bar at horizons of 80 samples: what is refused has gone wrong. Neither slack
is used where no soft limit is broken without it.
"""

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.commands import advance
from mpc.tracking.compiled.jit import inlined
from mpc.tracking.compiled.records import Bounds, Path, Setting


@inlined
def proved(gradient: Array, lower: Array, upper: Array, z: Array, setting: Setting) -> bool:
    """Return whether `z` is within its bounds and near enough to the solution, from the cost's `gradient` there.

    Those push at a bound that want to leave through it.
    """
    square = 0.0
    for i in range(z.size):
        if not lower[i] <= z[i] <= upper[i]:
            return False
        pushes = (z[i] == lower[i] and gradient[i] >= 0.0) or (z[i] == upper[i] and gradient[i] <= 0.0)
        square += 0.0 if pushes else gradient[i] * gradient[i]
    return square <= (setting.accuracy * setting.curvature) ** 2


@inlined
def keeps_rows(path: Path, setting: Setting, u: Array, z: Array) -> bool:
    """Return whether the linear model under u + E z keeps supply, joint range and least forces; `u` (N, 2) [bar]."""
    bounds, starts, tolerance = setting.bounds, setting.starts, setting.tolerance
    dx, after, du = np.zeros(4), np.empty(4), np.zeros(2)
    block = 0
    for k in range(u.shape[0]):
        if block < starts.size and starts[block] == k:
            du[0] += z[2 * block]
            du[1] += z[2 * block + 1]
            block += 1
        for i in range(2):  # what is outside already need not come back at once
            if not min(bounds.low - u[k, i], 0.0) - tolerance <= du[i] <= max(bounds.high - u[k, i], 0.0) + tolerance:
                return False
        advance(path.A[k], path.B[k], dx, du, after)
        if not soft_kept(path.x[k + 1], path.y[k + 1], path.slope[k + 1], dx, bounds, tolerance):
            return False
    return True


@inlined
def soft_kept(x: Array, y: Array, slope: Array, dx: Array, bounds: Bounds, tolerance: float) -> bool:
    """Return whether the state x + dx keeps joint range and least forces."""
    if not bounds.left - tolerance <= x[0] + dx[0] <= bounds.right + tolerance:
        return False
    for i in range(1, 3):
        F = y[i]
        for j in range(4):
            F += slope[i, j] * dx[j]
        if not F >= bounds.min_force - tolerance:
            return False
    return True


@inlined
def finite(array: Array) -> bool:
    """Return whether all numbers of `array` (m, n) are finite."""
    for row in array:
        for value in row:
            if not np.isfinite(value):
                return False
    return True


__all__ = ["finite", "keeps_rows", "proved"]
