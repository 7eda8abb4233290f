"""Device made of two functions: analog cards, EtherCAT masters, ROS nodes, anything that Python can reach."""

from collections.abc import Callable, Sequence
from math import nan
from typing import Self

from allocator import checks
from allocator.errors import InvalidInput
from mpc.bench.device import Clock, DeviceError, MonotonicClock, Reading


class CallableDevice:
    """Device that reads by one function and writes by another.

    A function that raises `NoAnswer` misses a sample. `DeviceLost` ends a loop by a vent, any other exception by the
    safe stop, after which the loop raises it again.

    Parameters
    ----------
    read
        Returns the angle [rad], or (angle, P1, P2) [rad, Pa, Pa], or a `Reading`; NaN for unmeasured quantities. It is
        called once per sample and should return at once.
    write
        Takes the gauge pressures P1, P2 [Pa].
    vent
        Vents both muscles; by default `write(0, 0)`.
    close
        Called at the end.
    clock
        Clock for readings without a time of their own; that of the loop.
    """

    def __init__(
        self,
        read: Callable[[], Reading | Sequence[float] | float],
        write: Callable[[float, float], object],
        vent: Callable[[], object] | None = None,
        close: Callable[[], object] | None = None,
        clock: Clock | None = None,
    ) -> None:
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
        t = self._clock.now()
        try:
            values = checks.floats("read()", said, "rad, Pa, Pa").ravel().tolist()
        except InvalidInput:
            raise DeviceError(
                f"read() returned {checks.brief(said)}, not numbers: give theta [rad], P1, P2 [Pa]"
            ) from None
        if len(values) not in (1, 3):
            raise DeviceError(f"read() returned {len(values)} numbers: give theta [rad], or theta, P1 and P2 [Pa]")
        return Reading(t, *(values if len(values) == 3 else (values[0], nan, nan)))

    def write(self, P1: float, P2: float) -> None:
        """Command pressures [Pa]."""
        self._write(P1, P2)

    def vent(self) -> None:
        """Vent both muscles."""
        if self._vent is None:
            self._write(0.0, 0.0)
        else:
            self._vent()
