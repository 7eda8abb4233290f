"""Condensing takes O(N²): the Hessian's columns by adjoints, as `mpc.tracking.qp.condense` states it.

Decisions are the changes of the commands at the samples `starts`, each of which moves all commands from there on.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined
from mpc.tracking.compiled.records import Bounds, Cost, Errors, Path


@inlined
def condensed(path: Path, errors: Errors, cost: Cost, starts: Any) -> tuple[Array, Array]:
    """Return H (n, n) and f (n,) of the cost ½ zᵀH z + fᵀz; z: changes of the commands at `starts` [bar]."""
    columns = acting(starts, path.A.shape[0])
    G = unroll(path, columns, 2 * starts.size)
    return hessian(path, G, cost, starts, columns), gradient(path, errors, cost, starts)


@inlined
def acting(starts: Any, N: int) -> Any:
    """Return how many decisions move the commands u_k, k = 0 … N-1."""
    columns = np.zeros(N, np.int64)
    moving = 0
    for k in range(N):
        if 2 * starts.size > moving and starts[moving // 2] == k:
            moving += 2
        columns[k] = moving
    return columns


@inlined
def unroll(path: Path, columns: Any, n: int) -> Array:
    """Return G (N+1, 4, n) = ∂x/∂z, the linear model unrolled; only the columns that have begun to move are filled."""
    N = columns.size
    G = np.zeros((N + 1, 4, n))
    for k in range(N):
        A, B, now, after = path.A[k], path.B[k], G[k], G[k + 1]
        for i in range(4):
            for j in range(columns[k]):  # columns of G that do not move yet are 0
                after[i, j] = A[i, 0] * now[0, j] + A[i, 1] * now[1, j] + A[i, 2] * now[2, j] + A[i, 3] * now[3, j]
            for j in range(0, columns[k], 2):
                after[i, j] += B[i, 0]
                after[i, j + 1] += B[i, 1]
    return G


@inlined
def hessian(path: Path, G: Array, cost: Cost, starts: Any, columns: Any) -> Array:
    """Return H by adjoints, W_k = ∂²(cost from k on)/∂x_k∂z, and a change counts in all commands from its own on."""
    N, n = columns.size, G.shape[2]
    H, row, W = np.empty((n, n)), np.empty((2, n)), np.empty((4, n))
    for j in range(n):
        for i in range(6):
            end = cost.end[i, 4 + j % 2]
            for m in range(4):
                end += cost.end[i, m] * G[N, m, j]
            if i < 4:
                W[i, j] = end
            else:
                row[i - 4, j] = end
    block = starts.size - 1
    for k in range(N - 1, -1, -1):
        B = path.B[k]
        for i in range(2):
            for j in range(columns[k]):
                row[i, j] += B[0, i] * W[0, j] + B[1, i] * W[1, j] + B[2, i] * W[2, j] + B[3, i] * W[3, j]
            for j in range(i, columns[k], 2):
                row[i, j] += cost.e[i]
        if starts[block] == k:
            for i in range(2):
                at = 2 * block + i
                for j in range(columns[k]):
                    H[at, j], H[j, at] = row[i, j], row[i, j]
            H[2 * block, 2 * block] += cost.change[0]
            H[2 * block + 1, 2 * block + 1] += cost.change[1]
            block -= 1
        if k > 0:
            earlier(W, path.A[k], path.slope[k], G[k], cost, columns[k - 1])
    return H


@inlined
def earlier(W: Array, A: Array, slope: Array, g: Array, cost: Cost, columns: int) -> None:
    """Go from W_{k+1} to W_k = Q_k G_k + A_kᵀ W_{k+1}, Q_k the cost of the state's errors."""
    q0, q1, q2, q3 = cost.x[0], cost.x[1], cost.x[2], cost.x[3]
    for j in range(columns):
        w0, w1, w2, w3 = W[0, j], W[1, j], W[2, j], W[3, j]
        W[0, j] = A[0, 0] * w0 + A[1, 0] * w1 + A[2, 0] * w2 + A[3, 0] * w3 + q0 * g[0, j]
        W[1, j] = A[0, 1] * w0 + A[1, 1] * w1 + A[2, 1] * w2 + A[3, 1] * w3 + q1 * g[1, j]
        W[2, j] = A[0, 2] * w0 + A[1, 2] * w1 + A[2, 2] * w2 + A[3, 2] * w3 + q2 * g[2, j]
        W[3, j] = A[0, 3] * w0 + A[1, 3] * w1 + A[2, 3] * w2 + A[3, 3] * w3 + q3 * g[3, j]
    for m in range(3):
        C, w = slope[m], cost.y[m]
        if w == 0.0:
            continue
        for j in range(columns):
            y = w * (C[0] * g[0, j] + C[1] * g[1, j] + C[2] * g[2, j] + C[3] * g[3, j])
            for i in range(4):
                W[i, j] += y * C[i]


