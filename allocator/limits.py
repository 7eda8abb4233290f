"""The limits of a joint by name, and the pressure interval that they leave to a muscle."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array


class Limit(IntFlag):
    """A limit that may bind; combinations are kept as one integer per target, so that a million fit in 4 MB."""

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
        """Name as it is printed: "P1 upper", "agonist slack", …"""
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
    """The names of all limits in the combination `limits`."""
    return tuple(limit.text for limit in Limit(int(limits)))


@dataclass(frozen=True)
class PressureInterval:
    """The pressures [Pa] that one muscle may have, and which limit sets each end. Arrays of one shape."""

    lo: Array
    hi: Array
    lo_limit: NDArray[np.int32]  # Limit flags
    hi_limit: NDArray[np.int32]
    empty: NDArray[np.bool_]  # the limits contradict each other: lo = hi = the upper one

    def map(self, function: Callable[[Any], Any]) -> "PressureInterval":
        """The same with `function` applied to every array."""
        return PressureInterval(*(function(getattr(self, field.name)) for field in fields(self)))

    def contains(self, P: Array, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Whether `P` lies inside, up to `tolerance` [Pa]; NaN does not."""
        return (P >= self.lo - tolerance) & (P <= self.hi + tolerance)

    def within_reach(self, previous: Array, max_step: Array | float, rate: Limit) -> "PressureInterval":
        """Narrow to previous ± max_step. Moving is a hard limit: from outside, what is nearest in reach remains."""
        nearest, farthest = previous - max_step, previous + max_step
        lo_limit = np.where((nearest > self.lo) | (farthest < self.lo), rate, self.lo_limit)
        hi_limit = np.where((farthest < self.hi) | (nearest > self.hi), rate, self.hi_limit)
        lo, hi = np.clip(self.lo, nearest, farthest), np.clip(self.hi, nearest, farthest)
        return PressureInterval(lo, hi, lo_limit.astype(np.int32), hi_limit.astype(np.int32), self.empty)

    def binding(self, P: Array, tolerance: float) -> NDArray[np.int32]:
        """Flags of the ends that `P` lies on or beyond, up to `tolerance` [Pa]."""
        low = np.where(P <= self.lo + tolerance, self.lo_limit, 0)
        high = np.where(P >= self.hi - tolerance, self.hi_limit, 0)
        return np.asarray(low | high, np.int32)


@dataclass(frozen=True)
class PressureBox:
    """All pressure limits of the joint at an angle: one interval a muscle, and possibly a floor on their sum."""

    agonist: PressureInterval
    antagonist: PressureInterval
    least_sum: Array | float = -np.inf  # P1 + P2 ≥ this [Pa], the co-contraction floor, which cuts a corner off

    def __iter__(self) -> Iterator[PressureInterval]:
        """Agonist, antagonist."""
        return iter((self.agonist, self.antagonist))

    def map(self, function: Callable[[Any], Any]) -> "PressureBox":
        """The same with `function` applied to every array."""
        least_sum = function(np.broadcast_to(self.least_sum, self.agonist.lo.shape))
        return PressureBox(self.agonist.map(function), self.antagonist.map(function), least_sum)

    def with_least_sum(self, least_sum: Array) -> "PressureBox":
        """Add a floor on P1 + P2; where not even the upper ends reach it the box shrinks to them."""
        missed = self.agonist.hi + self.antagonist.hi < least_sum

        def at_most(interval: PressureInterval) -> PressureInterval:
            lo = np.where(missed, interval.hi, interval.lo)
            return replace(interval, lo=lo, empty=interval.empty | missed)

        floor = np.where(missed, self.agonist.hi + self.antagonist.hi, least_sum)
        return PressureBox(at_most(self.agonist), at_most(self.antagonist), floor)

    @property
    def empty(self) -> NDArray[np.bool_]:
        """Where limits contradict each other."""
        return self.agonist.empty | self.antagonist.empty

    def contains(self, P1: Array, P2: Array, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Whether (P1, P2) satisfies all limits, up to `tolerance` [Pa]."""
        inside = self.agonist.contains(P1, tolerance) & self.antagonist.contains(P2, tolerance)
        return inside & (P1 + P2 >= self.least_sum - tolerance)

    def binding(self, P1: Array, P2: Array, tolerance: float) -> NDArray[np.int32]:
        """Flags of the limits that (P1, P2) lies on or beyond, up to `tolerance` [Pa]."""
        limits = self.agonist.binding(P1, tolerance) | self.antagonist.binding(P2, tolerance)
        on_floor = P1 + P2 <= self.least_sum + tolerance
        return limits | np.where(on_floor, np.int32(Limit.COCONTRACTION), np.int32(0))

    @property
    def has_floor(self) -> bool:
        """Whether there is a co-contraction floor."""
        return bool(np.isfinite(self.least_sum).any())

    @property
    def floor_segment(self) -> tuple[Array, Array]:
        """P1 at both ends of the edge P1 + P2 = least_sum; where there is no such edge the first is the greater."""
        (lo1, hi1), (lo2, hi2) = ((side.lo, side.hi) for side in self)
        return np.maximum(lo1, self.least_sum - hi2), np.minimum(hi1, self.least_sum - lo2)

    def project(self, P1: Array, P2: Array) -> tuple[Array, Array]:
        """The nearest point that satisfies all limits."""
        Q1, Q2 = np.clip(P1, self.agonist.lo, self.agonist.hi), np.clip(P2, self.antagonist.lo, self.antagonist.hi)
        left, right = self.floor_segment
        on_floor = np.clip((P1 - P2 + self.least_sum) / 2, left, np.maximum(left, right))
        cut = Q1 + Q2 < self.least_sum
        return np.where(cut, on_floor, Q1), np.where(cut, self.least_sum - on_floor, Q2)


__all__ = ["Limit", "PressureBox", "PressureInterval", "names"]
