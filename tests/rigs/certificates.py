"""Certificates of optimality by multipliers from non-negative least squares, which are checked."""

import numpy as np
from scipy.optimize import nnls

from allocator.calculus import Array


def unexplained(x: Array, push: Array, lo: Array, hi: Array, A: Array, b: Array, near: float = 1e-7) -> float:
    """Return the least |push - Nᵀλ| over λ ≥ 0, N the normals of lo ≤ x ≤ hi and A x ≤ b that bind at `x` (n,).

    A feasible x minimises a convex cost if and only if minus its gradient, `push` (n,), is such a sum: then this is 0.
    """
    one = np.eye(len(x))
    normals = np.concatenate([-one[x - lo < near], one[hi - x < near], A[b - A @ x < near]])
    if not len(normals):
        return float(np.linalg.norm(push))
    _, left = nnls(normals.T, push)
    return float(left)
