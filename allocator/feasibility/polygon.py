"""Convex polygons of the feasible pairs of two targets, found corner by corner with linear programmes.

The farthest point outward from an edge between two known corners either is a new corner, or proves that no pressures
are beyond the edge. The dual prices of that proof identify the muscles' limits that bind all along the edge: those that
would move it if they were relaxed.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.lazy import Axes
from allocator.mechanism.endpoint.endpoint import Endpoint, Place, inverses, load_of

_NAME = re.compile(r"(Kx|K|T)(\d+)(?:,(\d+))?")
_UNITS = {"T": "N·m", "K": "N·m/rad", "Kx": "N/m"}
_KINDS = {"K": "stiffness", "Kx": "endpoint stiffness"}


class Coordinate(NamedTuple):
    """Affine function d·y + c of torques and stiffness, y in the order of a `TargetsMap`."""

    kind: str  # "torque", "stiffness", "endpoint stiffness"
    name: str  # "T1", "K12", "Kx11", "0.5 Kx11 - 0.5 Kx22"
    unit: str
    direction: Array  # d (n + n(n+1)/2,)
    constant: float  # c

    @property
    def label(self) -> str:
        """Label of an axis."""
        return f"{self.kind} {self.name} [{self.unit}]"


class Hand(NamedTuple):
    """Endpoint at a posture, under its force."""

    endpoint: Endpoint
    place: Place  # of one posture
    force: Array  # (dim,) [N]


def coordinate(wanted: object, n: int, hand: Hand | None) -> Coordinate:
    """Return the coordinate of this name, or of a mapping of names to weights. Raises `InvalidInput`."""
    if not isinstance(wanted, Mapping):
        return _named(wanted, n, hand)
    if not wanted:
        raise InvalidInput("a target is a name, such as 'K11', or a mapping of names to weights")
    parts = [(_named(name, n, hand), float(weight)) for name, weight in wanted.items()]
    if len({part.unit for part, _ in parts}) > 1:
        raise InvalidInput(f"{', '.join(wanted)} have different units; a sum of them means nothing")
    name = " ".join(f"{'-' if weight < 0 else '+'} {abs(weight):.3g} {part.name}" for part, weight in parts)
    return Coordinate(
        parts[0][0].kind,
        name.removeprefix("+ "),
        parts[0][0].unit,
        np.sum([weight * part.direction for part, weight in parts], axis=0),
        sum(weight * part.constant for part, weight in parts),
    )


def _named(name: Any, n: int, hand: Hand | None) -> Coordinate:
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        raise _unknown(name, n, hand)
    kind, first, second = match.groups()
    size = n if kind != "Kx" else (hand.endpoint.dim if hand else 0)
    places = [int(i) - 1 for i in ((first, second) if second else first)]
    if len(places) != (1 if kind == "T" else 2) or not all(0 <= i < size for i in places):
        raise _unknown(name, n, hand)
    entry = np.zeros((size, size))
    if kind == "T":
        return Coordinate("torque", name, _UNITS[kind], np.eye(n + n * (n + 1) // 2)[places[0]], 0.0)
    entry[places[0], places[1]] += 0.5
    entry[places[1], places[0]] += 0.5
    constant = 0.0
    if kind == "Kx" and hand is not None:
        plus, _ = inverses(hand.place)
        entry = plus @ entry @ plus.T
        constant = float(np.sum(entry * load_of(hand.place, hand.force)))
    triangle = (entry * (2 - np.eye(n)))[np.triu_indices(n)]
    return Coordinate(_KINDS[kind], name, _UNITS[kind], np.concatenate([np.zeros(n), triangle]), constant)


def _unknown(name: object, n: int, hand: Hand | None) -> InvalidInput:
    known = f"T1 … T{n}, K11 … K{n}{n}"
    known += "" if hand is None else f", Kx11 … Kx{hand.endpoint.dim}{hand.endpoint.dim}"
    hint = " (Kx needs an endpoint)" if hand is None else ""
    return InvalidInput(f"there is no target {name!r}; a mechanism with n = {n} joints has {known}{hint}")


_NEAR = 1e-9  # of the size: a point farther out by less is on the edge
_FREE = 1e-7  # of the size: a limit that moves an edge by less over its whole range does not bind
_MOST_CORNERS = 2000


class Farthest(NamedTuple):
    """Maximum of a linear function of the pressures."""

    P: Array  # (m,) [Pa]
    price: Array  # (m,) of the limits, per Pa; positive at the greatest pressure, negative at the least


class Programme(NamedTuple):
    """Pressures within a box that keep some targets: rows·P = right."""

    rows: Array  # (k, m)
    right: Array  # (k,)
    lo: Array  # (m,) [Pa]
    hi: Array
    exists: bool  # whether there is a box

    def farthest(self, slope: Array) -> Farthest | None:
        """Return the maximum of slope·P; None if no pressures keep the targets."""
        if not self.exists:
            return None
        if not len(self.rows):
            return Farthest(np.where(slope > 0, self.hi, self.lo), slope)
        return self._linear(slope)

    def _linear(self, slope: Array) -> Farthest | None:
        from scipy.optimize import linprog

        span = self.hi - self.lo  # x = (P - lo)/span is in [0, 1], and every row of size 1
        wide = np.where(span > 0, span, 1.0)
        rows, right = self.rows * wide, self.right - self.rows @ self.lo
        size = np.abs(rows).max(axis=1)
        steep = np.abs(slope * wide).max() or 1.0
        found = linprog(
            -slope * wide / steep,
            A_eq=rows / size[:, None],
            b_eq=right / size,
            bounds=np.stack([np.zeros_like(span), np.where(span > 0, 1.0, 0.0)], axis=1),
            method="highs-ds",
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        if found.status == 2:
            return None
        if found.status != 0:
            raise InvalidInput(f"the linear programme of a corner is not solved ({found.message})")
        price = -(found.lower.marginals + found.upper.marginals) * steep / wide
        return Farthest(np.clip(self.lo + found.x * span, self.lo, self.hi), price)


@dataclass(frozen=True, eq=False)
class Edge:
    """Edge of a polygon from one corner to the next, anticlockwise."""

    start: Array  # (2,)
    end: Array
    active: tuple[str, ...]  # the limits that would move the edge if they were relaxed: "muscle 1 upper", …


@dataclass(frozen=True, eq=False)
class Polygon:
    """All feasible values of two targets; no corners if there are none."""

    axes: tuple[Coordinate, Coordinate]
    vertices: Array  # (k, 2), anticlockwise, in the targets' units
    P: Array  # their pressures (k, m) [Pa]
    edges: tuple[Edge, ...]  # edge i leads from vertex i to the next
    held: str  # the constant targets, in words

    @property
    def area(self) -> float:
        """Area, in the product of both units."""
        x, y = self.vertices.T if len(self.vertices) else np.zeros((2, 1))
        return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))

    def contains(self, x: object, y: object, tolerance: float = 1e-9) -> Any:
        """Return whether the points (…) lie inside, up to `tolerance` in fractions of the polygon's size."""
        points = np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float)), axis=-1)
        if not len(self.vertices):
            return np.zeros(points.shape[:-1], bool)
        size = np.ptp(self.vertices, axis=0).max() or 1.0
        inside = (np.abs(points - self.vertices[0]) <= tolerance * size).all(axis=-1) | (len(self.edges) > 0)
        for edge in self.edges:
            along = edge.end - edge.start
            length = np.hypot(*along)
            outward = np.array([along[1], -along[0]]) / length
            inside &= (points - edge.start) @ outward <= tolerance * size
            if len(self.edges) == 2:  # both sides of a line: also check its ends
                inside &= ((points - edge.start) @ along / length) <= length + tolerance * size
        return inside

    def plot(self, axes: "Axes | None" = None) -> Any:
        """Draw the polygon with the binding limits named on its edges; return the Matplotlib axes."""
        from allocator.feasibility.pictures import plot_polygon

        return plot_polygon(self, axes)


