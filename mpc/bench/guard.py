"""Checks of the readings and commands of a device.

Data of devices and controllers are not trusted: a reading that is not four numbers is a `DeviceError`, one outside the
limits ends the loop, and commands are limited to the supply's range and the slew limit.
"""

from collections.abc import Sequence
from math import isfinite
from numbers import Real
from typing import TypeAlias

from allocator import checks
from allocator.units import BAR, DEG
from mpc.bench.device import DeviceError, Reading
from mpc.bench.safety import Action, Reason, Stopped, Watchdog
from mpc.tracking.limits import Limits

Pressures: TypeAlias = tuple[float, float]


class Guard:
    """Limits on readings and commands, with the margins of a watchdog."""

    def __init__(self, limits: Limits, watchdog: Watchdog, angle_margin: float) -> None:
        self.limits, self._watchdog = limits, watchdog
        self.angle_margin = angle_margin  # [rad] beyond the joint's range; another one during the soft start

    def broken(self, reading: Reading) -> Stopped | None:
        """Return the limit that a reading violates, if any; unmeasured quantities violate none."""
        left, right = self.limits.theta
        if reading.theta < left - self.angle_margin or reading.theta > right + self.angle_margin:
            where = f"the joint's range {left / DEG:.1f} … {right / DEG:.1f}°"
            return Stopped(Reason.LIMIT, f"the angle {reading.theta / DEG:.1f}° is outside {where}")
        (low, high), margin = self.limits.pressure, self._watchdog.pressure_margin
        for name, P in (("P1", reading.P1), ("P2", reading.P2)):
            if P < low - margin or P > high + margin:
                where = f"the supply's range {low / BAR:g} … {high / BAR:g} bar"
                return Stopped(Reason.LIMIT, f"{name} = {P / BAR:.2f} bar is outside {where}", Action.VENT)
        return None

    def command(self, u: Pressures, sent: Pressures) -> Pressures:
        """Return the command `u` [Pa] within supply and slew after `sent`. Raises `Stopped` unless both are finite."""
        if not all(map(isfinite, u)):
            raise Stopped(Reason.COMMAND, f"the command was {u[0]} and {u[1]} Pa")
        (low, high), step = self.limits.pressure, self.limits.step
        one, two = (min(max(min(max(P, low), high), last - step), last + step) for P, last in zip(u, sent, strict=True))
        return float(one), float(two)


def checked(reading: object) -> Reading:
    """Return a device's reading as four floats. Raises `DeviceError` for anything else."""
    if not isinstance(reading, Sequence) or len(reading) != len(Reading._fields):
        raise DeviceError(f"read() returned {checks.brief(reading)}, which is not a Reading (t, theta, P1, P2)")
    if not all(isinstance(value, Real) for value in reading):
        raise DeviceError(f"read() returned {checks.brief(reading)}: a Reading has four real numbers [s, rad, Pa, Pa]")
    try:
        return Reading(*map(float, reading))
    except OverflowError:
        raise DeviceError(f"read() returned {checks.brief(reading)}, with a number that no float holds") from None
