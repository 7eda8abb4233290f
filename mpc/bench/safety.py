"""Safety of a loop: its start, the conditions that end it, and the safe stop of the pressures.

A program cannot replace hard stops of the joint, a relief valve, and a device whose own watchdog vents after some time
without commands. A process that is killed (SIGKILL, power) sends nothing more.

The `Guard` checks readings and commands. Data of devices and controllers are not trusted: a reading that is not the
numbers of n joints and m muscles is a `DeviceError`, one outside the limits ends the loop, and commands are limited to
the supply's range and the slew limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite, isnan, nan
from numbers import Real
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput
from allocator.units import BAR, DEG
from mpc.bench.device import DeviceError, Reading
from mpc.bench.rows import Pressures
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.observer.health import Reaction
from mpc.tracking.limits import Limits


class Action(StrEnum):
    """Action on the pressures at the end of a loop."""

    HOLD = "hold"  # the last commands are sent once more, and hold
    RAMP = "ramp"  # all fall to zero, in proportion; then vent
    VENT = "vent"  # at once


class Reason(StrEnum):
    """Reason for the end of a loop."""

    FINISHED = "finished"
    INTERRUPTED = "interrupted"  # Ctrl-C, Ctrl-Z
    TERMINATED = "terminated"  # SIGTERM, SIGQUIT, or the terminal was closed
    REQUESTED = "stopped by the program"
    DEVICE = "device lost"  # or it raised an exception
    SILENT = "no answer"
    STALLED = "no progress"
    LATE = "samples were missed"
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
    cut: str = ""  # why a ramp ended early

    def __str__(self) -> str:
        return f"{self.reason}: {self.message}" if self.message else str(self.reason)

    @property
    def treatment(self) -> str:
        """Treatment of the pressures in words; "" if nothing was commanded."""
        if self.action is None:
            return ""
        return f"{self.action}, cut short ({self.cut}), then vent" if self.cut else str(self.action)


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

    rate: float = 1 * BAR  # [Pa/s] of the pressure with the greatest change
    dwell: float = 0.5  # at its end [s], for the lag of regulators and the swing of the joint
    settle: float = 1.0  # under control at the reference's first point [s]
    angle_margin: float = 10 * DEG  # [rad] beyond the joint's range meanwhile: without pressure it lies at its stop
    present: Pressures | None = None  # pressures (m,) [Pa], if the device measures none

    def __post_init__(self) -> None:
        checks.positive("rate", self.rate, "Pa/s")
        checks.not_negative("dwell", self.dwell, "s")
        checks.not_negative("settle", self.settle, "s")
        checks.not_negative("angle_margin", self.angle_margin, "rad")
        if self.present is not None:
            checks.pressure("present", self.present)

    def check(self, m: int) -> None:
        """Raise `InvalidInput` unless there are none or m present pressures."""
        if self.present is not None and np.shape(self.present) != (m,):
            raise InvalidInput(f"present = {checks.brief(self.present)} has to be m = {m} pressures [Pa], one a muscle")

    def given(self, measured: Pressures) -> Pressures:
        """Return the present pressures (m,) [Pa], which the device does not all measure. Raises `RefusedStart` if there
        are none.
        """
        if self.present is None:
            m, lacking = len(measured), [f"P{i}" for i, P in enumerate(measured, 1) if not isfinite(P)]
            some = "P1, P2" if m == 2 else f"P1, …, P{m}"
            silent = "measures no pressures" if len(lacking) == m else f"does not measure {', '.join(lacking)}"
            raise RefusedStart(
                f"the device {silent}: give the values of all pressures, SoftStart(present=({some})) in Pa, or "
                f"--present on the command line ({':'.join('0' * m)} after venting)"
            )
        return self.present


@dataclass(frozen=True)
class Watchdog:
    """Watchdog that ends a loop without readings or progress, or with an unhealthy joint."""

    silence: float = 0.2  # without a reading of the angle or a command taken; greatest error of a reading's time [s]
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
    rate: float = 1 * BAR  # of a ramp: rate at which the highest pressure falls [Pa/s]

    def __post_init__(self) -> None:
        if self.action not in list(Action):
            raise InvalidInput(f"action = {self.action!r} has to be one of {', '.join(Action)}")
        object.__setattr__(self, "action", Action(self.action))
        checks.positive("rate", self.rate, "Pa/s")


class Guard:
    """Limits of a machine on readings and commands every `dt` [s], with the margins of a watchdog."""

    def __init__(self, machine: Machine, dt: float, watchdog: Watchdog, angle_margin: float) -> None:
        self.limits, self._watchdog = Limits.of(machine, dt), watchdog
        self.angle_margin = angle_margin  # [rad] beyond the joint's range; another one during the soft start
        self.n, self.m, self._single = machine.n, machine.m, machine.angle_shape == ()
        joint = isinstance(machine, Plant)
        self._joints = ("",) if joint else tuple(f" of {name}" for name in machine.labels.angles)
        self._muscles = ("", "") if joint else tuple(f" of {name}" for name in machine.labels.pressures)
        self._ranges = [
            (float(left), float(right)) for left, right in zip(*map(np.ravel, self.limits.theta), strict=True)
        ]

    def angles(self, reading: Reading) -> Sequence[float]:
        """Return the angles of a checked reading (n,) [rad]."""
        theta = reading.theta
        return (theta,) if self._single else theta.tolist()

    def unread(self, t: float) -> Reading:
        """Return a reading of nothing at the time `t` [s]."""
        return Reading(t, nan if self._single else np.full(self.n, nan), (nan,) * self.m)

    def misdated(self, reading: Reading, now: float) -> str:
        """Return how far a reading's time is from `now` [s], in words; "" within the silence of the watchdog."""
        age = now - reading.t
        if abs(age) <= self._watchdog.silence:
            return ""
        far = f"{abs(age):.3g} s {'before' if age > 0 else 'after'}"
        return f"the last reading is dated {far} the present time of the loop's clock, by default time.monotonic()"

    def lacking(self, reading: Reading) -> str:
        """Return the angles that a reading lacks, in words; "" if it has all of them."""
        blind = [name for name, theta in zip(self._joints, self.angles(reading), strict=True) if not isfinite(theta)]
        return f"no angle{' and'.join(blind)}" if blind else ""

    def broken(self, reading: Reading) -> Stopped | None:
        """Return the limit that a reading violates, if any; unmeasured quantities violate none."""
        margin = self.angle_margin
        for theta, (left, right), name in zip(self.angles(reading), self._ranges, self._joints, strict=True):
            if theta < left - margin or theta > right + margin:
                where = f"the joint's range {left / DEG:.1f} … {right / DEG:.1f}°"
                return Stopped(Reason.LIMIT, f"the angle {theta / DEG:.1f}°{name} is outside {where}")
        (low, high), margin = self.limits.pressure, self._watchdog.pressure_margin
        for i, P in enumerate(reading.P):
            if P < low - margin or P > high + margin:
                where = f"the supply's range {low / BAR:g} … {high / BAR:g} bar"
                message = f"P{i + 1} = {P / BAR:.2f} bar{self._muscles[i]} is outside {where}"
                return Stopped(Reason.LIMIT, message, Action.VENT)
        return None

    def command(self, u: Pressures, sent: Pressures) -> Pressures:
        """Return the command `u` [Pa] within supply and slew after `sent`. Raises `Stopped` unless all are finite."""
        if not all(map(isfinite, u)):
            raise Stopped(Reason.COMMAND, f"the command was {', '.join(map(str, u[:-1]))} and {u[-1]} Pa")
        (low, high), step = self.limits.pressure, self.limits.step
        kept = [min(max(min(max(P, low), high), last - step), last + step) for P, last in zip(u, sent, strict=True)]
        return tuple(map(float, kept))

    def checked(self, reading: Any) -> Reading:
        """Return a device's reading with floats. Raises `DeviceError` for anything else.

        NaN in place of all angles of an arm, or of all its pressures, means that none was measured.
        """
        rows = self._rows(reading[1], reading[2]) if _is_row(reading, len(Reading._fields)) else None
        values = None if rows is None else [reading[0], *rows[0], *rows[1]]
        if values is None or not all(isinstance(value, Real) for value in values):
            form = (
                "(t, theta, (P1, P2))" if self._single else f"(t, theta, P) of {self.n} angles and {self.m} pressures"
            )
            said = checks.brief(reading)
            raise DeviceError(f"read() returned {said}; expected a Reading {form} of real numbers [s, rad, Pa]")
        try:
            t, *numbers = map(float, values)
        except OverflowError:
            raise DeviceError(f"read() returned {checks.brief(reading)}, with a number that no float holds") from None
        return Reading(t, numbers[0] if self._single else np.array(numbers[: self.n]), tuple(numbers[self.n :]))

    def _rows(self, theta: Any, P: Any) -> tuple[Sequence[Any], Sequence[Any]] | None:
        """Return the angles and the pressures of a reading as rows; None if their numbers are wrong."""
        if self._single:
            return ((theta,), P) if _is_row(P, 2) else None
        angles, P = _filled(theta, self.n), _filled(P, self.m)
        return (angles, P) if _is_row(angles, self.n) and _is_row(P, self.m) else None


def _filled(values: Any, size: int) -> Any:
    """Return a list for an array, and a row of NaN for NaN or for any row of it."""
    row = values.tolist() if isinstance(values, np.ndarray) else values
    found = row if isinstance(row, Sequence) else [row]
    unmeasured = all(isinstance(value, float) and isnan(value) for value in found)
    return (nan,) * size if unmeasured else row


def _is_row(value: object, size: int) -> TypeGuard[Sequence[Any]]:
    return isinstance(value, Sequence) and len(value) == size
