"""Region of contraction and pressure in which a muscle was measured, and the continuation of its law beyond it.

The region is the convex hull of the samples. Within its contractions [ε_0, ε_1] the law is the published formula f;
beyond them it goes on with the slope at the nearer end e, at every pressure

    f(ε) → f(e) + f'(e) (ε - e)                                                         (R1)

which is continuous with its first derivative. At a fixed contraction the functions of the pressure (`Basis`) are those
of the formula, so an affine law stays affine. A fitted polynomial or spline would otherwise reach any force a few
percent of contraction away from its data.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask, Value, derivative, five_point, is_symbol
from allocator.errors import InvalidInput
from allocator.units import BAR

Edges = tuple[float, float]
"""Contractions [-] between which a law is its formula."""

_MARGIN = 0.01  # of the region's width: a point less far outside counts as inside, since sensors err by as much
_DIFFERENCE = 1e-4  # [-] step of the slope at an edge where parameters are complex
_EMPTY = 0.01  # of a pressure or contraction: the unit of an axis along which nothing was varied


@dataclass(frozen=True)
class MeasuredRegion:
    """Convex region of the (ε, P) plane by its corners, counter-clockwise; one or two corners are a point or a line."""

    contraction: tuple[float, ...]  # of the corners [-]
    pressure: tuple[float, ...]  # of the corners, gauge [Pa]

    def __post_init__(self) -> None:
        """Check the corners, and keep those of their convex hull."""
        eps = np.atleast_1d(checks.contraction("measured: contraction", self.contraction))
        P = np.atleast_1d(checks.pressure("measured: pressure", self.pressure))
        if eps.ndim != 1 or eps.shape != P.shape or not eps.size:
            raise InvalidInput(f"measured: contraction and pressure need one shape (n,), got {eps.shape} and {P.shape}")
        corners = _hull(eps, P)
        object.__setattr__(self, "contraction", tuple(corners[:, 0].tolist()))
        object.__setattr__(self, "pressure", tuple(corners[:, 1].tolist()))

    @classmethod
    def of(cls, contraction: ArrayLike, pressure: ArrayLike) -> Self:
        """Return the convex hull of samples (n,) at these contractions [-] and pressures [Pa]."""
        return cls(tuple(np.ravel(contraction).tolist()), tuple(np.ravel(pressure).tolist()))

    @property
    def contractions(self) -> Edges:
        """Least and greatest contraction [-]."""
        return min(self.contraction), max(self.contraction)

    @property
    def pressures(self) -> tuple[float, float]:
        """Least and greatest pressure [Pa]."""
        return min(self.pressure), max(self.pressure)

    def contains(self, eps: ArrayLike, P: ArrayLike) -> Mask:
        """Return whether contractions [-] and pressures [Pa], which broadcast, lie in the region.

        A point outside by less than 1 % of the region's width still counts as inside. NaN lies in no region.
        """
        corners = self._scaled(np.array(self.contraction), np.array(self.pressure))
        point = self._scaled(np.asarray(eps, float), np.asarray(P, float))
        return np.asarray(_distance(corners, point) <= _MARGIN)

    def _scaled(self, eps: Array, P: Array) -> Array:
        """Return (…, 2) with the region's extent as the unit of both axes."""
        axes = zip((eps, P), (self.contractions, self.pressures), strict=True)
        shares = [(x - lo) / max(hi - lo, _EMPTY * abs(hi), 1e-12) for x, (lo, hi) in axes]
        return np.stack(np.broadcast_arrays(*shares), axis=-1)

    def __str__(self) -> str:
        """Return both ranges, for a sentence."""
        (least, most), (low, high) = self.contractions, self.pressures
        return f"contractions of {least:.3g} to {most:.3g} at {low / BAR:.3g} to {high / BAR:.3g} bar"


class TabledRegion(NamedTuple):
    """Contractions [-] of a muscle's table, at any pressure."""

    least: float
    most: float

    def contains(self, eps: ArrayLike, P: ArrayLike) -> Mask:
        """Return whether contractions [-] lie in the table, up to 1 % of its width, at pressures that are numbers."""
        margin = _MARGIN * (self.most - self.least)
        eps, P = np.broadcast_arrays(np.asarray(eps, float), np.asarray(P, float))
        return np.asarray((eps >= self.least - margin) & (eps <= self.most + margin) & ~np.isnan(P))

    def __str__(self) -> str:
        """Return the range, for a sentence."""
        return f"contractions of {self.least:.3g} to {self.most:.3g}"


