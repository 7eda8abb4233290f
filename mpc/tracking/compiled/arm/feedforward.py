"""Template of an arm's feed-forward: the targets of the allocation, and the commands from its result.

`mpc.tracking.compiled.arm.module` replaces the lines below that begin with `FORMULAS` by functions that fill flat
arrays, matrices by columns:

    statics          (q, ω, ω') ↦ M ω' + C + Dω + g, then at no pressure y' = (τ, svec K), its Jacobian by P, the forces
                     and their slopes by P
    expansion        (q, ω, P) ↦ the fall of the pressures as the muscles swell

Pressures are in Pa. Of a preview that stands still there is one sample for all.
"""

from typing import Any

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat
from mpc.tracking.compiled.arm.inverse_dynamics import allocate_at, allocation_at, proof_at, prove_at
from mpc.tracking.compiled.arm.records import ArmInverse, ArmTargets
from mpc.tracking.compiled.arm.views import inverse_in, targets_in
from mpc.tracking.compiled.commands import finite
from mpc.tracking.compiled.records import Reference
from mpc.tracking.compiled.sample.layout import Inputs
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, STIFFNESSES

FORMULAS: Any = None
statics = expansion = FORMULAS

TARGETS = JOINTS + STIFFNESSES  # targets of a sample
SURE = 1e-9  # residual of optimality up to which an allocation is accepted


@inlined_flat
def feed_forward(i: Inputs, asked: Array, K: Array, d: Array, found: Reference, moved: Array) -> bool:
    """Fill in the feed-forward of `mpc.tracking.feedforward.InverseDynamics`, and the distances `moved` (3,).

    Return whether the allocation is proved. `turned` of the inputs (N+1, e, e) turns svec K into a hand's.
    """
    inverse, to, samples = inverse_in(i.inverse), targets_in(i.targets), found.x.shape[0]
    rows = 1 if still(asked, K, d, samples) else samples
    if not targets(i, inverse, rows, asked, K, d, found.x, to):
        return False
    if i.turned.size > 0:
        turn_rows(i.turned.reshape(-1, STIFFNESSES, STIFFNESSES), rows, to)
    sure = allocated(i, rows, to.residual)
    follow(i.c, inverse, rows, asked, K, to, found, moved)
    return sure


@inlined_flat
def still(asked: Array, K: Array, d: Array, samples: int) -> bool:
    """Return whether all samples of flat previews and torques are equal."""
    for array in (asked, K, d):
        size = array.size // samples
        for k in range(size, array.size):
            if array[k] != array[k % size]:
                return False
    return True


@inlined_flat
def targets(
    i: Inputs, inverse: ArmInverse, rows: int, asked: Array, K: Array, d: Array, x: Array, to: ArmTargets
) -> bool:
    """Fill in the allocation's targets of the first `rows` samples, and angles and velocities of `x`; return whether
    they are finite, and every muscle has a range of pressures.

    The derivatives of a preview are linear in its samples; one that stands still has a single one.
    """
    n, slopes, b, y0 = JOINTS, i.slopes.reshape(2, x.shape[0], x.shape[0]), to.b, to.y0
    for k in range(rows):
        for j in range(n):
            x[k, j] = min(max(asked[k * n + j], inverse.left[j]), inverse.right[j])
    for k in range(rows):
        for j in range(n):
            omega = speeding = 0.0
            for l in range(rows if rows > 1 else 0):  # noqa: E741
                omega += slopes[0, l, k] * x[l, j]
                speeding += slopes[1, l, k] * x[l, j]
            x[k, n + j], to.alpha[j] = omega, speeding
        statics(x[k, :n], x[k, n : 2 * n], to.alpha, i.c, to.T, y0, to.M, to.F0, to.gain)
        for j in range(n):
            b[k, j] = to.T[j] - d[k * n + j] - y0[j]
        row = n
        for j in range(n):
            for l in range(j, n):  # noqa: E741
                entry = K[(k * n + j) * n + l]
                b[k, row] = (entry if j == l else 2**0.5 * entry) - y0[row]
                row += 1
        if not boxed(inverse, k, to):
            return False
    return finite(b[:rows])


