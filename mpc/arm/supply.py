"""Path of commands to the regulators: supply, slew and dead time."""

from collections.abc import Iterator
from math import inf

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput


class Supply:
    """Delayed commands to regulators within `limits` [Pa] and `slew` [Pa/s], after a `dead_time` [s]."""

    def __init__(self, limits: tuple[float, float], slew: float, dead_time: float) -> None:
        """Check the numbers. Raises `InvalidInput`."""
        low, high = checks.limits("pressure_limits", limits, "Pa")
        checks.pressure("pressure_limits", (low, high))
        if not 0 <= low < high:
            raise InvalidInput(f"pressure_limits = ({low:g}, {high:g}) Pa have to satisfy 0 <= lower < upper")
        self.limits = low, high
        self.slew = inf if slew == inf else checks.number("slew", slew, "Pa/s")
        if self.slew <= checks.LOOKS_LIKE_BAR[1]:
            raise InvalidInput(f"slew = {self.slew:g} Pa/s is next to nothing; if bar/s was meant, multiply by 1e5")
        self.dead_time = checks.not_negative("dead_time", dead_time, "s")

    def begin(self, P: Array) -> None:
        """Begin with regulators that follow the pressures `P` (m,) [Pa]."""
        self.command = P.copy()
        self.waiting: list[tuple[float, Array]] = []  # delayed commands with their times of arrival

    def pieces(self, now: float, asked: Array, dt: float) -> Iterator[float]:
        """Yield the pieces [s] of a sample of `dt` [s] from `now` [s] on; `command` is the regulators' input in each.

        The commands `asked` (m,) [Pa] are given now.
        """
        asked, reach = np.clip(asked, *self.limits), self.slew * dt
        last = self.waiting[-1][1] if self.waiting else self.command
        end = now + dt
        self.waiting.append((now + self.dead_time, np.clip(asked, last - reach, last + reach)))
        arriving = [max(t, now) for t, _ in self.waiting if t < end - 1e-9 * dt]
        for begin, until in zip([now, *arriving], [*arriving, end], strict=True):
            if until - begin > 1e-9 * dt:
                yield until - begin
            if until in arriving:
                self.command = self.waiting.pop(0)[1]
