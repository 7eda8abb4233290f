"""Solution of problem [M], level after level, for muscles that are not affine, bounded from below."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.box.pivoting import Solved
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.relaxation.curves import Curve, Level, Relaxed, relax
from allocator.allocation.relaxation.descent import Found, certified, descend, lower
from allocator.allocation.relaxation.model import Model
from allocator.allocation.status import CLOSED_FORM
from allocator.calculus import Array, Mask

MOST_NODES = 500  # per level of a target
_STEPS = 15  # per descent from a node
_INSIDE = 0.1  # of an interval: least distance of a split from its ends
_NEARLY = 1e-2  # weighted [N·m] or [N·m/rad]
_PATIENCE = 8  # descents without improvement, after which they become rare
_SAMPLES = 65  # pressures of the table that inverts a force


@dataclass(frozen=True, eq=False)
class Node:
    """Interval of pressure [Pa] for each muscle, with the polygons around its curve there."""

    lo: Array  # (m,)
    hi: Array
    polygons: tuple[Array, ...]
    relaxed: Relaxed

    def children(self, curves: tuple[Curve, ...], level: Level, j: int, at: float) -> Iterator["Node"]:
        """Yield the two nodes left and right of the pressure `at` of muscle j."""
        for end, other in (("hi", self.lo[j]), ("lo", self.hi[j])):
            moved = getattr(self, end).copy()
            moved[j] = at
            polygons = list(self.polygons)
            polygons[j] = curves[j].enclosure(min(at, float(other)), max(at, float(other)))
            relaxed = relax(polygons, level)
            bound = max(relaxed.bound, self.relaxed.bound)
            yield replace(self, polygons=tuple(polygons), relaxed=relaxed._replace(bound=bound), **{end: moved})


def close(model: Model, target: int, k: int, found: Found, gap: float) -> tuple[Found, float, int]:
    """Return the best pressures of level k of a target, a lower bound of its cost, and the number of nodes.

    It ends when (cost - bound)/(1 + cost) ≤ `gap`, or after `MOST_NODES`. `found` is the best known answer.
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
        if cost - bound <= gap * (1 + cost) or nodes >= MOST_NODES:
            return found, min(bound, cost), nodes
        heapq.heappop(heap)
        P = _pressures(curves, node)
        enough = cost - gap * (1 + cost) if failed < _PATIENCE else -1.0
        if nodes & (nodes + 1) == 0 or _promises(level, _states(curves, P), enough):  # rarely, or if promising
            before, found = found, _better(model, target, k, P, found)
            failed += found is before
        j, at = _split(curves, node, level, P)
        for child in node.children(curves, level, j, at):
            heapq.heappush(heap, (child.relaxed.bound, next(order), child))
        nodes += 2


def _promises(level: Level, v: Array, enough: float) -> bool:
    """Return whether a point of the curves costs less than `enough`, and nearly has the values of earlier levels."""
    return level.cost(v) < enough and bool(np.abs(level.E @ v - level.e).max(initial=0.0) < _NEARLY)


def _better(model: Model, target: int, k: int, P: Array, found: Found) -> Found:
    """Return the descent from `P` if it is better at level k and as good at earlier ones; else `found`."""
    tried = descend(model, np.array([target]), P[None], _STEPS)
    same = np.abs(tried.left[0] - found.left[0])[: [0, *model.problem.rows[1].tolist()][k]]
    as_good = (same <= 1e-9 * (1 + np.abs(model.asked[target, : same.size]))).all()
    return tried if as_good and tried.costs[0, k] < found.costs[0, k] else found


def _pressures(curves: tuple[Curve, ...], node: Node) -> Array:
    """Return pressures (m,) that approximately give the relaxed forces."""
    F = node.relaxed.v[::2]
    P = np.empty(len(F))
    for j, curve in enumerate(curves):
        samples = np.linspace(node.lo[j], node.hi[j], _SAMPLES)
        P[j] = np.interp(F[j], curve.at(samples)[:, 0], samples)
    return P


def _states(curves: tuple[Curve, ...], P: Array) -> Array:
    return np.concatenate([curve.at(np.array(p)) for curve, p in zip(curves, P, strict=True)])


def _split(curves: tuple[Curve, ...], node: Node, level: Level, P: Array) -> tuple[int, float]:
    """Return the muscle to split, and the pressure [Pa] of the split."""
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


_BESIDE = 0.35  # of the interval of a muscle's pressure, from its middle
_PARTS = 16  # of a curve, enclosed separately


