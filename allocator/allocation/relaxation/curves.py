"""Curves (F(P), k(P)) of single muscles at a posture, and the polygons that enclose them.

Torque and stiffness of a mechanism are linear in force and own stiffness, y = Σ_j (r_j F_j ; k_j r_j r_jᵀ + F_j H_j),
so only the curve is nonlinear. Along a part of it the slope σ = dk/dF = k'/F' stays between a least and a greatest
value: lines of these slopes through both ends enclose the part in a parallelogram A, low, B, high. If σ only rises, the
curve is convex, hence below its chord, and within the triangle A, low, B; if it only falls, within A, high, B. σ turns
at the zeros of k'' F' - k' F'', which are those of a polynomial: F' and k' are Chebyshev series up to rounding, one
between two kinks of the law.

The law must satisfy only two conditions: F rises with P over all allowed pressures, and it is smooth between the kinks
that it declares.

`relax` replaces the curves by polygons around them: a convex QP, and a guaranteed lower bound.

With v = (F_1, k_1, …, F_m, k_m) minimise ½‖G v - b‖² over v_j in the polygon of muscle j, subject to E v = e, the
values achieved by the earlier levels. The cost is convex and lies above its tangent at x. Hence, with g = Gᵀ(G x - b) +
Eᵀλ, every such v satisfies, for any x and λ that a solver returns,

    ½‖G v - b‖² ≥ ½‖G x - b‖² + λ·(E x - e) + Σ_j min { g_j·(c - x_j) : c a corner of polygon j }                   (B)

DAQP (D. Arnström, A. Bemporad and D. Axehill, "A dual active-set solver for embedded quadratic programming using
recursive LDLᵀ updates", IEEE Trans. Automatic Control 67(8), 2022) only determines how tight the bound is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.one_muscle import OneMuscle
from allocator.units import BAR

_SIZES = (9, 17, 33, 65, 129)  # sizes tried for a series
_HALVINGS = 12  # of the pressures between two kinks, after which a law without a series counts as kinked
_TAIL = 1e-13  # of the greatest coefficient: smaller ones are rounding
_STRAIGHT = 1e-10  # of its terms: a smaller k'' F' - k' F'' is rounding
_REAL = 1e-6  # imaginary parts of roots below it, of half the width, are rounding
_BESIDE = 1e-10  # of the width: distance from a kink at which its two sides are evaluated
_TANGENTS = 4  # parts of an arc, with tangents at their ends
_WIDER = 1e-9  # of the slopes, added to the enclosure
_JUMPS = 1e-7  # of k: a smaller step is no jump


@dataclass(frozen=True)
class Curve:
    """Curve (F, k) of one muscle at one posture, for pressures between lo and hi [Pa]."""

    side: OneMuscle  # its contraction is a number
    lo: float
    hi: float
    breaks: Array  # pressures where the slope turns or the law has a kink, between lo and hi
    jumps: Array  # jumps of the own stiffness: trapped gas of a law with kinks

    @classmethod
    def of(cls, side: OneMuscle, lo: float, hi: float) -> "Curve":
        """Return the curve of a muscle. Raises `InvalidInput` with the condition that the law violates."""
        if hi - lo <= 0:
            return cls(side, lo, hi, np.empty(0), np.empty(0))
        kinks = [kink for kink in side.muscle.basis.kinks if lo < kink < hi]
        beside = _BESIDE * (hi - lo)
        breaks: list[float] = []
        for a, b in pairwise([lo, *kinks, hi]):
            breaks += _turns(side, a, b)
        steps = [abs(float(side.own_stiffness(kink + beside) - side.own_stiffness(kink - beside))) for kink in kinks]
        scale = abs(float(side.own_stiffness(lo))) + abs(float(side.own_stiffness(hi)))
        jumps = [kink for kink, step in zip(kinks, steps, strict=True) if step > _JUMPS * scale]
        return cls(side, lo, hi, np.unique([*breaks, *kinks]), np.array(jumps))

    @property
    def straight(self) -> bool:
        """Whether it is a segment of a line, as of muscles that are affine in the pressure."""
        return self.side.affine

    def at(self, P: Array) -> Array:
        """Return (F [N], k [N/m]) (…, 2) at pressures (…)."""
        return np.stack([np.broadcast_to(f(P), np.shape(P)) for f in (self.side.force, self.side.own_stiffness)], -1)

    def slope(self, P: Array) -> Array:
        """Return σ = dk/dF (…) [1/m] at pressures (…)."""
        return np.asarray(self.side.own_stiffness_gain(P) / self.side.force_gain(P))

    def enclosure(self, a: float, b: float) -> Array:
        """Return the corners (v, 2) of a polygon around the part between two pressures [Pa]; both ends come first."""
        if b <= a:
            return self.at(np.array([a]))
        if self.straight:
            return self.at(np.array([a, b]))
        beside = _BESIDE * (self.hi - self.lo)
        inside = self.breaks[(self.breaks > a + beside) & (self.breaks < b - beside)]
        P = np.concatenate([[a + beside], inside - beside, inside + beside, [b - beside]])
        if self.jumps.size and np.isin(inside, self.jumps).any():
            return self._around_jumps(a, b, inside)
        inner = a + beside if a in self.jumps else a, b - beside if b in self.jumps else b
        if inside.size:
            return _corners(self.at(np.array(inner)), self.slope(P), one_way=False)
        return self._one_way(*inner, beside)

    def _one_way(self, a: float, b: float, beside: float) -> Array:
        """Return a polygon of tangents around a part along which the slope only rises or only falls."""
        P = np.linspace(a, b, _TANGENTS + 1)
        ends, slopes = self.at(P), self.slope(np.concatenate([[a + beside], P[1:-1], [b - beside]]))
        corners = [_corners(ends[i : i + 2], slopes[i : i + 2], one_way=True)[2:] for i in range(_TANGENTS)]
        return np.concatenate([ends[[0, -1]], *corners])

    def _around_jumps(self, a: float, b: float, inside: Array) -> Array:
        """Return the rectangle around the parts on both sides of each jump."""
        ends = [a, *inside[np.isin(inside, self.jumps)], b]
        every = np.concatenate([self.enclosure(*part) for part in pairwise(ends)])
        (F0, k0), (F1, k1) = every.min(axis=0), every.max(axis=0)
        return np.array([(F0, k0), (F1, k1), (F0, k1), (F1, k0)])

    def parts(self, count: int) -> Iterator[Array]:
        """Yield polygons around `count` or more parts that make up the curve."""
        for a, b in pairwise(np.unique([*np.linspace(self.lo, self.hi, count + 1), *self.breaks])):
            yield self.enclosure(float(a), float(b))
        if self.hi <= self.lo:
            yield self.enclosure(self.lo, self.hi)


def _corners(ends: Array, slopes: Array, one_way: bool) -> Array:
    """Return the polygon around an arc between two ends (2, 2), of which `slopes` are the least and greatest slopes.

    `one_way`: they only rise or only fall from the first to the last.
    """
    wider = _WIDER * np.abs(slopes).max()
    A, B = ends
    least, greatest = slopes.min() - wider, slopes.max() + wider
    width, rise = B - A
    chord = np.clip(rise / width, least, greatest) if width > 0 else least
    if greatest - least <= 4 * wider:
        return np.array([A, B])
    x = width * (greatest - chord) / (greatest - least)
    low, high = A + np.array([x, least * x]), A + (width - x) * np.array([1.0, greatest])
    if one_way:
        return np.array([A, B, low if slopes[-1] > slopes[0] else high])
    return np.array([A, B, low, high])


def _turns(side: OneMuscle, a: float, b: float) -> list[float]:
    """Return the pressures between two kinks at which the slope dk/dF turns. Raises `InvalidInput`."""
    if side.affine:
        _check_rises(side, a, b, np.array([float(side.force_gain(a))]))
        return []
    return [turn for part in _smooth_parts(side, a, b) for turn in _turns_of(side, part)]


def _turns_of(side: OneMuscle, part: "_Part") -> list[float]:
    a, b, gain, own = part
    _check_rises(side, a, b, gain)
    terms = chebyshev.chebmul(chebyshev.chebder(own), gain), chebyshev.chebmul(own, chebyshev.chebder(gain))
    bent = chebyshev.chebsub(*terms)
    scale = sum(np.abs(term).max() for term in terms)
    bent[np.abs(bent) <= _STRAIGHT * scale] = 0.0
    bent = np.trim_zeros(bent, "b")
    return [] if bent.size < 2 else ((a + b) / 2 + (b - a) / 2 * _roots(bent)).tolist()


def _roots(series: NDArray[np.floating]) -> Array:
    """Return the real roots between -1 and 1."""
    found = chebyshev.chebroots(series)
    real = found.real[np.abs(found.imag) <= _REAL]
    return np.asarray(real[np.abs(real) < 1.0])


def rises(side: OneMuscle, lo: float, hi: float) -> bool:
    """Return whether the force of a muscle rises with the pressure between lo and hi [Pa]."""
    ends = [lo, *(kink for kink in side.muscle.basis.kinks if lo < kink < hi), hi]
    return side.affine or all(_rises(part.gain) for a, b in pairwise(ends) for part in _smooth_parts(side, a, b))


def _check_rises(side: OneMuscle, a: float, b: float, gain: Array) -> None:
    """Raise `InvalidInput` unless the force rises with the pressure."""
    if not _rises(gain):
        raise not_rising(side, a, b)


def _rises(gain: Array) -> bool:
    x = np.linspace(-1.0, 1.0, 33) if gain.size == 1 else np.concatenate([np.linspace(-1.0, 1.0, 33), _roots(gain)])
    return bool(chebyshev.chebval(x, gain).min() > 0) and not (gain.size > 1 and _roots(gain).size)


def not_rising(side: OneMuscle, a: float, b: float) -> InvalidInput:
    """Return the error for a force that does not rise between two pressures [Pa]."""
    return InvalidInput(
        f"the force of {side.name} ({type(side.muscle).__name__}) does not rise with the pressure all over the "
        f"{a / BAR:.4g} to {b / BAR:.4g} bar that its limits leave here: without that its pressures have no proof; "
        "keep the muscles taut (min_force), or lower the supply"
    )


class _Part(NamedTuple):
    """Pressures a to b [Pa] between which F' and k' are the Chebyshev series `gain` and `own`."""

    a: float
    b: float
    gain: Array
    own: Array


def _smooth_parts(side: OneMuscle, a: float, b: float, halvings: int = _HALVINGS) -> list[_Part]:
    """Return the parts between two kinks: one, or several where a smooth law is too steep for one series."""
    series = _series(side, a, b)
    if series is not None:
        return [_Part(a, b, *series)]
    middle = (a + b) / 2
    if halvings == 0:
        raise InvalidInput(
            f"{type(side.muscle).__name__} of {side.name} has a kink or a jump in pressure near {middle / BAR:.6g} "
            "bar; a law with kinks has to declare them, see Basis"
        )
    return _smooth_parts(side, a, middle, halvings - 1) + _smooth_parts(side, middle, b, halvings - 1)


def _series(side: OneMuscle, a: float, b: float) -> tuple[Array, Array] | None:
    """Return the Chebyshev series of F' and k', exact to rounding; None if they need too many terms."""
    for size in _SIZES:
        x = chebyshev.chebpts1(size)
        P = (a + b) / 2 + (b - a) / 2 * x
        values = [np.broadcast_to(f(P), x.shape) for f in (side.force_gain, side.own_stiffness_gain)]
        found = [np.linalg.solve(chebyshev.chebvander(x, size - 1), value) for value in values]
        if all(np.abs(c[-2:]).max() <= _TAIL * size * np.abs(c).max() for c in found):
            return found[0], found[1]
    return None


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
