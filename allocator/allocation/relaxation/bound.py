"""Relaxation of the muscles' curves to polygons around them: a convex QP, and a guaranteed lower bound.

With v = (F_1, k_1, …, F_m, k_m) minimise ½‖G v - b‖² over v_j in the polygon of muscle j, subject to E v = e, the
values achieved by the earlier levels. The cost is convex and lies above its tangent at x. Hence, with g = Gᵀ(G x - b) +
Eᵀλ, every such v satisfies, for any x and λ that a solver returns,

    ½‖G v - b‖² ≥ ½‖G x - b‖² + λ·(E x - e) + Σ_j min { g_j·(c - x_j) : c a corner of polygon j }                   (B)

DAQP (D. Arnström, A. Bemporad and D. Axehill, "A dual active-set solver for embedded quadratic programming using
recursive LDLᵀ updates", IEEE Trans. Automatic Control 67(8), 2022) only determines how tight the bound is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array

_EQUALITY = 5  # DAQP's name of it
_PROXIMAL = 1e-9  # of the greatest entry of the Hessian, which has more columns than rank
_INFEASIBLE = -1
_PENALTY = 1e3  # weight of equalities that DAQP finds infeasible
_APART = 1e-10  # of the equalities' size, squared: a greater distance from them is not rounding


class Level(NamedTuple):
    """Cost ½‖G v - b‖² of a level, and the values achieved by the earlier levels, E v = e."""

    G: Array  # (p, 2m)
    b: Array  # (p,)
    E: Array  # (r, 2m)
    e: Array  # (r,)

    def cost(self, v: Array) -> float:
        """Return ‖G v - b‖²."""
        left = self.G @ v - self.b
        return float(left @ left)


class Relaxed(NamedTuple):
    """Answer of the relaxed problem and its lower bound."""

    v: Array  # (2m,)
    bound: float  # no v of the polygons with E v = e has a lower ‖G v - b‖²; inf: there is no such v


def relax(polygons: Sequence[Array], level: Level) -> Relaxed:
    """Return the least cost over the polygons (v_j, 2) of all muscles, with its lower bound   (B)"""
    within = _coordinates(polygons)
    v, multipliers, feasible = _solve(*within, level)
    if not feasible:  # according to DAQP
        apart = Level(level.E, level.e, level.E[:0], level.e[:0])
        v, none, _ = _solve(*within, apart)
        if _safe(polygons, apart, v, none) > _APART**2 * (1.0 + float(level.e @ level.e)):
            return Relaxed(v, np.inf)
        rows = np.vstack([level.G, _PENALTY * level.E]), np.concatenate([level.b, _PENALTY * level.e])
        v, _, _ = _solve(*within, Level(*rows, level.E[:0], level.e[:0]))
        multipliers = _PENALTY**2 * (level.E @ v - level.e)
    return Relaxed(v, max(_safe(polygons, level, v, multipliers), 0.0))


def _coordinates(polygons: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return v = corner + edges·w with w ≥ 0 and simplices·w ≤ 1: (2m,), (2m, t) and (m, t)."""
    corner = np.concatenate([polygon[0] for polygon in polygons])
    count = [len(polygon) - 1 for polygon in polygons]
    edges, simplices = np.zeros((len(corner), sum(count))), np.zeros((len(polygons), sum(count)))
    begin = 0
    for j, (polygon, more) in enumerate(zip(polygons, count, strict=True)):
        edges[2 * j : 2 * j + 2, begin : begin + more] = (polygon[1:] - polygon[0]).T
        simplices[j, begin : begin + more] = 1.0
        begin += more
    return corner, edges, simplices


def _solve(corner: Array, edges: Array, simplices: Array, level: Level) -> tuple[Array, Array, bool]:
    """Return (v, the multipliers of the equalities, whether these are feasible), by DAQP."""
    import daqp

    if not edges.shape[1]:
        return corner, np.zeros(len(level.e)), True
    G, E = level.G @ edges, level.E @ edges
    H = G.T @ G
    H[np.diag_indices_from(H)] += _PROXIMAL * (H.max() + 1e-12)
    right = level.e - level.E @ corner
    t, m, r = G.shape[1], len(simplices), len(right)
    x, _, flag, info = daqp.solve(
        H,
        G.T @ (level.G @ corner - level.b),
        np.ascontiguousarray(np.vstack([simplices, E])),
        np.concatenate([np.ones(t + m), right]),
        np.concatenate([np.zeros(t + m), right]),
        np.array([0] * (t + m) + [_EQUALITY] * r, dtype=np.int32),
        primal_tol=1e-10,
    )
    w = np.nan_to_num(np.asarray(x))
    return corner + edges @ w, np.nan_to_num(np.asarray(info["lam"]))[t + m :], flag != _INFEASIBLE


def _safe(polygons: Sequence[Array], level: Level, x: Array, multipliers: Array) -> float:
    """Return twice the right-hand side of (B)."""
    left = level.G @ x - level.b
    g = level.G.T @ left + level.E.T @ multipliers
    least = sum(float((polygon @ g[2 * j : 2 * j + 2]).min()) for j, polygon in enumerate(polygons))
    return 2 * (float(left @ left) / 2 + float(multipliers @ (level.E @ x - level.e)) + least - float(g @ x))
