"""Lateness is how long after its deadline a sample began; a loop is judged by its distribution."""

from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array


class Lateness(NamedTuple):
    """The figures say how late the samples of a loop were, in seconds."""

    median: float  # [s]
    p99: float  # 99 % of the samples began no later [s]
    worst: float  # [s]
    late: int  # samples that began later than a tenth of the sample time
    missed: int  # samples that were left out, being over before they could begin
    samples: int

    @classmethod
    def of(cls, late: Array, missed: Array, dt: float) -> Self:
        """Return the figures of how `late` (n,) [s] samples of `dt` [s] were, and of how many were `missed` (n,)."""
        if not late.size:
            return cls(0.0, 0.0, 0.0, 0, 0, 0)
        median, p99 = np.percentile(late, [50, 99]).tolist()
        return cls(median, p99, float(late.max()), int((late > dt / 10).sum()), int(missed.sum()), late.size)

    def __str__(self) -> str:
        """Say it in one line."""
        return (
            f"lateness {1e3 * self.median:.3f} ms median, {1e3 * self.p99:.3f} ms for 99 %, {1e3 * self.worst:.2f} ms "
            f"at worst; {self.late} of {self.samples} samples late by over a tenth of one, {self.missed} missed"
        )