@inlined_flat
def boxed(inverse: ArmInverse, k: int, to: ArmTargets) -> bool:
    """Fill in rows and limits of the pressures at the sample `k`, and return whether every muscle has a range."""
    for j in range(NU):
        gain, unit = to.gain[j], inverse.unit
        for row in range(TARGETS):
            to.A[k, row, j] = to.M[j * TARGETS + row] * unit
        to.hi[k, j] = inverse.most[j] / unit
        to.lo[k, j] = max(inverse.low, (inverse.min_force - to.F0[j]) / gain) / unit
        if not (gain > 0.0 and to.lo[k, j] <= to.hi[k, j]):
            return False
    return True


@inlined_flat
def turn_rows(turned: Array, rows: int, to: ArmTargets) -> None:
    """Fill in the first `rows` targets with the stiffness of a hand."""
    for k in range(rows):
        for row in range(TARGETS):
            one = row < JOINTS
            to.hand_b[k, row] = to.b[k, row] if one else 0.0
            for j in range(NU):
                to.hand_A[k, row, j] = to.A[k, row, j] if one else 0.0
            for l in range(0 if one else STIFFNESSES):  # noqa: E741
                factor = turned[k, row - JOINTS, l]
                to.hand_b[k, row] += factor * to.b[k, JOINTS + l]
                for j in range(NU):
                    to.hand_A[k, row, j] += factor * to.A[k, JOINTS + l, j]


@inlined_flat
def allocated(i: Inputs, rows: int, residual: Array) -> bool:
    """Allocate the pressures for the first `rows` targets, one or all, and return whether they are proved."""
    for place in range(TARGETS + NU):
        i.side[place] = 0  # no guess for the first target
    allocate_at(i.allocate, allocation_at(i.allocate_one if rows == 1 else i.allocate_all))
    prove_at(i.prove, proof_at(i.prove_one if rows == 1 else i.prove_all))
    sure = True
    for k in range(rows):
        sure = sure and i.rounds[k] > 0 and residual[k] <= SURE
    return sure


@inlined_flat
def follow(
    c: Array, inverse: ArmInverse, rows: int, asked: Array, K: Array, to: ArmTargets, found: Reference, moved: Array
) -> None:
    """Fill in pressures of `x`, stiffness of `y` and commands `u` from those of `rows` targets, and the distances
    moved.
    """
    n, x, y, u, alpha, A, b, P = JOINTS, found.x, found.y, found.u, inverse.alpha, to.A, to.b, to.P
    moved[0] = moved[1] = moved[2] = 0.0
    for k in range(x.shape[0]):
        q = min(k, rows - 1)
        for j in range(NU):
            x[k, 2 * n + j], y[k, STIFFNESSES + j] = inverse.unit * P[q, j], 0.0
        row = n
        for j in range(n):
            x[k, j], x[k, n + j] = x[q, j], x[q, n + j]
            moved[0] = max(moved[0], abs(asked[q * n + j] - x[k, j]))
            moved[2] = max(moved[2], abs(left_of(A[q, j], b[q, j], P[q])))
            for l in range(j, n):  # noqa: E741
                gap, factor = left_of(A[q, row], b[q, row], P[q]), 1.0 if j == l else 2**0.5
                y[k, row - n] = factor * K[(q * n + j) * n + l] - gap
                moved[1] = max(moved[1], abs(gap) / factor)
                row += 1
        expansion(x[k, :n], x[k, n : 2 * n], x[k, 2 * n :], c, to.fall[k % 2])
        if k > 0:
            for j in range(NU):
                now, before, fall = x[k, 2 * n + j], x[k - 1, 2 * n + j], (to.fall[0, j] + to.fall[1, j]) / 2
                u[k - 1, j] = (now - alpha[j] * before) / (1 - alpha[j]) + inverse.lags[j] * fall


@inlined_flat
def left_of(row: Array, b: float, x: Array) -> float:
    """Return b - row·x."""
    for j in range(NU):
        b -= row[j] * x[j]
    return b
