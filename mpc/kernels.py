"""Compiled loops over the horizon: what `mpc.linearise` and `mpc.condense` do, in microseconds.

Importing this file imports numba: `mpc.compiled` does it when it is wanted. Commands count in bar here, as the decisions
do; B is per bar. The joint's law comes in as functions of scalars that return tuples (`mpc.translate`), with their
numbers c. Everything is O(N²): the condensed Hessian is made from its columns' adjoints.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numba import njit

from allocator.calculus import Array

F = TypeVar("F", bound=Callable[..., Any])
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}


def compiled(function: F) -> F:
    """Compile `function` when it is first called, and keep the result on disk."""
    return njit(cache=True, **_OPTIONS)(function)  # type: ignore[no-any-return]  # numba has no types


def inlined(function: F) -> F:
    """Compile `function` as a part of those that call it."""
    return njit(**_OPTIONS)(function)  # type: ignore[no-any-return]  # numba has no types


class Path(NamedTuple):
    """A motion and the linear model about it."""

    x: Array  # (N+1, 4)
    K: Array  # (N+1,)
    A: Array  # (N, 4, 4)
    B: Array  # (N, 4, 2) per bar
    C: Array  # (N+1, 4) gradient of K


class Cost(NamedTuple):
    """The weights, commands in bar."""

    theta: float
    omega: float
    K: float
    u: float  # [cost]/[bar]²
    change: float  # of e_k - e_{k-1} [cost]/[bar]²
    end: Array  # (6, 6) of ξ = (x_N - x*_N, e_{N-1})


class Errors(NamedTuple):
    """What the cost charges for, along a path: all deviations from the reference."""

    theta: Array  # (N+1,)
    omega: Array  # (N+1,)
    K: Array  # (N+1,)
    e: Array  # (N, 2) commands [bar]
    change: Array  # (N, 2) e_k - e_{k-1} [bar]
    end: Array  # (6,) ξ


# --- along the horizon ------------------------------------------------------------------------------------------------


@inlined
def motion(advance: Any, c: Array, x0: Array, u: Array, d: Array, substeps: int) -> Array:
    """The states (N+1, 4). `advance`: (x, u, d) ↦ x after a substep."""
    N = u.shape[0]
    x = np.empty((N + 1, 4))
    x[0] = x0
    for k in range(N):
        now = x[k + 1]
        now[:] = x[k]
        for _ in range(substeps):
            now[0], now[1], now[2], now[3] = advance(now[0], now[1], now[2], now[3], u[k, 0], u[k, 1], d[k], c)
    return x


@inlined
def slopes(stage: Any, c: Array, x0: Array, u: Array, d: Array, substeps: int) -> tuple[Array, Array, Array]:
    """x (N+1, 4), A (N, 4, 4), B (N, 4, 2). `stage`: (x, u, d) ↦ (x after a substep, its Jacobian by (x, u)' columns)."""
    N = u.shape[0]
    x, A, B = np.empty((N + 1, 4)), np.empty((N, 4, 4)), np.empty((N, 4, 2))
    S = np.empty((4, 6))  # [A B] up to the present substep
    x[0] = x0
    for k in range(N):
        now = x[k + 1]
        now[:] = x[k]
        S[:] = np.eye(4, 6)
        for _ in range(substeps):
            o = stage(now[0], now[1], now[2], now[3], u[k, 0], u[k, 1], d[k], c)
            now[0], now[1], now[2], now[3] = o[0], o[1], o[2], o[3]
            for j in range(6):
                s0, s1, s2, s3 = S[0, j], S[1, j], S[2, j], S[3, j]
                for i in range(4):
                    S[i, j] = o[4 + i] * s0 + o[8 + i] * s1 + o[12 + i] * s2 + o[16 + i] * s3
            for i in range(4):
                S[i, 4] += o[20 + i]
                S[i, 5] += o[24 + i]
        A[k], B[k] = S[:, :4], S[:, 4:]
    return x, A, B


@inlined
def read(outputs: Any, c: Array, x: Array) -> tuple[Array, Array]:
    """Outputs y (N+1, 3) = (K, F1, F2) and their gradients (N+1, 3, 4). `outputs`: x ↦ (y, ∂y/∂x by columns)."""
    y, slope = np.empty((x.shape[0], 3)), np.empty((x.shape[0], 3, 4))
    for k in range(x.shape[0]):
        o = outputs(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c)
        for i in range(3):
            y[k, i] = o[i]
            for j in range(4):
                slope[k, i, j] = o[3 + 3 * j + i]
    return y, slope


# --- condensing -------------------------------------------------------------------------------------------------------


@compiled
def condensed(path: Path, errors: Errors, cost: Cost, starts: Array) -> tuple[Array, Array]:
    """H (n, n) and f (n,) of the cost ½ zᵀH z + fᵀz; z: changes of the commands, at the samples `starts` only, in bar."""
    columns = moved_columns(starts, path.A.shape[0])
    G = unrolled(path, columns, 2 * starts.size)
    return hessian(path, G, cost, starts, columns), gradient(path, errors, cost, starts)


@inlined
def moved_columns(starts: Array, N: int) -> Array:
    """How many decisions move the commands u_k, k = 0 … N-1."""
    columns = np.zeros(N, np.int64)
    for start in starts:
        columns[start:] += 2
    return columns


@inlined
def unrolled(path: Path, columns: Array, n: int) -> Array:
    """G (N+1, 4, n) = ∂x/∂z: the linear model unrolled; only the columns that have begun to move are filled."""
    N = columns.size
    G = np.zeros((N + 1, 4, n))
    for k in range(N):
        A, B, now, after = path.A[k], path.B[k], G[k], G[k + 1]
        for i in range(4):
            for j in range(columns[k]):  # before they move, columns of G are 0
                after[i, j] = A[i, 0] * now[0, j] + A[i, 1] * now[1, j] + A[i, 2] * now[2, j] + A[i, 3] * now[3, j]
            for j in range(0, columns[k], 2):
                after[i, j] += B[i, 0]
                after[i, j + 1] += B[i, 1]
    return G


@inlined
def hessian(path: Path, G: Array, cost: Cost, starts: Array, columns: Array) -> Array:
    """H by adjoints: W_k = ∂²(cost from k on)/∂x_k∂z, and a change counts in all commands from its own on."""
    N, n = columns.size, G.shape[2]
    H, W, row = np.empty((n, n)), np.zeros((4, n)), np.zeros((2, n))
    P = cost.end
    for i in range(4):
        for j in range(n):
            W[i, j] = P[i, 4 + j % 2] + P[i, 0] * G[N, 0, j] + P[i, 1] * G[N, 1, j] + P[i, 2] * G[N, 2, j] + P[i, 3] * G[N, 3, j]
    for i in range(2):
        for j in range(n):
            row[i, j] = P[4 + i, 4 + j % 2]
            for m in range(4):
                row[i, j] += P[4 + i, m] * G[N, m, j]
    block = starts.size - 1
    for k in range(N - 1, -1, -1):
        A, B, g, C = path.A[k], path.B[k], G[k], path.C[k]
        for i in range(2):
            for j in range(columns[k]):
                row[i, j] += B[0, i] * W[0, j] + B[1, i] * W[1, j] + B[2, i] * W[2, j] + B[3, i] * W[3, j]
            for j in range(i, columns[k], 2):
                row[i, j] += cost.u
        if starts[block] == k:
            for i in range(2):
                at = 2 * block + i
                for j in range(columns[k]):
                    H[at, j] = row[i, j]
                    H[j, at] = row[i, j]
            H[2 * block, 2 * block] += cost.change
            H[2 * block + 1, 2 * block + 1] += cost.change
            block -= 1
        if k > 0:
            for j in range(columns[k - 1]):
                w0, w1, w2, w3 = W[0, j], W[1, j], W[2, j], W[3, j]
                K = cost.K * (C[0] * g[0, j] + C[1] * g[1, j] + C[2] * g[2, j] + C[3] * g[3, j])
                W[0, j] = A[0, 0] * w0 + A[1, 0] * w1 + A[2, 0] * w2 + A[3, 0] * w3 + cost.theta * g[0, j] + K * C[0]
                W[1, j] = A[0, 1] * w0 + A[1, 1] * w1 + A[2, 1] * w2 + A[3, 1] * w3 + cost.omega * g[1, j] + K * C[1]
                W[2, j] = A[0, 2] * w0 + A[1, 2] * w1 + A[2, 2] * w2 + A[3, 2] * w3 + K * C[2]
                W[3, j] = A[0, 3] * w0 + A[1, 3] * w1 + A[2, 3] * w2 + A[3, 3] * w3 + K * C[3]
    return H


@inlined
def gradient(path: Path, errors: Errors, cost: Cost, starts: Array) -> Array:
    """f by the adjoint p_k = ∂(cost from k on)/∂x_k."""
    N = path.A.shape[0]
    f, push = np.empty(2 * starts.size), np.zeros(2)
    ends = cost.end @ errors.end
    p = ends[:4].copy()
    push[:] = ends[4:]
    block = starts.size - 1
    for k in range(N - 1, -1, -1):
        A, B, C = path.A[k], path.B[k], path.C[k]
        for i in range(2):
            push[i] += B[0, i] * p[0] + B[1, i] * p[1] + B[2, i] * p[2] + B[3, i] * p[3] + cost.u * errors.e[k, i]
        if starts[block] == k:
            for i in range(2):
                f[2 * block + i] = push[i] + cost.change * errors.change[k, i]
            block -= 1
        p0, p1, p2, p3 = p
        K = cost.K * errors.K[k]
        for i in range(4):
            p[i] = A[0, i] * p0 + A[1, i] * p1 + A[2, i] * p2 + A[3, i] * p3 + K * C[i]
        p[0] += cost.theta * errors.theta[k]
        p[1] += cost.omega * errors.omega[k]
    return f


__all__ = ["Cost", "Errors", "Path", "compiled", "condensed", "inlined", "motion", "read", "slopes"]
