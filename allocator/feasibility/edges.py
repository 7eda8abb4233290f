"""The edges of the feasible set as curves in (θ, K, T), each labelled by the limit that binds along it.

Three ways to cut the set, by what is held: a torque (edges over θ are the ends of the stiffness interval), a stiffness
(the ends of the torque interval at it) and an angle (the image of the border of the pressure box).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from allocator.allocation import reach
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.feasibility.setting import Setting
from allocator.feasibility.spans import spans
from allocator.levels import Pair, stiffness
from allocator.limits import Limit, PressureBox, names

_POINTS = 201  # of an edge over the joint range; more where limits hand over
_HALVINGS = 40  # to find where they do
_BINDS = 1e-9  # of the supply range, as in `allocate`


@dataclass(frozen=True, eq=False)
class Edge:
    """A curve of n points on the border of the feasible set."""

    limits: int  # combination of Limit flags that bind along it
    theta: Array = field(repr=False)  # [rad] (n,)
    K: Array = field(repr=False)  # [N·m/rad] (n,)
    T: Array = field(repr=False)  # [N·m] (n,)
    P1: Array = field(repr=False)  # [Pa] (n,)
    P2: Array = field(repr=False)  # [Pa] (n,)
    part: int = 0  # which of the connected parts of the set it bounds, counted from the left

    @property
    def active(self) -> tuple[str, ...]:
        """The limits by name."""
        return names(self.limits)


Ends = Callable[[Array], tuple[Problem, tuple[Pair, Pair]]]
"""From angles to the problems there and the pressures at both ends of the feasible interval."""


def edges_at_torque(setting: Setting, T: float, left: float, right: float) -> tuple[Edge, ...]:
    """Edges over the angles from left to right [rad] of the stiffnesses that exist while the joint gives T [N·m]."""

    def ends(theta: Array) -> tuple[Problem, tuple[Pair, Pair]]:
        found = setting.columns(theta, T)
        return found.problem, (found.low, found.high)

    def margin(theta: Array, T: Array) -> Array:
        theta, T = np.broadcast_arrays(theta, T)
        found = setting.columns(theta, T)
        return np.where(found.problem.box.empty, -1.0, found.reach.ravel()).reshape(theta.shape)

    return _edges(setting, ends, spans(margin, left, right, np.array([T])))


def edges_at_stiffness(setting: Setting, K: float, left: float, right: float) -> tuple[Edge, ...]:
    """Edges over the angles from left to right [rad] of the torques that exist while the joint is as stiff as K.

    On a lever the torques may fall into several intervals (`torque_intervals`); the outermost ends are drawn.
    """

    def ends(theta: Array) -> tuple[Problem, tuple[Pair, Pair]]:
        problem, _ = setting.problem(theta, 0.0, K)
        return problem, reach.torque_ends(problem, problem.K)

    def margin(theta: Array, K: Array) -> Array:
        theta, K = np.broadcast_arrays(theta, K)
        problem, _ = setting.problem(theta.ravel(), 0.0, K.ravel())
        K_min, K_max = (stiffness(problem.sides, pair) for pair in reach.stiffness_range(problem))
        inside = np.minimum(K_max - problem.K, problem.K - K_min)
        return np.where(problem.box.empty, -1.0, inside / problem.scales[1]).reshape(theta.shape)

    return _edges(setting, ends, spans(margin, left, right, np.array([K])))


def edges_at_angle(setting: Setting, theta: float) -> tuple[Edge, ...]:
    """Edges of the torques and stiffnesses that exist at the angle theta [rad]: the image of the border of the box."""
    problem, _ = setting.problem(np.array([theta]))
    if problem.box.empty[0]:
        return ()
    found = []
    for limits, pair in _border(problem.box, points=_POINTS):
        P1, P2 = (P[:, 0] for P in np.broadcast_arrays(*pair))
        if np.ptp(P1) + np.ptp(P2) > _BINDS * setting.joint.pressure_span:
            found.append(_edge(setting, int(limits[0]), np.full(P1.shape, theta), (P1, P2)))
    return tuple(found)


def _border(box: PressureBox, points: int) -> list[tuple[NDArray[np.int32], Pair]]:
    """Its edges by their Limit flags (n,), each as pressures (points, n) and the one held as (1, n)."""
    share = np.linspace(0, 1, points)[:, None]
    (lo1, hi1), (lo2, hi2) = ((side.lo[None], side.hi[None]) for side in box)
    floor = np.broadcast_to(box.least_sum, lo1.shape)
    start1, start2 = np.maximum(lo1, floor - hi2), np.maximum(lo2, floor - hi1)

    def along(start: Array, end: Array) -> Array:
        return start + share * np.maximum(end - start, 0.0)

    edges = [
        (box.agonist.lo_limit, (lo1, along(np.maximum(lo2, floor - lo1), hi2))),
        (box.antagonist.hi_limit, (along(start1, hi1), hi2)),
        (box.agonist.hi_limit, (hi1, along(start2, hi2))),
        (box.antagonist.lo_limit, (along(np.maximum(lo1, floor - lo2), hi1), lo2)),
    ]
    if box.has_floor:
        left, right = box.floor_segment
        P1 = along(left[None], np.maximum(left, right)[None])
        edges.append((np.full(lo1.shape[1], Limit.COCONTRACTION, np.int32), (P1, floor - P1)))
    return edges


# --- from the ends of an interval over θ to edges -------------------------------------------------------------------


def _edges(setting: Setting, ends: Ends, intervals: tuple[Array, Array]) -> tuple[Edge, ...]:
    """The edges over the intervals of angles (m, 1) in which there is anything."""
    found: list[Edge] = []
    for part, (a, b) in enumerate(zip(*intervals, strict=True)):
        left, right = float(a[0]), float(b[0])
        theta = np.unique(np.append(np.linspace(left, right, _POINTS), np.clip(0.0, left, right)))
        bounds = [edge for end in (0, 1) for edge in _chain(setting, ends, end, theta)]
        bounds += [edge for at in (left, right) if (edge := _wall(setting, ends, at))]
        found += [replace(edge, part=part) for edge in bounds]
    return tuple(found)


def _chain(setting: Setting, ends: Ends, end: int, theta: Array) -> list[Edge]:
    """One end of the interval over the angles, cut where another limit takes over."""

    def flags(theta: Array) -> NDArray[np.int32]:
        problem, pairs = ends(theta)
        return problem.box.binding(*pairs[end], _BINDS * setting.joint.pressure_span)

    middle = (theta[1:] + theta[:-1]) / 2
    change = np.nonzero(np.diff(flags(middle)))[0]
    cuts = _handovers(flags, middle[change], middle[change + 1])
    theta = np.unique(np.concatenate([theta, cuts]))
    stops = [theta[0], *cuts, theta[-1]]
    edges = []
    for a, b in pairwise(stops):
        part = theta[(theta >= a) & (theta <= b)]
        if len(part) > 1:
            widest = int(np.argmax(np.diff(part)))  # a hand-over is within rounding of both limits
            limits = int(flags(part[widest : widest + 2].mean(keepdims=True))[0])
            edges.append(_edge(setting, limits, part, ends(part)[1][end]))
    return edges


def _handovers(flags: Callable[[Array], NDArray[np.int32]], left: Array, right: Array) -> Array:
    """Where between left and right (n,) the flags change, by bisection."""
    before = flags(left)
    for _ in range(_HALVINGS):
        middle = (left + right) / 2
        same = flags(middle) == before
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return (left + right) / 2


def _wall(setting: Setting, ends: Ends, theta: float) -> Edge | None:
    """The edge at an end of the joint range, from one end of the interval to the other."""
    range_ends = setting.joint.angle_range
    if theta not in range_ends:
        return None
    _, ((P1_low, P2_low), (P1_high, P2_high)) = ends(np.array([theta]))
    share = np.linspace(0, 1, 2)
    pair = P1_low + share * (P1_high - P1_low), P2_low + share * (P2_high - P2_low)
    return _edge(setting, int(setting.joint.angle_limit(theta == range_ends[1])), np.full(2, theta), pair)


def _edge(setting: Setting, limits: int, theta: Array, pair: Pair) -> Edge:
    """The edge through these pressures."""
    sides = setting.joint.sides(theta)
    one, two = sides
    return Edge(limits, theta, stiffness(sides, pair), one.torque(pair[0]) + two.torque(pair[1]), *pair)


__all__ = ["Edge", "edges_at_angle", "edges_at_stiffness", "edges_at_torque"]