class Nearby(NamedTuple):
    """Solution of N problems of K levels, with lower bounds."""

    solved: Solved  # its rounds are nodes of the search
    residual: Array | None  # of local optimality (N,); None of affine muscles: that of the levels
    costs: Array  # the squared errors of each level (N, K) [cost]
    bounds: Array  # lower bounds of the costs, given the values of earlier levels (N, K) [cost]

    @property
    def left(self) -> Array:
        """Bound on the excess of a level's cost over the least (N,), relative to 1 + cost."""
        return np.asarray(((self.costs - self.bounds) / (1 + self.costs)).max(axis=1))

    @classmethod
    def of(cls, problem: BoxProblem, solved: Solved) -> Self:
        """Return answers for affine muscles, whose residuals prove them but for some of an endpoint."""
        costs = problem.costs(solved.x)
        return cls(solved, None, costs, np.where(_proved(problem, solved), costs, 0.0))


def _proved(problem: BoxProblem, solved: Solved) -> Mask:
    """Return which levels (N, K) have the least cost: with more joints than coordinates, those of a hand too soft.

    There K_x is concave in the pressures, so no pressures give more along the missing stiffness.
    """
    hand, (_, ends) = problem.endpoint, problem.rows
    proved = np.ones((problem.size, len(ends)), bool)
    if hand is None or not hand.redundant:
        return proved
    for k, end in enumerate(ends.tolist()):
        proved[:, k] = hand.bounds_true(problem.direction(solved.mu[:, k, :end])) & (solved.rounds > 0)
    return proved


def solve(problem: BoxProblem, gap: float) -> Nearby:
    """Return pressures whose costs exceed the least by at most `gap`·(1 + cost), unless the search becomes too long.

    Raises `InvalidInput` for a force that does not rise with the pressure, or a law that is not smooth.
    """
    model = Model(problem)
    model.check()
    found, N = _descended(model), problem.size
    costs, bounds, nodes = found.costs[:, :-1].copy(), np.zeros((N, found.costs.shape[1] - 1)), np.ones(N, np.int64)
    for i in range(N):
        best = found.of(i)
        if _missed(model, i, best).any():
            best, bounds[i], nodes[i] = _closed(model, i, best, gap)
        found.P[i], costs[i] = best.P[0], best.costs[0, :-1]
    solved, residual = certified(model, found.P)
    return Nearby(solved._replace(rounds=nodes), residual, costs, np.minimum(bounds, costs))


def _descended(model: Model) -> Found:
    """Return the best of descents from the middle and from points beside it, muscles alternately high and low.

    A descent from the middle alone may end at a saddle: for a mechanism of equal muscles it keeps their symmetry.
    """
    every, (lo, hi) = np.arange(model.problem.size), model.bounds
    middle, in_turn = (lo + hi) / 2, np.where(np.arange(lo.shape[1]) % 2, 1.0, -1.0)
    last_two = np.where(np.arange(in_turn.size) >= in_turn.size - 2, in_turn, 0.0)
    found = descend(model, every, middle)
    for pattern in (in_turn, -in_turn, last_two, -last_two):
        other = descend(model, every, middle + _BESIDE * (hi - lo) * pattern)
        better = lower(model, every, other.costs, found.costs)
        for array, new in zip(found, other, strict=True):
            array[better] = new[better]
    return found


def _closed(model: Model, target: int, best: Found, gap: float) -> tuple[Found, Array, int]:
    """Return the best pressures of a target, the lower bounds of its levels (K,), and the number of nodes."""
    bounds, nodes = np.zeros(best.costs.shape[1] - 1), 0
    for k in range(bounds.size):
        if not _missed(model, target, best)[k]:
            continue
        better, bounds[k], more = close(model, target, k, best, gap)
        nodes += more
        if better is not best:
            best = descend(model, np.array([target]), better.P)
    return best, bounds, nodes


def _missed(model: Model, target: int, best: Found) -> NDArray[np.bool_]:
    """Return which levels (K,) of a target have an error above rounding."""
    ends = [0, *model.problem.rows[1].tolist()]
    error = np.array([np.abs(best.left[0, a:b]).max(initial=0.0) for a, b in pairwise(ends)])
    return np.asarray(error > CLOSED_FORM.met * model.scale[target])


def furthest(problem: BoxProblem, d: Array) -> Array:
    """Return an upper bound (N,) of d·y(P) over the box, for directions d (N, d)."""
    model = Model(problem)
    every = np.arange(problem.size)
    g = (d[:, None, :] @ (model.C if len(model.C) == 1 else model.C[model.posture(every)]))[:, 0]
    found = np.zeros(problem.size)
    for i, curves in enumerate(model.curves):
        here = np.flatnonzero(problem.which == i)
        for j, curve in enumerate(curves):
            corners = np.concatenate(list(curve.parts(_PARTS)))
            found[here] += (g[here, 2 * j : 2 * j + 2] @ corners.T).max(axis=1)
    return found
