"""Template of an arm's motion over a sample.

`mpc.model.arm.compiled.module` replaces the lines below that begin with `FORMULAS` by the sizes of the arm and the
arm's formulas: n joints, m muscles, and functions that fill flat arrays, matrices by columns:

    dynamics         (q, ω, P, d) ↦ M, τ - C - Dω - g + d
    dynamics_slopes  (q, ω, P, ω') ↦ the Jacobian of the latter minus M ω', by q, ω and P
    pressures        (q, ω, P, u) ↦ P'
    pressure_slopes  (q, ω, P) ↦ the Jacobian of the latter by q, ω and P, and ∂P_j'/∂u_j

The first `MOVING` entries of the state are integrated: all of them with gas, and (q, ω) without it, whose pressures are
known at all times. `EXTERNAL` is the number of external torques by which S has slopes, n or 0. The array c holds the
formulas' numbers. The motion is that of `mpc.model.arm.model`; its derivative is ∂ω' = M⁻¹ ∂(τ - C - Dω - g + d - M ω')
at fixed ω'. S (MOVING, COLUMNS) is the Jacobian of the next integrated states by (q, ω), P, u and d.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.model.experiment import NODES, SHARES

FORMULAS: Any = None
n = m = dynamics = dynamics_slopes = pressures = pressure_slopes = MOVING = EXTERNAL = COLUMNS = FORMULAS

PLACES = 0, 1, 1, 2  # of the stages in `decay`


@inlined
def advance(c: Array, h: float, decay: Array, x: Array, u: Array, d: Array, after: Array, S: Array | None) -> None:
    """Fill in the next state and the Jacobian `S` (MOVING, COLUMNS) of its first entries, if there is one."""
    s, K, total, now = np.empty(MOVING), np.empty(MOVING), np.empty(MOVING), np.empty(MOVING)
    P, M, a = np.empty(m), np.empty(n * n), np.empty(n)
    if S is not None:  # numba removes this branch for None
        SK, St = np.zeros((MOVING, COLUMNS)), np.empty((MOVING, COLUMNS))
        here, R = np.empty((MOVING, COLUMNS)), np.empty((2 * n + m + EXTERNAL, n))
        for i in range(MOVING):
            for j in range(COLUMNS):
                S[i, j] = 1.0 if i == j else 0.0
    for i in range(MOVING):
        s[i] = x[i]
    for step in range(decay.shape[0]):
        for i in range(MOVING):
            total[i], K[i] = 0.0, 0.0
        if S is not None:
            St[:] = 0.0
        for stage in range(4):
            reach, share, left = h * NODES[stage], h * SHARES[stage], decay[step, PLACES[stage]]
            for i in range(MOVING):
                now[i] = s[i] + reach * K[i]
            for j in range(m):
                P[j] = now[2 * n + j] if MOVING > 2 * n else u[j] + left[j] * (x[2 * n + j] - u[j])
            accelerate(c, now, P, d, M, a)
            for i in range(n):
                K[i], K[n + i] = now[n + i], a[i]
            if MOVING > 2 * n:
                pressures(now[:n], now[n : 2 * n], P, u, c, K[2 * n :])
            for i in range(MOVING):
                total[i] += share * K[i]
            if S is not None:
                vary(c, reach, share, left, now, P, M, a, R, S, here, SK, St)
        for i in range(MOVING):
            s[i] += total[i]
        if S is not None:
            for i in range(MOVING):
                for j in range(COLUMNS):
                    S[i, j] += St[i, j]
    for j in range(m):
        after[2 * n + j] = u[j] + decay[decay.shape[0] - 1, 2, j] * (x[2 * n + j] - u[j])
    for i in range(MOVING):
        after[i] = s[i]


@inlined
def vary(
    c: Array, reach: float, share: float, left: Array, now: Array, P: Array, M: Array, a: Array, R: Array,
    S: Array, here: Array, SK: Array, St: Array,
) -> None:  # fmt: skip
    """Advance the variational equations by a stage: SK is the slope of the Jacobian `here`, St their sum."""
    dynamics_slopes(now[:n], now[n : 2 * n], P, a, c, R.reshape(-1))
    for j in range(EXTERNAL):
        for i in range(n):
            R[2 * n + m + j, i] = 1.0 if i == j else 0.0
    for j in range(2 * n + m + EXTERNAL):
        solve(M, R[j])
    for i in range(MOVING):
        for j in range(COLUMNS):
            here[i, j] = S[i, j] + reach * SK[i, j]
    for i in range(n):
        for j in range(COLUMNS):
            SK[i, j], SK[n + i, j] = here[n + i, j], 0.0
        add_product(R, here, i, SK[n + i])
        for j in range(2 * n + m - MOVING):
            SK[n + i, 2 * n + j] += R[2 * n + j, i] * left[j]
            SK[n + i, 2 * n + m + j] += R[2 * n + j, i] * (1 - left[j])
        for j in range(EXTERNAL):
            SK[n + i, 2 * n + 2 * m + j] += R[2 * n + m + j, i]
    if MOVING > 2 * n:
        vary_pressures(c, now, P, here, SK)
    for i in range(MOVING):
        for j in range(COLUMNS):
            St[i, j] += share * SK[i, j]


@inlined
def vary_pressures(c: Array, now: Array, P: Array, here: Array, SK: Array) -> None:
    """Fill in the last lines of SK, the slope of the Jacobian `here`."""
    G, by_command = np.empty((2 * n + m, m)), np.empty(m)
    pressure_slopes(now[:n], now[n : 2 * n], P, c, G.reshape(-1), by_command)
    for i in range(m):
        for j in range(COLUMNS):
            SK[2 * n + i, j] = 0.0
        add_product(G, here, i, SK[2 * n + i])
        SK[2 * n + i, 2 * n + m + i] += by_command[i]


@inlined
def add_product(G: Array, here: Array, i: int, line: Array) -> None:
    """Add G[:MOVING, i] here to the `line` (COLUMNS,)."""
    for l in range(MOVING):  # noqa: E741
        factor = G[l, i]
        for j in range(COLUMNS):
            line[j] += factor * here[l, j]


@inlined
def accelerate(c: Array, s: Array, P: Array, d: Array, M: Array, a: Array) -> None:
    """Fill in the acceleration `a` (n,) and, flat in `M`, the mass matrix's Cholesky factor with inverted diagonal."""
    dynamics(s[:n], s[n : 2 * n], P, d, c, M, a)
    for j in range(n):
        for i in range(j, n):
            value = M[j * n + i]
            for l in range(j):  # noqa: E741
                value -= M[l * n + i] * M[l * n + j]
            M[j * n + i] = 1 / np.sqrt(value) if i == j else value * M[j * n + j]
    solve(M, a)


@inlined
def solve(M: Array, v: Array) -> None:
    """Replace v (n,) by M⁻¹ v, with the factor in `M`."""
    for i in range(n):
        for l in range(i):  # noqa: E741
            v[i] -= M[l * n + i] * v[l]
        v[i] *= M[i * n + i]
    for i in range(n - 1, -1, -1):
        for l in range(i + 1, n):  # noqa: E741
            v[i] -= M[i * n + l] * v[l]
        v[i] *= M[i * n + i]
