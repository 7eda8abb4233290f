"""Template of an arm's feed-forward: the targets of the allocation, and the commands from its result.

`mpc.tracking.compiled.arm.module` replaces the lines below that begin with `FORMULAS` by the sizes and the formula of
the arm: n joints, m muscles, the number of entries of svec K, and a function that fills flat arrays, matrices by
columns:

    statics          (q, ω, ω') ↦ M ω' + C + Dω + g, then at no pressure y' = (τ, svec K), its Jacobian by P, the forces
                     and their slopes by P

The array c holds its numbers. Pressures are in Pa. Of a preview that stands still there is one sample for all.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.commands import finite

FORMULAS: Any = None
n = m = STIFFNESSES = statics = FORMULAS


@compiled
def still(asked: Array, K: Array, d: Array) -> bool:
    """Return whether all samples of a preview and its torques are equal."""
    for k in range(1, asked.shape[0]):
        for i in range(n):
            if asked[k, i] != asked[0, i] or d[k, i] != d[0, i]:
                return False
            for j in range(n):
                if K[k, i, j] != K[0, i, j]:
                    return False
    return True


@compiled
def targets(
    c: Array, slopes1: Array, slopes2: Array, limits: Array, supply: Array, asked: Array, K: Array, d: Array,
    x: Array, T: Array, A: Array, b: Array, lo: Array, hi: Array,
) -> bool:  # fmt: skip
    """Fill in the allocation's targets at every sample, and angles and velocities of `x`; return False if infeasible.

    `slopes1`, `slopes2` (N+1, N+1) are the derivatives of a preview; one of a single sample stands still.
    `limits` (2, n) [rad], `supply` (m + 3,): greatest pressures, the least one, the unit of A's columns, least force.
    """
    samples, d_y = asked.shape[0], n + STIFFNESSES
    alpha, y0, M, F0, gain = np.empty(n), np.empty(d_y), np.empty(d_y * m), np.empty(m), np.empty(m)
    low, unit, min_force = supply[m], supply[m + 1], supply[m + 2]
    for k in range(samples):
        for i in range(n):
            x[k, i] = min(max(asked[k, i], limits[0, i]), limits[1, i])
    for k in range(samples):
        for i in range(n):
            omega = speeding = 0.0
            for l in range(samples if samples > 1 else 0):  # noqa: E741
                omega += slopes1[k, l] * x[l, i]
                speeding += slopes2[k, l] * x[l, i]
            x[k, n + i], alpha[i] = omega, speeding
        statics(x[k, :n], x[k, n : 2 * n], alpha, c, T[k], y0, M, F0, gain)
        for i in range(n):
            T[k, i] -= d[k, i]
            b[k, i] = T[k, i] - y0[i]
        row = n
        for i in range(n):
            for j in range(i, n):
                b[k, row] = (K[k, i, j] if i == j else 2**0.5 * K[k, i, j]) - y0[row]
                row += 1
        for j in range(m):
            for i in range(d_y):
                A[k, i, j] = M[j * d_y + i] * unit
            hi[k, j] = supply[j] / unit
            lo[k, j] = max(low, (min_force - F0[j]) / gain[j]) / unit
            if not (gain[j] > 0.0 and lo[k, j] <= hi[k, j]):
                return False
    return finite(b)


@compiled
def follow(
    lags: Array, unit: float, asked: Array, A: Array, b: Array, found: Array, K: Array, x: Array, y: Array, u: Array
) -> tuple[float, float, float]:
    """Fill in pressures of `x`, stiffness of `y` and commands `u` from `found`; return the distances moved."""
    samples, off, missed, short = asked.shape[0], 0.0, 0.0, 0.0
    for k in range(x.shape[0]):
        q = min(k, samples - 1)
        for j in range(m):
            x[k, 2 * n + j] = unit * found[q, j]
        row = n
        for i in range(n):
            x[k, i], x[k, n + i] = x[q, i], x[q, n + i]
            off = max(off, abs(asked[q, i] - x[k, i]))
            short = max(short, abs(left_of(A[q, i], b[q, i], found[q])))
            for j in range(i, n):
                gap, factor = left_of(A[q, row], b[q, row], found[q]), 1.0 if i == j else 2**0.5
                y[k, row - n] = factor * K[q, i, j] - gap
                missed = max(missed, abs(gap) / factor)
                row += 1
        if k > 0:
            for j in range(m):
                now, before = x[k, 2 * n + j], x[k - 1, 2 * n + j]
                u[k - 1, j] = (now - lags[j] * before) / (1 - lags[j])
    return off, missed, short


@inlined
def left_of(row: Array, b: float, x: Array) -> float:
    """Return b - row·x."""
    for j in range(m):
        b -= row[j] * x[j]
    return b
