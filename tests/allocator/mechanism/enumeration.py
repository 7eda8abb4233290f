"""Problem [M] by enumeration: all 3^m ways to hold muscles at a bound, lexicographic least squares on each by SVD."""

from itertools import product

import numpy as np

_RANK = 1e-10


def best_of_all_faces(A, b, ends, lo, hi, centre, feasible=1e-9):
    """The lexicographically best x of every target: A (p, m) and the bounds (m,) are common, b is (N, p)."""
    N, m = len(b), len(lo)
    best, best_cost = np.full((N, m), np.nan), np.full((N, len(ends) + 1), np.inf)
    bounds = np.concatenate([[0], ends])
    near = 1e-11 * np.array([*(np.abs(b[:, i:j]).max() for i, j in zip(bounds, ends, strict=False)), 1.0])
    for sides in product((-1, 0, 1), repeat=m):
        free = np.array([s == 0 for s in sides])
        x = np.tile(np.where(np.array(sides) < 0, lo, hi), (N, 1))
        x[:, free] = 0.0
        particular, Z = np.zeros((N, free.sum())), np.eye(free.sum())
        rest = b - x @ A.T
        for i, j in zip(bounds, ends, strict=False):
            B = A[i:j, free] @ Z
            U, s, Vt = np.linalg.svd(B, full_matrices=True)
            rank = int((s > _RANK * max(np.abs(A).max(), 1e-300)).sum())
            left = rest[:, i:j] - particular @ A[i:j, free].T
            particular = particular + ((left @ U[:, :rank]) / s[:rank]) @ (Z @ Vt[:rank].T).T
            Z = Z @ Vt[rank:].T
        x[:, free] = particular + (centre[free] - particular) @ Z @ Z.T
        inside = ((x >= lo - feasible) & (x <= hi + feasible)).all(axis=1)
        r = x @ A.T - b
        misses = [r[:, i:j] for i, j in zip(bounds, ends, strict=False)]
        cost = np.stack([np.linalg.norm(miss, axis=1) for miss in (*misses, x - centre)], axis=1)
        better = inside & _lexicographically_less(cost, best_cost, near)
        best[better], best_cost[better] = x[better], cost[better]
    return best


def _lexicographically_less(one, two, near):
    with np.errstate(invalid="ignore"):
        decided = np.abs(one - two) > near
    first = np.where(decided.any(axis=1), decided.argmax(axis=1), one.shape[1] - 1)
    rows = np.arange(len(one))
    return one[rows, first] < two[rows, first]
