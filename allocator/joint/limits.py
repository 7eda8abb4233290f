"""Limits of a joint: their names, the limits on muscles, and the allowed pressures.

`Limit` names the limits that may bind, `Limits` holds the caller's limits beyond supply and joint range, `PressureBox`
the pressures that both allow at an angle.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import IntFlag
from functools import reduce
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array, Mask, Value
from allocator.errors import InvalidInput
from allocator.units import BAR

COMMON_FORCE = "a force common to both muscles"
PRIOR_FORCE = f"{COMMON_FORCE}, which is that of a prior"
UNSEEN = (COMMON_FORCE, PRIOR_FORCE)
"""Quantities that a joint's fit may fail to identify; the pressures at which cables go slack are then assumed."""

BINDS = 1e-9  # of the supply range: a pressure nearer to a bound lies on it


class Limit(IntFlag):
    """Limit that may bind. Combinations are stored as one integer per target (4 MB for a million targets)."""

    P1_LOWER = 1
    P1_UPPER = 2
    P2_LOWER = 4
    P2_UPPER = 8
    AGONIST_SLACK = 16
    ANTAGONIST_SLACK = 32
    P1_RATE = 64
    P2_RATE = 128
    AGONIST_VALIDITY = 256
    ANTAGONIST_VALIDITY = 512
    JOINT_RANGE = 1024
    CONTRACTION_THRESHOLD = 2048
    AGONIST_FORCE = 4096
    ANTAGONIST_FORCE = 8192
    COCONTRACTION = 16384

    @property
    def text(self) -> str:
        """Printed name: "P1 upper", "agonist slack", …"""
        return _TEXT[self]


_TEXT = {
    Limit.P1_LOWER: "P1 lower",
    Limit.P1_UPPER: "P1 upper",
    Limit.P2_LOWER: "P2 lower",
    Limit.P2_UPPER: "P2 upper",
    Limit.AGONIST_SLACK: "agonist slack",
    Limit.ANTAGONIST_SLACK: "antagonist slack",
    Limit.P1_RATE: "P1 rate",
    Limit.P2_RATE: "P2 rate",
    Limit.AGONIST_VALIDITY: "agonist model validity",
    Limit.ANTAGONIST_VALIDITY: "antagonist model validity",
    Limit.JOINT_RANGE: "joint range",
    Limit.CONTRACTION_THRESHOLD: "contraction threshold",
    Limit.AGONIST_FORCE: "agonist force ceiling",
    Limit.ANTAGONIST_FORCE: "antagonist force ceiling",
    Limit.COCONTRACTION: "co-contraction floor",
}


def names(limits: int) -> tuple[str, ...]:
    """Return the names of all limits in the combination `limits`."""
    return tuple(limit.text for limit in Limit(int(limits)))


class Limits(NamedTuple):
    """Limits on muscle forces and pressures, in addition to the machine's supply and joint range.

    Of a mechanism the forces may be rows (m,), and the present pressures an array (…, m). A named tuple for speed.
    """

    min_force: Value = 0.0  # least muscle force [N]; 0 keeps cables taut, None allows slack
    max_force: Value = None  # greatest muscle force [N]
    min_cocontraction: float | None = None  # least mean pressure (P1 + P2)/2 [Pa]
    previous: Value = None  # slew limit: the present pressure of each muscle [Pa] …
    max_step: Value = None  # … and the greatest change of each [Pa]; numbers, or arrays (n,) of n targets

    @property
    def without_forces(self) -> Self:
        """Limits without those on the forces."""
        return self._replace(min_force=None, max_force=None)

    def reach(self, muscle: int) -> tuple[Value, Value]:
        """Return the pressures [Pa] between which `muscle` (0, 1, …) may move; infinite without a slew limit."""
        if self.previous is None or self.max_step is None:
            return -np.inf, np.inf
        return self.previous[muscle] - self.max_step, self.previous[muscle] + self.max_step

    def take(self, where: object) -> Self:
        """Return the limits of the targets at the mask, the indices or the slice `where`."""
        if self.previous is None or self.max_step is None:
            return self
        return self._replace(previous=tuple(P[where] for P in self.previous), max_step=self.max_step[where])


TAUT = Limits()  # the default: only taut cables


_MOST = 1e3 * BAR  # [Pa] greater pressures are no supply of muscles


