"""A clock says when a loop's next sample is due, and waits for it: this computer's, or that of a simulated device."""

import time
from typing import Protocol


class Clock(Protocol):
    """A clock has what a loop asks of time; what it tells never goes back."""

    def now(self) -> float:
        """Return the time [s] from some beginning."""

    def sleep_until(self, t: float) -> None:
        """Return at the time `t` [s] or as soon after it as the system wakes up; at once if it is over."""


class MonotonicClock:
    """The monotonic clock is this computer's: nobody sets it, and it stands still while the computer sleeps."""

    def now(self) -> float:
        """Return `time.monotonic()` [s]."""
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        """Sleep up to the time `t` [s]."""
        if (left := t - time.monotonic()) > 0:
            time.sleep(left)


class SimulatedClock:
    """A simulated clock goes only while somebody sleeps or says that time was spent: as fast as the computer can."""

    def __init__(self) -> None:
        self._t = 0.0

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self._t

    def sleep_until(self, t: float) -> None:
        """Jump to the time `t` [s], unless it is over."""
        self._t = max(self._t, t)

    def spend(self, duration: float) -> None:
        """Let a `duration` [s] pass, as a computation or a slow device would."""
        self._t += duration