class Visit(NamedTuple):
    """Points (…) of the (ε, P) plane at which an answer uses a muscle."""

    name: str  # of the muscle
    region: MeasuredRegion | TabledRegion | None  # where it was measured; None: not known
    contraction: ArrayLike  # [-]
    pressure: ArrayLike  # gauge [Pa]; NaN: no answer, hence no point

    @property
    def extrapolates(self) -> Mask:
        """Which of the points (…) lie outside the region; none where the region is not known."""
        eps, P = np.broadcast_arrays(np.asarray(self.contraction, float), np.asarray(self.pressure, float))
        if self.region is None:
            return np.zeros(eps.shape, bool)
        return np.asarray(~self.region.contains(eps, P) & ~np.isnan(P))


def extrapolation(visits: Iterable[Visit], *, counted: bool = True) -> str:
    """Return which muscles leave the region in which they were measured, without a full stop; "" if none does.

    If `counted` it says at how many points they do.
    """
    left = []
    for visit in visits:
        outside = visit.extrapolates
        if outside.any():
            often = f"in {int(outside.sum())} of {outside.size} points, " if counted and outside.size > 1 else ""
            left.append(f"{visit.name} ({often}measured at {visit.region})")
    return f"the force is extrapolated beyond what was measured: {'; '.join(left)}" if left else ""


def held(eps: Value, edges: Edges) -> Value:
    """Return the nearest contraction within the edges [-], of numbers (complex ones by their real part) or symbols."""
    lo, hi = edges
    if is_symbol(eps):
        import casadi

        return casadi.if_else(eps < lo, lo, casadi.if_else(eps > hi, hi, eps))
    if isinstance(eps, float | complex):
        return lo if eps.real < lo else hi if eps.real > hi else eps
    x = np.real(eps)
    return np.where(x < lo, lo, np.where(x > hi, hi, eps))


def continued(formula: Callable[[Value], Value], eps: Value, edges: Edges | None) -> Value:
    """Return `formula(eps)`, beyond the edges with the slope that it has there   (R1)"""
    if edges is None:
        return formula(eps)
    e = held(eps, edges)
    beyond = eps - e
    if not is_symbol(beyond) and not np.any(beyond):
        return formula(eps)
    return formula(e) + _slope(formula, e) * beyond


def continued_integral(
    formula: Callable[[Value], Value], integral: Callable[[Value], Value], eps: Value, edges: Edges | None
) -> Value:
    """Return ∫_0^ε of the continued `formula`, of which `integral` is ∫_0^ε within the edges."""
    if edges is None:
        return integral(eps)

    def primitive(x: Value) -> Value:
        e = held(x, edges)
        beyond = x - e
        if not is_symbol(beyond) and not np.any(beyond):
            return integral(x)
        return integral(e) + (formula(e) + _slope(formula, e) * beyond / 2) * beyond

    return primitive(eps) - primitive(0.0)


def _slope(formula: Callable[[Value], Value], e: Value) -> Value:
    """Return f'(e), also where the parameters of the formula are complex (derivatives by them) or symbols."""
    if is_symbol(e):
        return derivative(formula, e)
    x = np.real(e)
    value = formula(x)
    if is_symbol(value):
        import casadi

        s = type(value).sym("s")
        return casadi.substitute(casadi.jacobian(formula(s), s), s, x)
    if not np.iscomplexobj(value):
        return derivative(formula, x)
    return five_point(formula, x, _DIFFERENCE)


def _hull(eps: Array, P: Array) -> Array:
    """Return the corners (m, 2) of the convex hull, counter-clockwise: A. M. Andrew's monotone chain, 1979."""
    points: list[tuple[float, float]] = sorted(set(zip(eps.tolist(), P.tolist(), strict=True)))
    lower, upper = _chain(points), _chain(points[::-1])
    return np.array([*lower[:-1], *upper[:-1]] or points)


def _chain(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return those of the sorted points from which the chain only turns left."""
    chain: list[tuple[float, float]] = []
    for point in points:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0:
            chain.pop()
        chain.append(point)
    return chain


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return twice the area of the triangle a, b, c, positive if it turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _distance(corners: Array, point: Array) -> Array:
    """Return how far points (…, 2) are outside the polygon of `corners` (m, 2), 0 inside; NaN for NaN."""
    along = np.roll(corners, -1, axis=0) - corners  # (m, 2)
    apart = point[..., None, :] - corners  # (…, m, 2)
    length = np.maximum((along**2).sum(axis=-1), 1e-300)
    share = np.clip((apart * along).sum(axis=-1) / length, 0.0, 1.0)
    nearest = np.sqrt(((apart - share[..., None] * along) ** 2).sum(axis=-1)).min(axis=-1)
    left = along[:, 0] * apart[..., 1] - along[:, 1] * apart[..., 0] >= 0
    inside = left.all(axis=-1) & (len(corners) > 2)
    return np.asarray(np.where(inside, 0.0, nearest))
