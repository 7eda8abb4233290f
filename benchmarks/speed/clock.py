"""Ratios of times, measured in turns so that what else the machine does falls on both.

The time is the processor's, which does not run while others have the processor; the wall's where threads are compared.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import nan

import numpy as np

MISSED = "missed"  # ends a note on what was asked for in vain
Work = Callable[[], object]


@dataclass(frozen=True)
class Measurement:
    """One figure: `what` against `rival`. Ratios are times of the rival over times of `what`: more is faster."""

    part: str
    what: str
    seconds: float  # of one `unit`; median
    unit: str  # "target", "call", "process", …
    rival: str = ""
    rival_seconds: float = nan
    ratio: float = nan  # median over the rounds
    low: float = nan  # its quartiles
    high: float = nan
    wanted: float = nan  # the ratio that was asked for
    floor: float = nan  # less than this is a failure where floors are asked for
    note: str = ""

    @property
    def missed(self) -> bool:
        """Whether it is slower than was asked for."""
        return bool(self.ratio < self.wanted)

    @property
    def below_its_floor(self) -> bool:
        """Whether it is slower than it may be."""
        return bool(self.ratio < self.floor)


def seconds(work: Work, repeats: int = 1, clock: Callable[[], float] = time.process_time) -> float:
    """One measurement of the time that `work` takes."""
    start = clock()
    for _ in range(repeats):
        work()
    return (clock() - start) / repeats


def versus(
    part: str,
    what: str,
    work: Work,
    rival: str,
    other: Work,
    *,
    unit: str = "target",
    units: tuple[int, int] = (1, 1),
    repeats: tuple[int, int] = (1, 1),
    rounds: int = 5,
    wanted: float = nan,
    floor: float = nan,
    note: str = "",
    clock: Callable[[], float] = time.process_time,
) -> Measurement:
    """`work` against `other` in turns; `units`: how many of the unit each does at once."""
    work(), other()
    times = (
        np.array([[seconds(work, repeats[0], clock), seconds(other, repeats[1], clock)] for _ in range(rounds)]) / units
    )
    low, ratio, high = np.quantile(times[:, 1] / times[:, 0], (0.25, 0.5, 0.75))
    mine, theirs = np.median(times, axis=0)
    return Measurement(part, what, mine, unit, rival, theirs, ratio, low, high, wanted, floor, note)