def checked_supply(limits: object) -> tuple[float, float]:
    """Return the pressures (low, high) [Pa] of a supply. Raises InvalidInput."""
    checks.pressure("pressure_limits", limits)
    low, high = checks.limits("pressure_limits", limits, "Pa")
    if not 0 <= low < high:
        raise InvalidInput(f"pressure_limits = ({low:g}, {high:g}) Pa have to satisfy 0 <= lower < upper")
    if high > _MOST:
        raise InvalidInput(f"pressure_limits[1] = {high:g} Pa is over {_MOST / BAR:g} bar; limits are in pascal")
    return low, high


def checked_contraction(value: object) -> float:
    """Return the least contraction ratio of a cable that is taut. Raises InvalidInput."""
    return float(checks.contraction("min_contraction", checks.number("min_contraction", value, "ratio")))


def checked_limits(limits: object) -> Limits:
    """Return `limits`. Raises InvalidInput unless they are `Limits`."""
    if not isinstance(limits, Limits):
        raise InvalidInput(f"limits = {checks.brief(limits)} have to be Limits, such as Limits(min_force=20.0)")
    return limits


Bound = tuple[Array, Limit]
"""A pressure [Pa] and the limit that lies there."""


@dataclass(frozen=True)
class PressureInterval:
    """Allowed pressures [Pa] of one muscle, and the limits that set each end, in arrays.

    If no pressure satisfies all limits, lo = hi is the compromise, and `broken` has the violated limits. The slew limit
    has the highest priority, then the supply's lower end, then the upper ends, then the least force.
    """

    lo: Array
    hi: Array
    lo_limit: NDArray[np.int32]  # Limit flags at `lo`
    hi_limit: NDArray[np.int32]
    broken: NDArray[np.int32]  # those violated by all of [lo, hi]
    empty: NDArray[np.bool_]  # the limits other than the slew limit contradict each other
    unreachable: NDArray[np.bool_]  # the slew limit excludes all pressures that supply, model and greatest force allow

    @classmethod
    def between(cls, floors: list[Bound], ceilings: list[Bound], reach: tuple[Bound, Bound], near: float) -> Self:
        """Return the pressures above all `floors`, the supply's first, and below all `ceilings`.

        `reach` is the interval of the slew limit, infinite without one; limits within `near` [Pa] of each other count
        as equal.
        """
        floor, ceiling = (
            reduce(choice, [P for P, _ in bounds]) for choice, bounds in ((np.maximum, floors), (np.minimum, ceilings))
        )
        (supply, _), ((nearest, _), (farthest, _)) = floors[0], reach
        most = np.maximum(ceiling, supply)
        lo, hi = np.clip(np.minimum(floor, most), nearest, farthest), np.clip(most, nearest, farthest)
        bounds = [*floors, *ceilings, *reach]
        return cls(
            lo,
            hi,
            lo_limit=_flags((np.abs(P - lo) <= near, limit) for P, limit in bounds),
            hi_limit=_flags((np.abs(P - hi) <= near, limit) for P, limit in bounds),
            broken=_flags((P > hi + near, limit) for P, limit in floors)
            | _flags((P < lo - near, limit) for P, limit in ceilings),
            empty=(floor > most + near) | (ceiling < supply - near),
            unreachable=(nearest > most + near) | (farthest < supply - near),
        )

    @property
    def slack(self) -> Mask:
        """Whether no allowed pressure gives the least force."""
        return np.asarray(self.broken & (Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK) != 0)

    def contains(self, P: Array, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Return whether `P` lies inside, up to `tolerance` [Pa]; NaN does not."""
        return (P >= self.lo - tolerance) & (P <= self.hi + tolerance)

    def binding(self, P: Array, tolerance: float) -> NDArray[np.int32]:
        """Return the flags of the ends that `P` lies on or beyond, up to `tolerance` [Pa]."""
        low, high = self.lo + tolerance >= P, self.hi - tolerance <= P
        return np.asarray(np.where(low, self.lo_limit, 0) | np.where(high, self.hi_limit, 0), np.int32)

    def not_kept(self, P: Array, tolerance: float) -> NDArray[np.int32]:
        """Return the flags of the limits that `P` violates by more than `tolerance` [Pa]."""
        low, high = self.lo - tolerance > P, self.hi + tolerance < P
        left = np.where(self.contains(P, tolerance), self.broken, 0)
        return np.asarray(np.where(low, self.lo_limit, 0) | np.where(high, self.hi_limit, 0) | left, np.int32)


def _flags(held: Iterable[tuple[Mask, Limit]]) -> NDArray[np.int32]:
    """Return the flags of the limits that apply, combined."""
    return np.asarray(reduce(np.bitwise_or, [np.where(which, np.int32(limit), 0) for which, limit in held]), np.int32)


@dataclass(frozen=True)
class PressureBox:
    """Pressures allowed at an angle: one interval per muscle, and an optional floor on their sum."""

    agonist: PressureInterval
    antagonist: PressureInterval
    least_sum: Array | float = -np.inf  # P1 + P2 ≥ this [Pa], the co-contraction floor, which cuts off a corner

    def __iter__(self) -> Iterator[PressureInterval]:
        """Yield agonist and antagonist."""
        return iter((self.agonist, self.antagonist))

    def with_least_sum(self, least_sum: Array) -> "PressureBox":
        """Add a floor on P1 + P2; if the upper ends do not reach it, the box shrinks to them."""
        missed = self.agonist.hi + self.antagonist.hi < least_sum

        def at_most(interval: PressureInterval) -> PressureInterval:
            lo, lo_limit = (
                np.where(missed, high, low)
                for low, high in ((interval.lo, interval.hi), (interval.lo_limit, interval.hi_limit))
            )
            broken = interval.broken | np.where(missed, np.int32(Limit.COCONTRACTION), 0)
            return replace(interval, lo=lo, lo_limit=lo_limit, broken=broken, empty=interval.empty | missed)

        floor = np.where(missed, self.agonist.hi + self.antagonist.hi, least_sum)
        return PressureBox(at_most(self.agonist), at_most(self.antagonist), floor)

    @property
    def empty(self) -> NDArray[np.bool_]:
        """Whether limits contradict each other."""
        return self.agonist.empty | self.antagonist.empty

    def contains(self, P1: Array, P2: Array, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Return whether (P1, P2) satisfies all limits, up to `tolerance` [Pa]."""
        inside = self.agonist.contains(P1, tolerance) & self.antagonist.contains(P2, tolerance)
        return inside & (P1 + P2 >= self.least_sum - tolerance)

    def binding(self, P1: Array, P2: Array, tolerance: float) -> NDArray[np.int32]:
        """Return the flags of the limits that (P1, P2) lies on or beyond, up to `tolerance` [Pa]."""
        limits = self.agonist.binding(P1, tolerance) | self.antagonist.binding(P2, tolerance)
        on_floor = P1 + P2 <= self.least_sum + tolerance
        return limits | np.where(on_floor, np.int32(Limit.COCONTRACTION), np.int32(0))

    def not_kept(self, P1: Array, P2: Array, tolerance: float) -> NDArray[np.int32]:
        """Return the flags of the limits that (P1, P2) violates by more than `tolerance` [Pa]."""
        limits = self.agonist.not_kept(P1, tolerance) | self.antagonist.not_kept(P2, tolerance)
        under_floor = P1 + P2 < self.least_sum - tolerance
        return limits | np.where(under_floor, np.int32(Limit.COCONTRACTION), np.int32(0))

    @property
    def has_floor(self) -> bool:
        """Whether there is a co-contraction floor."""
        return bool(np.isfinite(self.least_sum).any())

    @property
    def floor_segment(self) -> tuple[Array, Array]:
        """P1 at both ends of the edge P1 + P2 = least_sum; without such an edge the first is the greater."""
        (lo1, hi1), (lo2, hi2) = ((side.lo, side.hi) for side in self)
        return np.maximum(lo1, self.least_sum - hi2), np.minimum(hi1, self.least_sum - lo2)

    def project(self, P1: Array, P2: Array) -> tuple[Array, Array]:
        """Return the nearest point that satisfies all limits."""
        Q1, Q2 = np.clip(P1, self.agonist.lo, self.agonist.hi), np.clip(P2, self.antagonist.lo, self.antagonist.hi)
        left, right = self.floor_segment
        on_floor = np.clip((P1 - P2 + self.least_sum) / 2, left, np.maximum(left, right))
        cut = Q1 + Q2 < self.least_sum
        return np.where(cut, on_floor, Q1), np.where(cut, self.least_sum - on_floor, Q2)
