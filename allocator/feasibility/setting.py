"""Joint with its limits at given angles and torques, and the intervals of feasible targets.

At one angle and one torque the feasible pairs of pressures form a piece of a torque level
(`allocator.joint.torque_levels`), and their stiffnesses an interval: a *column* of the feasible set. All results of
this package consist of columns.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.allocation.arguments import problem_from
from allocator.allocation.status import CLOSED_FORM
from allocator.allocation.two_muscles import reach
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array, Mask, Value, increasing_root
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint, joint_or_report
from allocator.joint.gas import HELD, ISOBARIC, Stiffness, StiffnessKind, of_a_joint
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.joint.limits import TAUT, Limits, checked_limits
from allocator.joint.torque_levels import Pair, torque_interval

_NO_TARGET = 1.0  # [N·m/rad] placeholder if no stiffness is requested


class Columns(NamedTuple):
    """Feasible stiffnesses at n angles and torques, each array (n,)."""

    problem: Problem
    low: Pair  # pressures of the least stiffness [Pa]
    high: Pair  # and of the greatest
    K_min: Array  # [N·m/rad]
    K_max: Array
    reach: Array  # margin of the torque within its interval, as a fraction of the torque scale; negative outside
    problem_high: Problem  # of the greatest stiffness, if its valves differ from those of the least

    @property
    def empty(self) -> Mask:
        """Whether the limits contradict each other."""
        return self.problem.box.empty

    @property
    def exists(self) -> Mask:
        """Whether there are allowed pressures that give the torque."""
        return np.asarray((self.reach >= -CLOSED_FORM.met) & ~self.empty)


@dataclass(frozen=True)
class Setting:
    """Joint and the requested limits beyond its supply and its angles, without a slew limit.

    Torques T are those beyond `gravity`, which the muscles balance as well.
    """

    joint: AntagonistJoint
    limits: Limits = TAUT
    kind: StiffnessKind = HELD  # kind of stiffness
    gravity: Gravity = NO_GRAVITY

    @classmethod
    def of(
        cls,
        joint: AntagonistJoint | None,
        limits: Limits = TAUT,
        stiffness: Stiffness = ISOBARIC,
        gravity: Gravity = NO_GRAVITY,
    ) -> Self:
        """Return the setting of these arguments of `allocate`, by default with the report's joint.

        Raises `InvalidInput` for a slew limit, a tolerance or an endpoint, which maps do not support.
        """
        joint = joint_or_report(joint)
        kind = of_a_joint(stiffness, joint.gas, joint.affine)
        if checked_limits(limits).previous is not None or limits.max_step is not None:
            raise InvalidInput("a slew limit belongs to one target; maps and intervals have none")
        if checks.not_negative("tolerance", stiffness.tolerance, "N·m/rad"):
            raise InvalidInput("a tolerance is for `allocate`; maps and intervals are of a joint's K")
        checks.instance("gravity", gravity, Gravity, "a Gravity")
        return cls(joint, limits, kind, gravity)

    @property
    def states(self) -> "tuple[Setting, ...]":
        """Settings to choose from: four if the valves are free, else this one."""
        return tuple(replace(self, kind=kind) for kind in self.kind.states)

    def problem(self, theta: Value, T: Value = 0.0, K: Value = _NO_TARGET) -> tuple[Problem, Array]:
        """Return the checked, flat problems (angles moved into the joint range), and the requested angles.

        Free valves are open, which leaves the widest choice of pressures and torques.
        """
        kind = self.states[0].kind
        felt = kind.secant(self.joint.loop) if kind.amplitude is not None else None
        T = T + self.gravity.moment(theta) if self.gravity.torque else T
        return problem_from(self.joint, theta, K, T, limits=self.limits, shares=kind.fixed, felt=felt)

    def columns(self, theta: Value, T: Value) -> Columns:
        """Return the columns at angles in the joint range, and at torques clipped to their range.

        With free valves they extend from the least to the greatest stiffness of all states, and may have gaps.
        """
        found = [columns(state.problem(theta, T)[0]) for state in self.states]
        return found[0] if len(found) == 1 else _united(found)

    def torque_margin(self, theta: Array, T: Array) -> Array:
        """Return the margin of T within its interval at θ, as a fraction of the torque scale; < 0 outside."""
        theta, T = np.broadcast_arrays(theta, T)
        found = self.columns(theta, T)
        return np.where(found.empty, -1.0, found.reach.ravel()).reshape(theta.shape)


def columns(problem: Problem) -> Columns:
    """Return the columns of the problems."""
    T_min, T_max = torque_interval(problem.sides, problem.box)
    scale = problem.scales[0]
    T = np.clip(problem.T, T_min, T_max)
    low, high = reach.stiffness_ends(problem, T)
    return Columns(
        problem,
        low,
        high,
        problem.stiffness(*low),
        problem.stiffness(*high),
        np.minimum(problem.T - T_min, T_max - problem.T) / scale,
        problem,
    )


def _united(found: list[Columns]) -> Columns:
    """Return the outermost ends of the columns of several states."""
    exists = np.stack([c.exists for c in found])
    lowest = np.where(exists, np.stack([c.K_min for c in found]), np.inf).argmin(axis=0)
    highest = np.where(exists, np.stack([c.K_max for c in found]), -np.inf).argmax(axis=0)

    def of(which: NDArray[np.intp], arrays: Iterable[Array]) -> Array:
        return np.asarray(np.take_along_axis(np.stack(list(arrays)), which[None], 0)[0])

    return Columns(
        with_states(found[0].problem, lowest),
        (of(lowest, (c.low[0] for c in found)), of(lowest, (c.low[1] for c in found))),
        (of(highest, (c.high[0] for c in found)), of(highest, (c.high[1] for c in found))),
        of(lowest, (c.K_min for c in found)),
        of(highest, (c.K_max for c in found)),
        np.stack([np.where(c.empty, -1.0, c.reach) for c in found]).max(axis=0),
        with_states(found[0].problem, highest),
    )


def with_states(problem: Problem, which: NDArray[np.intp]) -> Problem:
    """Return the problems with the valves in these states, by their numbers (n,)."""
    one, two = np.array(StiffnessKind.free)[which].T
    return replace(problem, shares=(one, two))


PIECES = 128


def lowest(f: Callable[..., Array], start: Array, end: Array, *args: Array, pieces: int) -> Array:
    """Return the x (n,) in [start, end] with the least f(x, *args), found among `pieces` and then refined.

    A minimum within one piece is missed.
    """
    from scipy.optimize import elementwise

    grid = start + (end - start) * np.linspace(0, 1, pieces + 1)[:, None]
    values = f(grid, *args)
    i = np.argmin(values, axis=0)
    x = np.take_along_axis(grid, i[None], 0)[0]
    between = (i > 0) & (i < pieces) & (end > start)
    if between.any():
        column = np.nonzero(between)[0]
        bracket = tuple(grid[i[between] + shift, column] for shift in (-1, 0, 1))
        found = elementwise.find_minimum(f, bracket, args=tuple(a[between] for a in args))
        x[between] = found.x
    return np.asarray(x)


def spans(
    margin: Callable[..., Array], left: float, right: float, *args: Array, pieces: int = PIECES
) -> tuple[Array, Array]:
    """Return starts and ends (m, n) of the intervals in [left, right] with margin(x, *args (n,)) ≥ 0, NaN where fewer.

    Exact if the intervals and the gaps between them are wider than one of the `pieces`. A single interval of any width
    is found if the margin rises towards it over more than a piece.
    """
    x = np.repeat(np.linspace(left, right, pieces + 1)[:, None], args[0].size, axis=1)
    inside = _refined(margin, x, args) >= 0
    outside = np.zeros((1, args[0].size), bool)
    entered = inside & ~np.vstack([outside, inside[:-1]])
    left_behind = inside & ~np.vstack([inside[1:], outside])
    starts = np.sort(_crossings(margin, x, entered, -1, args), axis=0)  # NaN goes last
    ends = np.sort(_crossings(margin, x, left_behind, +1, args), axis=0)
    most = int(entered.sum(axis=0).max(initial=0))
    return starts[:most], ends[:most]


def _refined(margin: Callable[..., Array], x: Array, args: tuple[Array, ...]) -> Array:
    """Return the margin at nodes x (pieces+1, n); if all are negative, move the best node to the margin's maximum."""
    values = margin(x, *args)
    missed = np.nonzero((values < 0).all(axis=0))[0]
    if missed.size:
        here = tuple(a[missed] for a in args)
        ends = x[0, missed], x[-1, missed]
        top = lowest(lambda x, *a: -margin(x, *a), *ends, *here, pieces=len(x) - 1)
        i = values[:, missed].argmax(axis=0)
        x[i, missed], values[i, missed] = top, margin(top, *here)
    return values


def _crossings(margin: Callable[..., Array], x: Array, flags: Mask, step: int, args: tuple[Array, ...]) -> Array:
    """Return the zeros of the margin between the flagged nodes of x (pieces+1, n) and their neighbours, else NaN.

    At the border of x, without a neighbour, the node itself.
    """
    found = np.full(x.shape, np.nan)
    i, column = np.nonzero(flags)
    inner, outer = x[i, column], x[np.clip(i + step, 0, len(x) - 1), column]
    root = increasing_root(
        lambda x, *a: -step * margin(x, *a),
        np.minimum(inner, outer),
        np.maximum(inner, outer),
        *(a[column] for a in args),
    )
    found[i, column] = np.where(inner == outer, inner, root)
    return found
