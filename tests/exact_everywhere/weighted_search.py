"""Least weighted cost of infeasible targets, on the edges of the box and on the folds of its image.

Inside the box a least cost that is not zero has JᵀWr = 0 with r ≠ 0, so that det J = 0: both curves have the same slope
dk/dt. All such pairs of pressures are sampled, over P1 and over P2; in the narrow cell around a kink the slope takes
all values between, which gives the line at the kink. A grid over the box guards against omissions.
"""

import numpy as np

from .curves import runs
from .line_search import change, golden_section, pick

_COARSE = 8  # every so many samples are in the grid


def on_paths(joint, reach, targets, weights, P1, P2):
    """Return the best pressures, compared with the given ones (m,)."""
    everyone = np.arange(targets.row.size)
    stretches = [(everyone, np.stack([P1, P1]), np.stack([P2, P2]))]
    for row in np.unique(targets.row):
        mine = np.flatnonzero(targets.row == row)
        stretches += [(mine[which], *ends) for which, *ends in _candidates(reach, targets.take(mine), weights, row)]
    at, Q1, Q2 = (np.concatenate(column, axis=-1) for column in zip(*stretches, strict=True))
    Q1, Q2, cost = _minimum(joint.sides(reach.theta[targets.row[at]]), targets.take(at), weights, Q1, Q2)
    order = np.lexsort((cost, at))
    least = order[np.unique(at[order], return_index=True)[1]]
    return Q1[least], Q2[least]


def _candidates(reach, targets, weights, row):
    """Return (target, ends of a straight stretch of P1, of P2) of all stretches that may contain the least cost."""
    paths = np.concatenate([*_edges(reach, row), *_folds(reach, row)], axis=1)  # (P1, P2, T, K), NaN between paths
    cost = _costs(targets, weights, paths[2], paths[3])
    low = np.minimum(cost[:, :-1], cost[:, 1:])
    which, i = np.nonzero(low - change(cost) / 2 <= np.nanmin(cost, axis=1, keepdims=True))
    keep = _lowest(which, low[which, i])
    which, i = which[keep], i[keep]
    yield which, paths[0, [i, i + 1]], paths[1, [i, i + 1]]
    yield np.arange(len(targets.T)), *_grid(reach, targets, weights, row)


def _lowest(which, value, most=24):
    """Return the indices of the `most` lowest values of every target."""
    order = np.lexsort((value, which))
    sorted_which = which[order]
    rank = np.arange(len(order)) - np.searchsorted(sorted_which, sorted_which)
    return order[rank < most]


def _costs(targets, weights, T, K):
    return weights[0] * (T - targets.T[:, None]) ** 2 + weights[1] * (K - targets.K[:, None]) ** 2


def _edges(reach, row):
    """Return the four edges of the box, each (4, n + 1)."""
    for side in (0, 1):
        own, other = (reach.curves[i].at(row) for i in (side, 1 - side))
        for end in (0, -1):
            pressures = own.P, np.full(own.P.shape, other.P[end])
            yield _path(side, *pressures, own.t + other.t[end], own.k + other.k[end])


def _folds(reach, row):
    """Yield all pairs with the same slope dk/dt, run by run of one curve."""
    for side in (0, 1):
        own, other = (reach.curves[i].at(row) for i in (side, 1 - side))
        for run in runs(other.m, other.P, other.t, other.k):
            inside = (own.m >= run.q[0]) & (own.m <= run.q[-1])
            P, t, k = (np.where(inside, np.interp(own.m, run.q, a), np.nan) for a in (run.P, *run.rest))
            yield _path(side, own.P, P, own.t + t, own.k + k)


def _path(side, own, other, T, K):
    pressures = (other, own) if side else (own, other)
    return np.pad(np.stack([*pressures, T, K]), ((0, 0), (0, 1)), constant_values=np.nan)


def _grid(reach, targets, weights, row):
    """Return the best point of a grid over the box for every target, as a stretch of zero length."""
    one, two = (reach.curves[i].at(row) for i in (0, 1))
    coarse = slice(None, None, _COARSE)
    T, K = (np.add.outer(a[coarse], b[coarse]).ravel() for a, b in ((one.t, two.t), (one.k, two.k)))
    at = np.unravel_index(_costs(targets, weights, T, K).argmin(axis=1), (one.t[coarse].size, two.t[coarse].size))
    P1, P2 = one.P[coarse][at[0]], two.P[coarse][at[1]]
    return np.stack([P1, P1]), np.stack([P2, P2])


def _minimum(sides, targets, weights, P1, P2):
    """Return (P1, P2, cost) by golden section along straight stretches with ends P1, P2 (2, c)."""
    costs = []

    def at(share):
        return tuple(P[0] + share * (P[1] - P[0]) for P in (P1, P2))

    def cost(share):
        (one, two), (Q1, Q2) = sides, at(share)
        e_T, e_K = one.torque(Q1) + two.torque(Q2) - targets.T, one.stiffness(Q1) + two.stiffness(Q2) - targets.K
        costs.append(weights[0] * e_T**2 + weights[1] * e_K**2)
        return costs[-1]

    shares = golden_section(cost, np.zeros(targets.T.size), np.ones(targets.T.size))
    least = np.argmin(costs, axis=0)
    return *at(pick(shares, least)), pick(np.stack(costs), least)
