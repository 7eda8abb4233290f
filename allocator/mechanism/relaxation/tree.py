"""Branch and bound closes the gap between the best pressures that are known and what is proved to be impossible.

A node is an interval of pressure for each muscle; what its polygons leave has the lower bound (B) of `bound`. The node
with the lowest bound is split in two, across the muscle whose relaxed (F, k) is farthest from its curve in terms of the
cost, at the pressure of its force. Near the bounds' optimum pressures are sought that do better than the best ones.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.relaxation.bound import Level, Relaxed, relax
from allocator.mechanism.relaxation.curves import Curve
from allocator.mechanism.relaxation.descent import Found, descend
from allocator.mechanism.relaxation.model import Model

MOST_NODES = 500  # of a level of a target
_STEPS = 15  # of a descent from a node
_INSIDE = 0.1  # of an interval: it is not split nearer to its ends
_NEARLY = 1e-2  # weighted [N·m] or [N·m/rad]
_PATIENCE = 8  # descents that find nothing better, after which they begin now and then only
_SAMPLES = 65  # pressures between which a force is looked up


@dataclass(frozen=True, eq=False)
class Node:
    """A `Node` is an interval of pressure [Pa] for each muscle, with the polygons around what they can do there."""

    lo: Array  # (m,)
    hi: Array
    polygons: tuple[Array, ...]
    relaxed: Relaxed

    def children(self, curves: tuple[Curve, ...], level: Level, j: int, at: float) -> Iterator["Node"]:
        """Yield the two nodes that are left and right of the pressure `at` of muscle j."""
        for end, other in (("hi", self.lo[j]), ("lo", self.hi[j])):
            moved = getattr(self, end).copy()
            moved[j] = at
            polygons = list(self.polygons)
            polygons[j] = curves[j].enclosure(min(at, float(other)), max(at, float(other)))
            relaxed = relax(polygons, level)
            bound = max(relaxed.bound, self.relaxed.bound)
            yield replace(self, polygons=tuple(polygons), relaxed=relaxed._replace(bound=bound), **{end: moved})


def close(
    model: Model, target: int, k: int, found: Found, gap: float, most: int = MOST_NODES
) -> tuple[Found, float, int]:
    """Return the best pressures of level k of a target, a lower bound of its cost, and the number of nodes.

    It ends when (cost - bound)/(1 + cost) ≤ `gap`, or after `most` nodes. `found` is what is known, of this target.
    """
    curves = model.curves[int(model.problem.which[target])]
    level = model.level(target, k, found.left[0] + model.asked[target])
    lo, hi = (end[target] for end in model.bounds)
    polygons = tuple(c.enclosure(float(a), float(b)) for c, a, b in zip(curves, lo, hi, strict=True))
    nodes, failed, order = 1, 0, count()
    root = Node(lo, hi, polygons, relax(polygons, level))
    heap = [(root.relaxed.bound, next(order), root)]
    while True:
        bound, _, node = heap[0]
        cost = float(found.costs[0, k])
        if cost - bound <= gap * (1 + cost) or nodes >= most:
            return found, min(bound, cost), nodes
        heapq.heappop(heap)
        P = _pressures(curves, node)
        enough = cost - gap * (1 + cost) if failed < _PATIENCE else -1.0
        if nodes & (nodes + 1) == 0 or _promises(level, _states(curves, P), enough):  # now and then, or for a reason
            before, found = found, _better(model, target, k, P, found)
            failed += found is before
        j, at = _split(curves, node, level, P)
        for child in node.children(curves, level, j, at):
            heapq.heappush(heap, (child.relaxed.bound, next(order), child))
        nodes += 2


def _promises(level: Level, v: Array, enough: float) -> bool:
    """Return whether a point of the curves costs less than `enough`, and nearly has what earlier levels achieve."""
    return level.cost(v) < enough and bool(np.abs(level.E @ v - level.e).max(initial=0.0) < _NEARLY)


def _better(model: Model, target: int, k: int, P: Array, found: Found) -> Found:
    """Return what a descent from `P` finds where that is better at level k, and as good before; else `found`."""
    tried = descend(model, np.array([target]), P[None], _STEPS)
    same = np.abs(tried.left[0] - found.left[0])[: [0, *model.problem.rows[1].tolist()][k]]
    as_good = (same <= 1e-9 * (1 + np.abs(model.asked[target, : same.size]))).all()
    return tried if as_good and tried.costs[0, k] < found.costs[0, k] else found


def _pressures(curves: tuple[Curve, ...], node: Node) -> Array:
    """Return pressures (m,) that give the relaxed forces, roughly."""
    F = node.relaxed.v[::2]
    P = np.empty(len(F))
    for j, curve in enumerate(curves):
        samples = np.linspace(node.lo[j], node.hi[j], _SAMPLES)
        P[j] = np.interp(F[j], curve.at(samples)[:, 0], samples)
    return P


def _states(curves: tuple[Curve, ...], P: Array) -> Array:
    return np.concatenate([curve.at(np.array(p)) for curve, p in zip(curves, P, strict=True)])


def _split(curves: tuple[Curve, ...], node: Node, level: Level, P: Array) -> tuple[int, float]:
    """Return the muscle to split, and the pressure [Pa] where."""
    off = node.relaxed.v - _states(curves, P)
    weight = np.sqrt((level.G**2).sum(axis=0) + (level.E**2).sum(axis=0))
    wide = np.array([not curve.straight for curve in curves]) & (node.hi > node.lo)
    far = (np.abs(off) * weight).reshape(-1, 2).max(axis=1)
    extent = np.array([np.ptp(polygon, axis=0).max() for polygon in node.polygons])
    j = int(np.argmax(np.where(wide, far + 1e-9 * extent, -1.0)))
    a, b = node.lo[j], node.hi[j]
    inside = [p for p in curves[j].breaks if a + 1e-6 * (b - a) < p < b - 1e-6 * (b - a)]
    if inside:
        return j, min(inside, key=lambda p: abs(p - P[j]))
    return j, float(np.clip(P[j], a + _INSIDE * (b - a), b - _INSIDE * (b - a)))
