"""A device is what stands between a controller and a joint's valves and sensors: three functions, in SI units.

Muscle 1 is the agonist, which turns the joint towards greater angles; pressures are gauge pressures. `antagonist`
calls a device from one thread, with one exception: where that thread hangs inside a call of the device for longer
than the stall watchdog allows, `vent` is called from another thread as a last resort, and the process ends.
"""

import time
from math import nan
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from allocator.errors import AntagonistError


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


class DeviceError(AntagonistError, OSError):
    """A device does not do what it was asked for; the message names it and says why."""


class NoAnswer(DeviceError):
    """An answer came too late, not at all, or damaged; the next one may be good, so that the loop goes on."""


class DeviceLost(DeviceError):
    """A device is gone (unplugged, closed by its other end): no further answer is to be expected."""


class Reading(NamedTuple):
    """A reading is what the sensors say at one moment; NaN for what is not measured."""

    t: float  # when it was measured [s], on the clock of the loop: `time.monotonic` for a real device
    theta: float = nan  # joint angle [rad]
    P1: float = nan  # agonist, gauge [Pa]
    P2: float = nan  # antagonist, gauge [Pa]


class Device(Protocol):
    """A device has what a real-time loop asks of it. It is a context manager: entered, it is connected."""

    def read(self) -> Reading:
        """Return the newest reading, having waited no longer than a fraction of a sample for it.

        Raises `NoAnswer` where none came in time or it was damaged, `DeviceLost` where the device is gone.
        """

    def write(self, P1: float, P2: float) -> None:
        """Command the gauge pressures [Pa] of agonist and antagonist.

        Raises `NoAnswer` where the device does not take them, `DeviceLost` where it is gone.
        """

    def vent(self) -> None:
        """Let both muscles empty, as fast as the hardware does; may be called at any time, and more than once.

        Raises `DeviceError` where the device does not take it.
        """

    def __enter__(self) -> Self:
        """Connect. Raises `DeviceError` where that is not possible."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Disconnect, without a command: what is to happen to the pressures was decided before."""
