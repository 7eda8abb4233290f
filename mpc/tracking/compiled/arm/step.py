"""Template of an arm's step: linearisation and the rollout of an answer; `solve` has the QP between them.

`mpc.tracking.compiled.arm.module` replaces the lines below that begin with `FORMULAS` by the sizes of the arm and the
arm's formulas: n joints, m muscles, and functions that fill flat arrays, matrices by columns:

    dynamics         (q, ω, P, d) ↦ M, τ - C - Dω - g + d
    dynamics_slopes  (q, ω, P, ω') ↦ the Jacobian of the latter minus M ω', by q, ω and P
    output_slopes    (q, P) ↦ y = (svec K, F), its Jacobian by q and P

`EXTERNAL` is the number of external torques by which S has slopes, n or 0. The array c holds the formulas' numbers.
Pressures are in Pa, decisions z in bar, as in `mpc.tracking.qp.condense`. The motion is that of `mpc.model.arm.model`;
its derivative is ∂ω' = M⁻¹ ∂(τ - C - Dω - g + d - M ω') at fixed ω'. A path is a motion and its derivatives:
x (N+1, 2n + m), S (N, 2n, COLUMNS) the Jacobian of the next (q, ω) by (q, ω), P, u and d, y (N+1, p) and slope
(N+1, n + m, p) of y by (q, P). The response of pressures to commands is always the same.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.model.integration import NODES, SHARES
from mpc.tracking.compiled.commands import finite, limit
from mpc.tracking.compiled.records import Indices
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, NX

FORMULAS: Any = None
dynamics = dynamics_slopes = output_slopes = EXTERNAL = COLUMNS = FORMULAS

n, m = JOINTS, NU
PLACES = 0, 1, 1, 2  # of the stages in `decay`


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
def advance(c: Array, h: float, decay: Array, x: Array, u: Array, d: Array, after: Array, S: Array | None) -> None:
    """Fill in the next state and the Jacobian `S` (2n, COLUMNS) of its (q, ω), if there is one."""
    s, K, total, now = np.empty(2 * n), np.empty(2 * n), np.empty(2 * n), np.empty(2 * n)
    P, M, a = np.empty(m), np.empty(n * n), np.empty(n)
    if S is not None:  # numba removes this branch for None
        SK, St = np.zeros((2 * n, COLUMNS)), np.empty((2 * n, COLUMNS))
        here, R = np.empty((2 * n, COLUMNS)), np.empty((NX + EXTERNAL, n))
        for i in range(2 * n):
            for j in range(COLUMNS):
                S[i, j] = 1.0 if i == j else 0.0
    for i in range(2 * n):
        s[i] = x[i]
    for step in range(decay.shape[0]):
        for i in range(2 * n):
            total[i], K[i] = 0.0, 0.0
        if S is not None:
            St[:] = 0.0
        for stage in range(4):
            reach, share, left = h * NODES[stage], h * SHARES[stage], decay[step, PLACES[stage]]
            for i in range(2 * n):
                now[i] = s[i] + reach * K[i]
            for j in range(m):
                P[j] = u[j] + left[j] * (x[2 * n + j] - u[j])
            accelerate(c, now, P, d, M, a)
            for i in range(n):
                K[i], K[n + i] = now[n + i], a[i]
            for i in range(2 * n):
                total[i] += share * K[i]
            if S is not None:
                vary(c, reach, share, left, now, P, M, a, R, S, here, SK, St)
        for i in range(2 * n):
            s[i] += total[i]
        if S is not None:
            for i in range(2 * n):
                for j in range(COLUMNS):
                    S[i, j] += St[i, j]
    for i in range(2 * n):
        after[i] = s[i]
    for j in range(m):
        after[2 * n + j] = u[j] + decay[decay.shape[0] - 1, 2, j] * (x[2 * n + j] - u[j])


@inlined
def vary(
    c: Array, reach: float, share: float, left: Array, now: Array, P: Array, M: Array, a: Array, R: Array,
    S: Array, here: Array, SK: Array, St: Array,
) -> None:  # fmt: skip
    """Advance the variational equations by a stage: SK is the slope of the Jacobian `here`, St their sum."""
    dynamics_slopes(now[:n], now[n:], P, a, c, R.reshape(-1))
    for j in range(EXTERNAL):
        for i in range(n):
            R[NX + j, i] = 1.0 if i == j else 0.0
    for j in range(NX + EXTERNAL):
        solve(M, R[j])
    for i in range(2 * n):
        for j in range(COLUMNS):
            here[i, j] = S[i, j] + reach * SK[i, j]
    for i in range(n):
        for j in range(COLUMNS):
            SK[i, j], SK[n + i, j] = here[n + i, j], 0.0
        for l in range(2 * n):  # noqa: E741
            factor = R[l, i]
            for j in range(COLUMNS):
                SK[n + i, j] += factor * here[l, j]
        for j in range(m):
            SK[n + i, 2 * n + j] += R[2 * n + j, i] * left[j]
            SK[n + i, 2 * n + m + j] += R[2 * n + j, i] * (1 - left[j])
        for j in range(EXTERNAL):
            SK[n + i, 2 * n + 2 * m + j] += R[NX + j, i]
    for i in range(2 * n):
        for j in range(COLUMNS):
            St[i, j] += share * SK[i, j]


@inlined
def accelerate(c: Array, s: Array, P: Array, d: Array, M: Array, a: Array) -> None:
    """Fill in the acceleration `a` (n,) and the Cholesky factor of the mass matrix, flat in `M`."""
    dynamics(s[:n], s[n:], P, d, c, M, a)
    for j in range(n):
        for i in range(j, n):
            value = M[j * n + i]
            for l in range(j):  # noqa: E741
                value -= M[l * n + i] * M[l * n + j]
            M[j * n + i] = np.sqrt(value) if i == j else value / M[j * n + j]
    solve(M, a)


@inlined
def solve(M: Array, v: Array) -> None:
    """Replace v (n,) by M⁻¹ v, with the factor in `M`."""
    for i in range(n):
        for l in range(i):  # noqa: E741
            v[i] -= M[l * n + i] * v[l]
        v[i] /= M[i * n + i]
    for i in range(n - 1, -1, -1):
        for l in range(i + 1, n):  # noqa: E741
            v[i] -= M[i * n + l] * v[l]
        v[i] /= M[i * n + i]


@inlined
def roll(c: Array, h: float, decay: Array, x0: Array, u: Array, d: Array, x: Array, y: Array) -> None:
    """Fill in the motion from `x0` under `u` without derivatives."""
    for i in range(NX):
        x[0, i] = x0[i]
    for k in range(u.shape[0]):
        advance(c, h, decay, x[k], u[k], d[k], x[k + 1], None)
    slope = np.empty((n + m) * y.shape[1])  # unused, but avoids the compilation of a second formula
    for k in range(x.shape[0]):
        output_slopes(x[k, :n], x[k, 2 * n :], c, y[k], slope)


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
