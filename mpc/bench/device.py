"""Devices: the interface of the valves and sensors of a joint or an arm, three functions in SI units.

Muscle 1 of a joint is the agonist, which turns it towards greater angles; pressures are gauge pressures. `antagonist`
calls a device from one thread, with one exception: if that thread hangs inside a call of the device for longer than the
stall watchdog allows, another thread calls `vent` as a last resort, and the process ends.

Device made of two functions: analog cards, EtherCAT masters, ROS nodes, anything that Python can reach.
"""

import time
from collections.abc import Callable, Sequence
from math import nan
from types import TracebackType
from typing import NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from allocator import checks
from allocator.calculus import Value
from allocator.errors import AntagonistError, InvalidInput
from mpc.model.machine import Machine, check_machine


class Clock(Protocol):
    """Interface of monotonic clocks."""

    def now(self) -> float:
        """Return the time [s] since an arbitrary origin."""

    def sleep_until(self, t: float) -> None:
        """Return at the time `t` [s] or as soon after it as the system wakes up; at once if `t` is past."""


class MonotonicClock:
    """Monotonic clock of this computer, which cannot be set and stops while the computer sleeps."""

    def now(self) -> float:
        """Return `time.monotonic()` [s]."""
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        """Sleep up to the time `t` [s]."""
        if (left := t - time.monotonic()) > 0:
            time.sleep(left)


class SimulatedClock:
    """Simulated clock, which advances only by sleeping and by spent time, as fast as the computer can."""

    def __init__(self) -> None:
        self._t = 0.0

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self._t

    def sleep_until(self, t: float) -> None:
        """Jump to the time `t` [s], unless it is past."""
        self._t = max(self._t, t)

    def spend(self, duration: float) -> None:
        """Let a `duration` [s] pass, as a computation or a slow device would."""
        self._t += duration


class DeviceError(AntagonistError, OSError):
    """Failure of a device; the message names it and the reason."""


class NoAnswer(DeviceError):
    """Late, missing or damaged answer; the loop goes on, since the next one may be good."""


class DeviceLost(DeviceError):
    """Lost device (unplugged, closed by its other end), without further answers."""


class Reading(NamedTuple):
    """Sensor readings at one time; NaN if not measured.

    Those of an arm with n joints and m muscles have n angles and m pressures.
    """

    t: float  # when it was measured [s], on the clock of the loop: `time.monotonic` for a real device
    theta: Value = nan  # joint angle [rad], or (n,) of an arm
    P: tuple[float, ...] = (nan, nan)  # gauge pressures [Pa], of a joint: agonist, antagonist


@runtime_checkable
class Device(Protocol):
    """Interface of devices for a real-time loop. It is a context manager; entering it connects."""

    def read(self) -> Reading:
        """Return the newest reading, after a wait of at most a fraction of a sample.

        Raises `NoAnswer` if none came in time or it was damaged, `DeviceLost` if the device is gone.
        """

    def write(self, *P: float) -> None:
        """Command the gauge pressures [Pa] of the m muscles, for a joint those of agonist and antagonist.

        Raises `NoAnswer` if the device does not take them, `DeviceLost` if it is gone.
        """

    def vent(self) -> None:
        """Vent all muscles as fast as the hardware can; may be called at any time, and more than once.

        Raises `DeviceError` if the device does not take the command.
        """

    def __enter__(self) -> Self:
        """Connect. Raises `DeviceError` if that is not possible."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Disconnect without a command; the safe stop came before."""


class CallableDevice:
    """Device that reads by one function and writes by another.

    A function that raises `NoAnswer` misses a sample. `DeviceLost` ends a loop by a vent, any other exception by the
    safe stop, after which the loop raises it again.

    Parameters
    ----------
    read
        Returns the n angles [rad], or the angles and the m pressures [rad, Pa], or a `Reading`; NaN for unmeasured
        quantities. A joint has n = 1 and m = 2. It is called once per sample and should return at once.
    write
        Takes the m gauge pressures [Pa].
    vent
        Vents all muscles; by default `write(0, …, 0)`.
    close
        Called at the end.
    clock
        Clock for readings without a time of their own; that of the loop.
    machine
        Arm with n joints and m muscles; by default a joint.
    """

    def __init__(
        self,
        read: Callable[[], Reading | Sequence[float] | float],
        write: Callable[..., object],
        vent: Callable[[], object] | None = None,
        close: Callable[[], object] | None = None,
        clock: Clock | None = None,
        machine: Machine | None = None,
    ) -> None:
        for name, function in (("read", read), ("write", write)):
            if not callable(function):
                raise InvalidInput(f"{name} = {checks.brief(function)} has to be a function")
        if machine is not None:
            check_machine(machine)
        self._arm = None if machine is None or machine.angle_shape == () else machine
        self._read, self._write, self._vent, self._close = read, write, vent, close
        self._clock: Clock = MonotonicClock() if clock is None else clock

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._close is not None:
            self._close()

    def read(self) -> Reading:
        """Return the result of the function. Raises `DeviceError` if that is not a reading."""
        said = self._read()
        if isinstance(said, Reading):
            return said
        t, (n, m) = self._clock.now(), self._sizes
        if self._arm is None:
            wanted = "give theta [rad], or theta, P1 and P2 [Pa]"
        else:
            wanted = f"give a row of {n} angles [rad], or of {n} angles and {m} pressures [Pa]"
        try:
            row = checks.floats("read()", said, "rad, Pa")
        except InvalidInput:
            raise DeviceError(f"read() returned {checks.brief(said)}, not numbers: {wanted}") from None
        values = row.ravel().tolist()
        if len(values) not in (n, n + m) or row.ndim > 1:
            some = f"{row.shape} numbers" if row.ndim > 1 else f"{len(values)} numbers"
            raise DeviceError(f"read() returned {some}: {wanted}")
        theta = values[0] if self._arm is None else np.array(values[:n])
        return Reading(t, theta, tuple(values[n:]) or (nan,) * m)

    def write(self, *P: float) -> None:
        """Command the m pressures [Pa]."""
        self._write(*P)

    def vent(self) -> None:
        """Vent all muscles."""
        if self._vent is None:
            self._write(*[0.0] * self._sizes[1])
        else:
            self._vent()

    @property
    def _sizes(self) -> tuple[int, int]:
        """Numbers n of angles and m of pressures."""
        return (1, 2) if self._arm is None else (self._arm.n, self._arm.m)
