"""Certificate that an answer to the QP without its rows solves the whole QP, in one pass.

With λ exactly the gradient's pushes at the active bounds, the gap reduces to ½ rᵀH⁻¹r, r being the gradient by the free
changes. Every change of a command has a cost c of its own, so that no eigenvalue of H is below c, and c
|z - z*|² ≤ rᵀH⁻¹r ≤ |r|²/c. An answer with |r|/c ≤ ACCURACY is no farther than that from the solution. Sweeps that
settle reach 2e-9 bar at horizons of 80 samples, so that a refused answer is wrong. The slacks are zero if no soft limit
is violated without them.
"""

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.newton import adjoint, gradients
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, JOINTS, NU, NX, STIFFNESSES, SUPPLY
from mpc.tracking.compiled.structured_qp.stage import advance, changed, first_of


@inlined_flat
def proved(gradient: Array, bounded: Bounded, v: Array, setting: Setting) -> bool:
    """Return whether the changes `v` (N, 2) are near enough to the solution, from the cost's `gradient` (N, 2) there.

    The changes are within their bounds; those that would leave through a bound push at it.
    """
    lower, upper, there = bounded
    square = 0.0
    for k in range(there.size):
        for i in range(NU):
            g = gradient[k, i]
            if not lower[k, i] <= v[k, i] <= upper[k, i]:
                return False
            pushes = (v[k, i] == lower[k, i] and g >= 0.0) or (v[k, i] == upper[k, i] and g <= 0.0)
            square += 0.0 if pushes or not there[k] else g * g
    return square <= (setting.accuracy * setting.curvature) ** 2


@inlined
def confirmed(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, gx: Array, gv: Array, r: Array
) -> bool:
    """Return whether the point, within its bounds, is the solution except for the rows."""
    gradients(path, errors, setting.cost, at, gx, gv)
    adjoint(path, gx, gv, r)
    return proved(r, bounded, at.v, setting)


@inlined_flat
def brought_within(path: Path, bounded: Bounded, at: Point) -> None:
    """Move the changes to within their bounds, and update the rest of the point."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            at.v[k, i] = min(max(at.v[k, i], bounded.lower[k, i]), bounded.upper[k, i])
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)


@inlined_flat
def needed(path: Path, setting: Setting, u: Array, at: Point, tolerance: float) -> int:
    """Return the number of rows of a sample that the QP needs for supply, joint range and least forces.

    Those are the rows of the changes, and more if the linear model violates others by more than `tolerance` at the
    point; `u` (N, 2) [bar].
    """
    bounds, xi, count = setting.bounds, at.xi, BOUNDS
    for k in range(u.shape[0]):
        for i in range(NU):  # pressures outside the supply may return later
            w = xi[k + 1, NX + i]
            if not min(bounds.low - u[k, i], 0.0) - tolerance <= w <= max(bounds.high - u[k, i], 0.0) + tolerance:
                count = SUPPLY
            F = path.y[k + 1, STIFFNESSES + i] + changed(path.slope, k + 1, STIFFNESSES + i, xi)
            if not F >= bounds.min_force - tolerance:
                return ALL
        for i in range(JOINTS):
            left, right = first_of(bounds.left, i), first_of(bounds.right, i)
            if not left - tolerance <= path.x[k + 1, i] + xi[k + 1, i] <= right + tolerance:
                return ALL
    return count


@inlined
def finite(array: Array) -> bool:
    """Return whether all numbers of `array` (m, n) are finite."""
    for row in array:
        for value in row:
            if not np.isfinite(value):
                return False
    return True