Corner = tuple[Array, Array]
"""A point (2,) of the polygon, and pressures (m,) that give it."""


def outline(programme: Programme, offset: Array, slope: Array) -> tuple[list[Corner], list[Array]]:
    """Return the corners of {offset + slope·P}, anticlockwise, and for each side the prices (m,) of the limits.

    `slope` is (2, m). One corner has no side, two have two sides.
    """
    scale = np.maximum(np.abs(slope) @ np.maximum(np.abs(programme.lo), np.abs(programme.hi)), 1e-300)
    unit = slope / scale[:, None]

    def corner(direction: Array) -> tuple[Array, Farthest] | None:
        found = programme.farthest(direction @ unit)
        return None if found is None else (unit @ found.P, found)

    first = [corner(np.array(d)) for d in ((0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))]
    if any(found is None for found in first):
        return [], []
    ring: list[tuple[Array, Array]] = []
    for point, found in first:  # type: ignore[misc]  # none is None
        if not any(_same(point, other) for other, _ in ring):
            ring.append((point, found.P))
    corners, sides = _without_flat(*_refined(ring, corner)) if len(ring) > 1 else (ring, [])
    span = np.where(programme.hi > programme.lo, programme.hi - programme.lo, 0.0)
    prices = [np.where(np.abs(price) * span > _FREE, price, 0.0) for price in sides]
    return [(offset + scale * point, P) for point, P in corners], prices


def _refined(ring: list[tuple[Array, Array]], corner: Any) -> tuple[list[tuple[Array, Array]], list[Array]]:
    """Return all corners and the prices of the sides, by searching outward from every side until none moves."""
    i, sides = 0, []
    while i < len(ring):
        if len(ring) > _MOST_CORNERS:
            raise InvalidInput(f"the polygon has more than {_MOST_CORNERS} corners")
        (start, _), (end, _) = ring[i], ring[(i + 1) % len(ring)]
        along = end - start
        outward = np.array([along[1], -along[0]]) / np.hypot(*along)
        point, found = corner(outward)
        beyond = outward @ (point - start) > _NEAR
        if beyond and not (_same(point, start) or _same(point, end)):
            ring.insert(i + 1, (point, found.P))
        else:
            sides.append(found.price)
            i += 1
    return ring, sides


def _without_flat(ring: list[tuple[Array, Array]], sides: list[Array]) -> tuple[list[tuple[Array, Array]], list[Array]]:
    """Remove the corners at which the outline does not turn: a linear programme may end in the middle of a side."""
    points = np.array([point for point, _ in ring])
    middle = points.mean(axis=0)
    _, _, (axis, across) = np.linalg.svd(points - middle, full_matrices=False)
    if np.ptp(points @ across) <= _NEAR:  # all of it lies on a line
        ends = [int(np.argmin(points @ axis)), int(np.argmax(points @ axis))]
        return [ring[i] for i in ends], [sides[i] for i in ends]
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    kept = np.flatnonzero(turn > _NEAR * np.hypot(*before.T) * np.hypot(*after.T))
    return [ring[i] for i in kept], [sides[i] for i in kept]


def _same(one: Array, other: Array) -> bool:
    return bool(np.abs(one - other).max() <= _NEAR)
