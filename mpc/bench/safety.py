"""Safety of a loop: its start, the conditions that end it, and the safe stop of the pressures.

A program cannot replace hard stops of the joint, a relief valve, and a device whose own watchdog vents after some time
without commands. A process that is killed (SIGKILL, power) sends nothing more.

The `Guard` checks readings and commands. Data of devices and controllers are not trusted: a reading that is not four
numbers is a `DeviceError`, one outside the limits ends the loop, and commands are limited to the supply's range and the
slew limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from numbers import Real
from typing import Any, NamedTuple, TypeAlias, TypeGuard

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput
from allocator.units import BAR, DEG
from mpc.bench.device import DeviceError, Reading
from mpc.observer.health import Reaction
from mpc.tracking.limits import Limits


class Action(StrEnum):
    """Action on the pressures at the end of a loop."""

    HOLD = "hold"  # the last commands are sent once more, and hold
    RAMP = "ramp"  # both fall to zero, in proportion; then vent
    VENT = "vent"  # at once


class Reason(StrEnum):
    """Reason for the end of a loop."""

    FINISHED = "finished"
    INTERRUPTED = "interrupted"  # Ctrl-C, Ctrl-Z
    TERMINATED = "terminated"  # SIGTERM, SIGQUIT, or the terminal was closed
    REQUESTED = "stopped by the program"
    DEVICE = "device lost"  # or it raised an exception
    SILENT = "no reading"
    STALLED = "no progress"
    LATE = "a sample was missed"
    UNHEALTHY = "the joint is not well"
    LIMIT = "a limit was broken"
    COMMAND = "no command that could be sent"
    LOG = "the log cannot be written"
    REFUSED = "the start was refused"
    ERROR = "an error in the program"


class Ending(NamedTuple):
    """Ending of a loop: its reason, and the action taken."""

    reason: Reason
    message: str
    action: Action | None = None  # that the reason requires, independent of the configuration
    delivered: bool = True  # whether the device took the last command

    def __str__(self) -> str:
        return f"{self.reason}: {self.message}" if self.message else str(self.reason)


class RefusedStart(AntagonistError):
    """Start refused before any command; the message names the cause."""


class Stopped(Exception):  # not an error
    """Request to end the loop, with its reason."""

    def __init__(self, reason: Reason, message: str = "", action: Action | None = None) -> None:
        super().__init__(message)
        self.ending = Ending(reason, message, action)

    @property
    def message(self) -> str:
        """Message as a sentence."""
        return self.ending.message


@dataclass(frozen=True)
class SoftStart:
    """Soft start: the pressures move from their present values to the first command, and the joint settles.

    The observer does not run meanwhile, because a slack joint does not obey the model.
    """

    rate: float = 1 * BAR  # [Pa/s] of the pressure with the greater change
    dwell: float = 0.5  # at its end [s], for the lag of regulators and the swing of the joint
    settle: float = 1.0  # under control at the reference's first point [s]
    angle_margin: float = 10 * DEG  # [rad] beyond the joint's range meanwhile: without pressure it lies at its stop
    present: tuple[float, float] | None = None  # pressures [Pa], if the device measures none

    def __post_init__(self) -> None:
        checks.positive("rate", self.rate, "Pa/s")
        checks.not_negative("dwell", self.dwell, "s")
        checks.not_negative("settle", self.settle, "s")
        checks.not_negative("angle_margin", self.angle_margin, "rad")
        if self.present is not None:
            checks.pressure("present", self.present)


@dataclass(frozen=True)
class Watchdog:
    """Watchdog that ends a loop without readings or progress, or with an unhealthy joint."""

    silence: float = 0.2  # without a reading of the angle, or without a command taken [s]
    stall: float = 1.0  # without a finished sample [s], in real time
    reaction: Reaction | None = Reaction.HOLD  # least reaction of the observer's health that ends the loop; None: none
    lasting: float = 0.5  # duration of this reaction before the end [s]
    angle_margin: float = 2 * DEG  # [rad] beyond the joint's range
    pressure_margin: float = 0.3 * BAR  # [Pa] beyond the supply's range

    def __post_init__(self) -> None:
        for name, unit in (("silence", "s"), ("stall", "s")):
            checks.positive(name, getattr(self, name), unit)
        for name, unit in (("lasting", "s"), ("angle_margin", "rad"), ("pressure_margin", "Pa")):
            checks.not_negative(name, getattr(self, name), unit)


@dataclass(frozen=True)
class SafeStop:
    """Treatment of the pressures at every end of a loop."""

    action: Action = Action.RAMP
    rate: float = 1 * BAR  # of a ramp: rate at which the higher pressure falls [Pa/s]

    def __post_init__(self) -> None:
        if self.action not in list(Action):
            raise InvalidInput(f"action = {self.action!r} has to be one of {', '.join(Action)}")
        object.__setattr__(self, "action", Action(self.action))
        checks.positive("rate", self.rate, "Pa/s")


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
        for i, P in enumerate(reading.P, 1):
            if P < low - margin or P > high + margin:
                where = f"the supply's range {low / BAR:g} … {high / BAR:g} bar"
                return Stopped(Reason.LIMIT, f"P{i} = {P / BAR:.2f} bar is outside {where}", Action.VENT)
        return None

    def command(self, u: Pressures, sent: Pressures) -> Pressures:
        """Return the command `u` [Pa] within supply and slew after `sent`. Raises `Stopped` unless both are finite."""
        if not all(map(isfinite, u)):
            raise Stopped(Reason.COMMAND, f"the command was {u[0]} and {u[1]} Pa")
        (low, high), step = self.limits.pressure, self.limits.step
        one, two = (min(max(min(max(P, low), high), last - step), last + step) for P, last in zip(u, sent, strict=True))
        return float(one), float(two)


def checked(reading: object) -> Reading:
    """Return a device's reading with floats. Raises `DeviceError` for anything else."""
    if not (_is_row(reading, len(Reading._fields)) and _is_row(reading[2], 2)):
        raise DeviceError(f"read() returned {checks.brief(reading)}, which is not a Reading (t, theta, (P1, P2))")
    t, theta, P = reading
    if not all(isinstance(value, Real) for value in (t, theta, *P)):
        raise DeviceError(f"read() returned {checks.brief(reading)}: a Reading has four real numbers [s, rad, Pa, Pa]")
    try:
        return Reading(float(t), float(theta), tuple(map(float, P)))
    except OverflowError:
        raise DeviceError(f"read() returned {checks.brief(reading)}, with a number that no float holds") from None


def _is_row(value: object, size: int) -> TypeGuard[Sequence[Any]]:
    return isinstance(value, Sequence) and len(value) == size
