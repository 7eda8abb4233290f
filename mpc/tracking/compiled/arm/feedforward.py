"""Template of an arm's feed-forward: the targets of the allocation, and the commands from its result.

`mpc.tracking.compiled.arm.module` replaces the lines below that begin with `FORMULAS` by a function that fills flat
arrays, matrices by columns:

    statics          (q, ω, ω') ↦ M ω' + C + Dω + g, then at no pressure y' = (τ, svec K), its Jacobian by P, the forces
                     and their slopes by P

Pressures are in Pa. Of a preview that stands still there is one sample for all.
"""

from typing import Any

import numpy as np

from allocator.allocation.box.kernel.data import workspace
from allocator.calculus import Array
from allocator.joint.limits import BINDS
from mpc.codegen.jit import inlined
from mpc.tracking.compiled.arm.allocation import LEVELS, allocate_at, prove_at
from mpc.tracking.compiled.arm.records import ArmInverse
from mpc.tracking.compiled.arm.views import inverse_in
from mpc.tracking.compiled.commands import finite
from mpc.tracking.compiled.records import Reference
from mpc.tracking.compiled.sample.layout import Inputs
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, STIFFNESSES

FORMULAS: Any = None
statics = FORMULAS

ROWS = JOINTS + STIFFNESSES  # targets of a sample
SURE = 1e-9  # residual of optimality up to which an allocation is accepted


@inlined
def feed_forward(i: Inputs, asked: Array, K: Array, d: Array, found: Reference, moved: Array) -> bool:
    """Fill in the feed-forward of `mpc.tracking.feedforward.InverseDynamics`, and the distances `moved` (3,).

    Return whether the allocation is proved. `turned` of the inputs (N+1, e, e) turns svec K into a hand's.
    """
    inverse, samples = inverse_in(i.inverse), found.x.shape[0]
    rows = 1 if still(asked, K, d, samples) else samples
    A, b, lo, hi = np.empty((rows, ROWS, NU)), np.empty((rows, ROWS)), np.empty((rows, NU)), np.empty((rows, NU))
    if not targets(i, inverse, asked, K, d, found.x, A, b, lo, hi):
        return False
    P = np.empty((rows, NU))
    if i.turned.size == 0:
        sure = allocated(i, A, b, lo, hi, P)
    else:
        of_hand, aims = A.copy(), b.copy()
        turn_rows(i.turned.reshape(-1, STIFFNESSES, STIFFNESSES), A, b, of_hand, aims)
        sure = allocated(i, of_hand, aims, lo, hi, P)
    follow(inverse, asked, K, A, b, P, found, moved)
    return sure


@inlined
def still(asked: Array, K: Array, d: Array, samples: int) -> bool:
    """Return whether all samples of flat previews and torques are equal."""
    for array in (asked, K, d):
        size = array.size // samples
        for k in range(size, array.size):
            if array[k] != array[k % size]:
                return False
    return True


@inlined
def targets(
    i: Inputs, inverse: ArmInverse, asked: Array, K: Array, d: Array, x: Array, A: Array, b: Array, lo: Array, hi: Array
) -> bool:
    """Fill in the allocation's targets at every sample, and angles and velocities of `x`; return False if infeasible.

    The derivatives of a preview are linear in its samples; one that stands still has a single one.
    """
    samples, n, slopes = b.shape[0], JOINTS, i.slopes.reshape(2, x.shape[0], x.shape[0])
    alpha, T, y0, M, F0, gain = (
        np.empty(n),
        np.empty(n),
        np.empty(ROWS),
        np.empty(ROWS * NU),
        np.empty(NU),
        np.empty(NU),
    )
    for k in range(samples):
        for j in range(n):
            x[k, j] = min(max(asked[k * n + j], inverse.left[j]), inverse.right[j])
    for k in range(samples):
        for j in range(n):
            omega = speeding = 0.0
            for l in range(samples if samples > 1 else 0):  # noqa: E741
                omega += slopes[0, l, k] * x[l, j]
                speeding += slopes[1, l, k] * x[l, j]
            x[k, n + j], alpha[j] = omega, speeding
        statics(x[k, :n], x[k, n : 2 * n], alpha, i.c, T, y0, M, F0, gain)
        for j in range(n):
            b[k, j] = T[j] - d[k * n + j] - y0[j]
        row = n
        for j in range(n):
            for l in range(j, n):  # noqa: E741
                entry = K[(k * n + j) * n + l]
                b[k, row] = (entry if j == l else 2**0.5 * entry) - y0[row]
                row += 1
        for j in range(NU):
            for row in range(ROWS):
                A[k, row, j] = M[j * ROWS + row] * inverse.unit
            hi[k, j] = inverse.most[j] / inverse.unit
            lo[k, j] = max(inverse.low, (inverse.min_force - F0[j]) / gain[j]) / inverse.unit
            if not (gain[j] > 0.0 and lo[k, j] <= hi[k, j]):
                return False
    return finite(b)


@inlined
def turn_rows(turned: Array, A: Array, b: Array, of_hand: Array, aims: Array) -> None:
    """Set the rows of the stiffness to those of a hand's."""
    for k in range(b.shape[0]):
        for row in range(STIFFNESSES):
            aims[k, JOINTS + row] = 0.0
            for j in range(NU):
                of_hand[k, JOINTS + row, j] = 0.0
            for l in range(STIFFNESSES):  # noqa: E741
                factor = turned[k, row, l]
                aims[k, JOINTS + row] += factor * b[k, JOINTS + l]
                for j in range(NU):
                    of_hand[k, JOINTS + row, j] += factor * A[k, JOINTS + l, j]


@inlined
def allocated(i: Inputs, A: Array, b: Array, lo: Array, hi: Array, P: Array) -> bool:
    """Fill in the pressures `P` (rows, m), and return whether they are proved."""
    rows, work = P.shape[0], workspace(ROWS, NU, LEVELS)
    centre, which, residual = np.zeros((rows, NU)), np.empty(rows, np.int64), np.empty(rows)
    for k in range(rows):
        which[k] = k
    side, mu, rounds = (
        np.zeros((rows, NU + ROWS), np.int8),
        np.empty((rows, LEVELS + 1, ROWS)),
        np.zeros(rows, np.int64),
    )
    onesided, held, ends = np.zeros(ROWS, np.bool_), np.empty(ROWS + NU, np.bool_), np.array([JOINTS, ROWS])
    allocate_at(i.allocate, (A, b, onesided, ends, lo, hi, centre, which, True, P, side, mu, rounds, work))
    prove_at(i.prove, (A, b, onesided, ends, lo, hi, centre, which, P, mu, 0.0, BINDS, residual, held, work))
    sure = True
    for k in range(rows):
        sure = sure and rounds[k] > 0 and residual[k] <= SURE
    return sure


@inlined
def follow(
    inverse: ArmInverse, asked: Array, K: Array, A: Array, b: Array, P: Array, found: Reference, moved: Array
) -> None:
    """Fill in pressures of `x`, stiffness of `y` and commands `u` from `P` (rows, m), and the distances moved."""
    rows, n, x, y, u, alpha = P.shape[0], JOINTS, found.x, found.y, found.u, inverse.alpha
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
        if k > 0:
            for j in range(NU):
                now, before = x[k, 2 * n + j], x[k - 1, 2 * n + j]
                u[k - 1, j] = (now - alpha[j] * before) / (1 - alpha[j])


@inlined
def left_of(row: Array, b: float, x: Array) -> float:
    """Return b - row·x."""
    for j in range(NU):
        b -= row[j] * x[j]
    return b