@inlined
def gradient(path: Path, errors: Errors, cost: Cost, starts: Any) -> Array:
    """Return f by the adjoint p_k = ∂(cost from k on)/∂x_k."""
    N = path.A.shape[0]
    f, push = np.empty(2 * starts.size), np.zeros(2)
    p = np.zeros(4)
    for j in range(6):
        for i in range(4):
            p[i] += cost.end[i, j] * errors.end[j]
        for i in range(2):
            push[i] += cost.end[4 + i, j] * errors.end[j]
    block = starts.size - 1
    for k in range(N - 1, -1, -1):
        A, B = path.A[k], path.B[k]
        for i in range(2):
            push[i] += B[0, i] * p[0] + B[1, i] * p[1] + B[2, i] * p[2] + B[3, i] * p[3] + cost.e[i] * errors.e[k, i]
        if starts[block] == k:
            for i in range(2):
                f[2 * block + i] = push[i] + cost.change[i] * errors.change[k, i]
            block -= 1
        p0, p1, p2, p3 = p[0], p[1], p[2], p[3]
        y, C = errors.y[k], path.slope[k]
        K, F1, F2 = cost.y[0] * y[0], cost.y[1] * y[1], cost.y[2] * y[2]
        for i in range(4):
            p[i] = A[0, i] * p0 + A[1, i] * p1 + A[2, i] * p2 + A[3, i] * p3 + cost.x[i] * errors.x[k, i]
            p[i] += K * C[0, i] + F1 * C[1, i] + F2 * C[2, i]
    return f


@inlined
def rows_of(path: Path, u: Array, bounds: Bounds, starts: Any) -> tuple[Array, Array, Array]:
    """Return R (6N, n + 2), lower and upper (6N,), the rows of `mpc.tracking.qp.condense` for (z, s, s_F)."""
    N = u.shape[0]
    columns, n = acting(starts, N), 2 * starts.size
    G = unroll(path, columns, n)
    R, lower, upper = np.zeros((6 * N, n + 2)), np.full(6 * N, -np.inf), np.full(6 * N, np.inf)
    for k in range(N):
        command, right, left, force = 2 * k, 2 * N + k, 3 * N + k, 4 * N + 2 * k
        upper[right] = bounds.right - path.x[k + 1, 0]
        lower[left] = bounds.left - path.x[k + 1, 0]
        R[right, n] = -1.0
        R[left, n] = 1.0
        for i in range(2):
            lower[command + i] = min(bounds.low - u[k, i], 0.0)
            upper[command + i] = max(bounds.high - u[k, i], 0.0)
            lower[force + i] = bounds.min_force - path.y[k + 1, 1 + i]
            R[force + i, n + 1] = 1.0
        for j in range(columns[k]):
            g0, g1, g2, g3 = G[k + 1, 0, j], G[k + 1, 1, j], G[k + 1, 2, j], G[k + 1, 3, j]
            R[right, j] = g0
            R[left, j] = g0
            R[command + j % 2, j] = 1.0
            for i in range(2):
                D = path.slope[k + 1, 1 + i]
                R[force + i, j] = D[0] * g0 + D[1] * g1 + D[2] * g2 + D[3] * g3
    return R, lower, upper


__all__ = ["condensed", "gradient", "rows_of"]
