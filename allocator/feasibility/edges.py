"""Edges of the feasible set: curves in (θ, K, T), each labelled by the limit that binds along it.

The set is cut at a constant torque (edges over θ are the ends of the stiffness interval), a constant stiffness (the
ends of its torque interval) or a constant angle (edges over T are the ends of the stiffness interval).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import CLOSED_FORM
from allocator.allocation.two_muscles import reach
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.feasibility.setting import Columns, Setting, spans, with_states
from allocator.joint.limits import BINDS, names
from allocator.joint.torque_levels import Pair, torque, torque_interval

_POINTS = 201  # of an edge over the joint range; more where the binding limit changes
_COLUMNS = ("theta", "K", "T", "P1", "P2")
_HALVINGS = 40  # to locate such changes


@dataclass(frozen=True, eq=False)
class Edge:
    """Curve of n points on the border of the feasible set."""

    limits: int  # combination of Limit flags that bind along it
    theta: Array = field(repr=False)  # [rad] (n,)
    K: Array = field(repr=False)  # [N·m/rad] (n,)
    T: Array = field(repr=False)  # [N·m] (n,)
    P1: Array = field(repr=False)  # [Pa] (n,)
    P2: Array = field(repr=False)  # [Pa] (n,)
    part: int = 0  # number of the connected part of the set that it bounds, from the left

    @property
    def active(self) -> tuple[str, ...]:
        """Limits by name."""
        return names(self.limits)


End = tuple[Problem, Pair]
Ends = Callable[[Array], tuple[End, End]]
"""From angles (or torques) to the problems and the pressures at both ends of the feasible interval there."""


def edges_at_torque(setting: Setting, T: float, left: float, right: float) -> tuple[Edge, ...]:
    """Return the edges of the feasible stiffnesses at the torque T [N·m] over the angles from left to right [rad]."""

    def ends(theta: Array) -> tuple[End, End]:
        return _column_ends(setting.columns(theta, T))

    return _edges(setting, ends, spans(setting.torque_margin, left, right, np.array([T])))


def edges_at_stiffness(setting: Setting, K: float, left: float, right: float) -> tuple[Edge, ...]:
    """Return the edges of the feasible torques at the stiffness K over the angles from left to right [rad].

    On a lever the torques may fall into several intervals (`torque_intervals`); the outermost ends are drawn.
    """

    def ends(theta: Array) -> tuple[End, End]:
        problems = [state.problem(theta, 0.0, K)[0] for state in setting.states]
        found = [reach.torque_ends(problem, problem.K) for problem in problems]
        if len(found) == 1:
            return (problems[0], found[0][0]), (problems[0], found[0][1])
        return _outermost(problems, found, np.stack([_stiffness_margin(problem) for problem in problems]))

    def margin(theta: Array, K: Array) -> Array:
        theta, K = np.broadcast_arrays(theta, K)
        states = (state.problem(theta.ravel(), 0.0, K.ravel())[0] for state in setting.states)
        return np.asarray(np.stack([_stiffness_margin(problem) for problem in states]).max(axis=0).reshape(theta.shape))

    return _edges(setting, ends, spans(margin, left, right, np.array([K])))


def edges_at_angle(setting: Setting, theta: float) -> tuple[Edge, ...]:
    """Return the edges of the feasible stiffnesses at the angle theta [rad] over the torques.

    If the determinant keeps its sign, these are the image of the border of the box. On a lever an edge may also be a
    fold, where the stiffness turns and no limit binds.
    """
    problem, _ = setting.problem(np.array([theta]))
    if problem.box.empty[0]:
        return ()

    def ends(T: Array) -> tuple[End, End]:
        return _column_ends(setting.columns(np.full(T.shape, theta), T))

    T_min, T_max = (float(T[0]) for T in torque_interval(problem.sides, problem.box))
    torques = np.linspace(T_min, T_max, _POINTS) - setting.gravity.moment(theta)
    return tuple(edge for end in (0, 1) for edge in _chain(setting, ends, end, torques))


def _column_ends(found: Columns) -> tuple[End, End]:
    return (found.problem, found.low), (found.problem_high, found.high)


def _stiffness_margin(problem: Problem) -> Array:
    """Return the margin of the stiffness of `problem` within the range over all torques, in fractions of the scale."""
    K_min, K_max = (problem.stiffness(*pair) for pair in reach.stiffness_range(problem))
    inside = np.minimum(K_max - problem.K, problem.K - K_min)
    return np.asarray(np.where(problem.box.empty, -1.0, inside / problem.scales[1]))


def _outermost(problems: list[Problem], found: list[tuple[Pair, Pair]], margins: Array) -> tuple[End, End]:
    """Return the least and the greatest torques over the states of the valves that have the stiffness."""
    reached = margins >= np.minimum(margins.max(axis=0), -CLOSED_FORM.met)
    chosen = []
    for end, sign in ((0, 1.0), (1, -1.0)):
        T = np.stack([torque(problem.sides, pairs[end]) for problem, pairs in zip(problems, found, strict=True)])
        which = np.where(reached, sign * T, np.inf).argmin(axis=0)
        P1, P2 = (np.take_along_axis(np.stack([p[end][i] for p in found]), which[None], 0)[0] for i in (0, 1))
        chosen.append((with_states(problems[0], which), (P1, P2)))
    return chosen[0], chosen[1]


# --- from the ends of an interval over θ (or T) to edges ------------------------------------------------------------


def _edges(setting: Setting, ends: Ends, intervals: tuple[Array, Array]) -> tuple[Edge, ...]:
    """Return the edges over the nonempty intervals of angles (m, 1)."""
    found: list[Edge] = []
    for part, (a, b) in enumerate(zip(*intervals, strict=True)):
        left, right = float(a[0]), float(b[0])
        theta = np.unique(np.append(np.linspace(left, right, _POINTS), np.clip(0.0, left, right)))
        bounds = [edge for end in (0, 1) for edge in _chain(setting, ends, end, theta)]
        bounds += [edge for at in (left, right) if (edge := _wall(setting, ends, at))]
        found += [replace(edge, part=part) for edge in bounds]
    return tuple(found)


def _chain(setting: Setting, ends: Ends, end: int, x: Array) -> list[Edge]:
    """Return one end of the interval over the angles or torques x, cut where the binding limit changes."""

    def flags(x: Array) -> NDArray[np.int32]:
        problem, pair = ends(x)[end]
        return problem.box.binding(*pair, BINDS * setting.joint.pressure_span)

    middle = (x[1:] + x[:-1]) / 2
    change = np.nonzero(np.diff(flags(middle)))[0]
    cuts = _handovers(flags, middle[change], middle[change + 1])
    x = np.unique(np.concatenate([x, cuts]))
    stops = [x[0], *cuts, x[-1]]
    edges = []
    for a, b in pairwise(stops):
        part = x[(x >= a) & (x <= b)]
        if len(part) > 1:
            widest = int(np.argmax(np.diff(part)))  # a change is within rounding of both limits
            limits = int(flags(part[widest : widest + 2].mean(keepdims=True))[0])
            edges.append(_edge(setting, limits, ends(part)[end]))
    return edges


def _handovers(flags: Callable[[Array], NDArray[np.int32]], left: Array, right: Array) -> Array:
    """Return the points between left and right (n,) where the flags change, by bisection."""
    before = flags(left)
    for _ in range(_HALVINGS):
        middle = (left + right) / 2
        same = flags(middle) == before
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return (left + right) / 2


def _wall(setting: Setting, ends: Ends, theta: float) -> Edge | None:
    """Return the edge at an end of the joint range, from one end of the interval to the other."""
    range_ends = setting.joint.angle_range
    if theta not in range_ends:
        return None
    limits = int(setting.joint.angle_limit(theta == range_ends[1]))
    low, high = (_edge(setting, limits, end) for end in ends(np.array([theta])))
    angles, K, T, P1, P2 = (np.append(getattr(low, name), getattr(high, name)) for name in _COLUMNS)
    return Edge(limits, angles, K, T, P1, P2)


def _edge(setting: Setting, limits: int, end: End) -> Edge:
    """Return the edge through these pressures."""
    problem, pair = end
    T = torque(problem.sides, pair) - setting.gravity.moment(problem.theta)
    return Edge(limits, problem.theta, problem.stiffness(*pair), T, *pair)
