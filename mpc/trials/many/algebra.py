"""The algebra of the filter's corrections is that of small dense matrices."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined

SIZE = 5  # of ξ
PLACES = (0, 2, 3)  # of what is measured in ξ


@inlined
def propagated(A: Array, P: Array, Q: Array, out: Array) -> None:
    """Fill in A P Aᵀ + Q."""
    half = np.empty((SIZE, SIZE))
    for i in range(SIZE):
        for j in range(SIZE):
            total = 0.0
            for k in range(SIZE):
                total += A[i, k] * P[k, j]
            half[i, j] = total
    for i in range(SIZE):
        for j in range(SIZE):
            total = 0.0
            for k in range(SIZE):
                total += half[i, k] * A[j, k]
            out[i, j] = total + Q[i, j]


@inlined
def solved(S: Array, B: Array, m: int) -> None:
    """Put the solution of S X = B, m rows, in the place of B (3, 5); S (3, 3) is spent."""
    for j in range(m):
        pivot = j
        for i in range(j + 1, m):
            if abs(S[i, j]) > abs(S[pivot, j]):
                pivot = i
        if pivot != j:
            for k in range(m):
                S[j, k], S[pivot, k] = S[pivot, k], S[j, k]
            for k in range(SIZE):
                B[j, k], B[pivot, k] = B[pivot, k], B[j, k]
        for i in range(j + 1, m):
            factor = S[i, j] / S[j, j]
            for k in range(j + 1, m):
                S[i, k] -= factor * S[j, k]
            for k in range(SIZE):
                B[i, k] -= factor * B[j, k]
    for j in range(m - 1, -1, -1):
        for k in range(SIZE):
            total = B[j, k]
            for i in range(j + 1, m):
                total -= S[j, i] * B[i, k]
            B[j, k] = total / S[j, j]


@inlined
def corrected(xi: Array, P: Array, read: Array, there: Any, variances: Array) -> bool:
    """Correct ξ (5,) and its covariance `P` (5, 5) by the readings `there`; return whether both are sound."""
    m, own = 0, np.empty(3, np.int64)
    for s in range(3):
        if there[s]:
            own[m] = s
            m += 1
    S, G, left, R = np.empty((3, 3)), np.empty((3, SIZE)), np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    for a in range(m):
        for b in range(m):
            S[a, b] = P[PLACES[own[a]], PLACES[own[b]]] + (variances[own[a]] if a == b else 0.0)
        for k in range(SIZE):
            G[a, k] = P[PLACES[own[a]], k]
    solved(S, G, m)
    for i in range(SIZE):
        left[i, i] = 1.0
        for a in range(m):
            left[i, PLACES[own[a]]] -= G[a, i]
        for j in range(SIZE):
            for a in range(m):
                R[i, j] += G[a, i] * variances[own[a]] * G[a, j]
    gap = np.empty(3)
    for a in range(m):
        gap[a] = read[own[a]] - xi[PLACES[own[a]]]
    for i in range(SIZE):
        for a in range(m):
            xi[i] += G[a, i] * gap[a]
    old = P.copy()
    propagated(left, old, R, P)
    return sound(xi, P)


@inlined
def sound(xi: Array, P: Array) -> bool:
    """Return whether all is finite, and no variance negative."""
    for i in range(SIZE):
        if not (np.isfinite(xi[i]) and P[i, i] > 0):
            return False
        for j in range(SIZE):
            if not np.isfinite(P[i, j]):
                return False
    return True


__all__ = ["PLACES", "SIZE", "corrected", "propagated", "sound"]
