"""Ratios of times, measured in turns so that other load of the machine affects both.

Times are processor times, which exclude other processes; wall times if threads are compared.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import nan

import numpy as np

MISSED = "missed"  # ends a note on a missed requirement
Work = Callable[[], object]


@dataclass(frozen=True)
class Measurement:
    """One figure: `what` against `rival`. Ratios are times of the rival over times of `what`: greater is faster."""

    part: str
    what: str
    seconds: float  # of one `unit`; median
    unit: str  # "target", "call", "process", …
    rival: str = ""
    rival_seconds: float = nan
    ratio: float = nan  # median over the rounds
    low: float = nan  # its quartiles
    high: float = nan
    wanted: float = nan  # the required ratio
    floor: float = nan  # a smaller ratio is a failure if floors are enforced
    note: str = ""

    @property
    def missed(self) -> bool:
        """Whether it is slower than required."""
        return bool(self.ratio < self.wanted)

    @property
    def below_its_floor(self) -> bool:
        """Whether it is below its floor."""
        return bool(self.ratio < self.floor)


def seconds(work: Work, repeats: int = 1, clock: Callable[[], float] = time.process_time) -> float:
    """Return one measurement of the time of `work`."""
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
    """Measure `work` against `other` in turns; `units`: number of units that each does at once."""
    work(), other()
    times = (
        np.array([[seconds(work, repeats[0], clock), seconds(other, repeats[1], clock)] for _ in range(rounds)]) / units
    )
    low, ratio, high = np.quantile(times[:, 1] / times[:, 0], (0.25, 0.5, 0.75))
    mine, theirs = np.median(times, axis=0)
    return Measurement(part, what, mine, unit, rival, theirs, ratio, low, high, wanted, floor, note)
