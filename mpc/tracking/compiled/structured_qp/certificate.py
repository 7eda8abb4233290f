"""The certificate proves that an answer to the QP without its rows solves the whole one, in one pass.

With λ the gradient's own pushes at the bounds that bind, exactly, all that is left of the gap is ½ rᵀH⁻¹r, r being the
gradient by what is free. Every change of a command is charged for by itself, so that no eigenvalue of H is below that
charge c, and c |z - z*|² ≤ rᵀH⁻¹r ≤ |r|²/c: an answer that passes, |r|/c ≤ ACCURACY, is no farther than that from the
solution. Sweeps that settle come to 2e-9 bar at horizons of 80 samples: what is refused has gone wrong. Neither slack
is used where no soft limit is broken without it.
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

    They are brought to within their bounds before, and those push at a bound that want to leave through it.
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
    """Return whether the point, within its bounds, is the solution but for the rows."""
    gradients(path, errors, setting.cost, at, gx, gv)
    adjoint(path, gx, gv, r)
    return proved(r, bounded, at.v, setting)


@inlined_flat
def brought_within(path: Path, bounded: Bounded, at: Point) -> None:
    """Move the changes to within their bounds, and the rest of the point to where they lead."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            at.v[k, i] = min(max(at.v[k, i], bounded.lower[k, i]), bounded.upper[k, i])
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)


@inlined_flat
def needed(path: Path, setting: Setting, u: Array, at: Point, tolerance: float) -> int:
    """Return how many rows of a sample the linear model needs to keep supply, joint range and least forces, by what it
    breaks at a point by more than a `tolerance`: none but those of the changes where it breaks nothing; `u` (N, 2)
    [bar].
    """
    bounds, xi, count = setting.bounds, at.xi, BOUNDS
    for k in range(u.shape[0]):
        for i in range(NU):  # what is outside already need not come back at once
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
