"""Sequence of all loops on a device, for any source of commands.

    wait for the deadline t0 + k dt          absolute, so that lateness does not add up
    read                                     `NoAnswer`: a sample without a reading; less the encoder's zero
    check                                    signals, silence, limits
    decide                                   by a `CommandSource`: controller, or list of commands
    guard and write                          within the supply's range and the slew limit
    record                                   after the command, in the time that is left

A loop begins with a soft start and ends with a safe stop (`mpc.bench.safety`) in all cases: after the last command, a
signal, a failure to write the log, or any exception of the device, the source or `watch`. The safe stop raises nothing:
a ramp that fails becomes a vent, and a vent is tried several times. Then the exception is raised.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import IntEnum
from functools import partial
from math import ceil, inf, isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from allocator import checks
from allocator.calculus import Value
from allocator.errors import CannotWrite
from allocator.identification.encoder import remark
from mpc.bench.device import Clock, Device, MonotonicClock, NoAnswer, Reading
from mpc.bench.record import Lateness, Recorder
from mpc.bench.rows import Pressures, Row, Sheet, head
from mpc.bench.safety import Action, Ending, Guard, Reason, RefusedStart, SafeStop, SoftStart, Stopped, Watchdog
from mpc.bench.stops import Stops, ending_of, said
from mpc.model.machine import Machine

_PATIENCE = 5  # readings to wait for before a start
_PAUSE = 0.05  # between two tries of the last command [s]


class Phase(IntEnum):
    """Part of a loop's life."""

    RAMP = 0  # soft start: to the pressures of the first command
    SETTLE = 1  # controlled, at the first point of the reference
    RUN = 2
    STOP = 3  # safe stop


class Overrun(IntEnum):
    """Policy for samples that take longer than the sample time."""

    SKIP = 0  # leave out missed samples: the reference follows the clock
    CATCH_UP = 1  # make up for all of them at once
    STOP = 2  # end the loop


class Tick(NamedTuple):
    """One sample of a loop."""

    k: int  # by the clock, including missed ones
    missed: int  # missed samples before it
    reading: Reading  # NaN where there was none
    sent: Pressures  # the last command [Pa]
    due: float  # scheduled beginning [s], on the clock of the reading
    late: float = 0.0  # delay of its beginning [s]


class Decision(NamedTuple):
    """Pressures to send, and the fields of their row in the log."""

    u: Pressures  # [Pa]
    phase: Phase = Phase.RUN
    about: Mapping[str, Any] = {}  # fields of `Row`; never written to


class CommandSource(Protocol):
    """Source of the commands, m pressures per sample of `dt` [s]."""

    @property
    def dt(self) -> float:
        """Sample time [s]."""

    @property
    def first(self) -> Pressures:
        """Pressures [Pa] that a soft start leads to."""

    def decide(self, tick: Tick) -> Decision | None:
        """Return the commands of this sample, None at the end. Raises `Stopped` if the joint is unhealthy."""


class Settings(NamedTuple):
    """Settings common to all loops."""

    overrun: Overrun = Overrun.SKIP
    start: SoftStart = SoftStart()
    watchdog: Watchdog = Watchdog()
    stop: SafeStop = SafeStop()
    zero: Value = 0.0  # encoder reading at 0 of the joint [rad], (n,) of an arm, subtracted from all readings

    def check(self) -> None:
        """Raise `InvalidInput` for a part of another type, which the safe stop would be the first to notice."""
        checks.instance("overrun", self.overrun, Overrun, "an Overrun")
        checks.instance("start", self.start, SoftStart, "a SoftStart")
        checks.instance("watchdog", self.watchdog, Watchdog, "a Watchdog")
        checks.instance("stop", self.stop, SafeStop, "a SafeStop")

    @property
    def about(self) -> tuple[str, ...]:
        """Comments of logs of angles: the zeros that were subtracted, if any."""
        if not np.ndim(self.zero):
            return (remark(self.zero),) if self.zero else ()
        return tuple(remark(zero, f"theta{i}") for i, zero in enumerate(self.zero.tolist(), 1) if zero)


class Cycle:
    """One run of a source's commands on a device; `run` returns how it ended.

    `ending` is also set if `run` raises. `replace` permits the replacement of an existing `log`. A `watch` that raises
    ends the loop like any other exception, and is not called again.
    """

    def __init__(
        self,
        device: Device,
        source: CommandSource,
        machine: Machine,
        settings: Settings,
        *,
        log: str | Path | None = None,
        replace: bool = False,
        clock: Clock | None = None,
        watch: Callable[[Row], None] | None = None,
    ) -> None:
        settings.check()
        checks.instance("device", device, Device, "a device, such as a SimulatedDevice")
        self.device, self.source, self.dt, self.settings = device, source, source.dt, settings
        self.clock: Clock = MonotonicClock() if clock is None else clock
        comments = *head(self.dt, machine), *settings.about
        self.recorder = Recorder(log, comments, sheet=Sheet.of(machine), replace=replace)
        self.ending: Ending | None = None
        self._watch = watch
        self._guard = Guard(machine, source.dt, settings.watchdog, settings.start.angle_margin)
        self.limits = self._guard.limits
        settings.start.check(machine.m)
        self._stops = Stops(device, settings.watchdog.stall, self._last_words)
        self._calling = ""  # function of the device, or `watch`, that is being called
        self._commanded, self._sighted = False, True
        self._unforeseen: BaseException | None = None

    def request_stop(self) -> None:
        """Request the end, from any thread; a second request turns a ramp into a vent."""
        self._stops.request()

    def run(self) -> Ending:
        """Run to the end and return it. An unforeseen exception of device, source or `watch` follows the safe stop.

        Raises `RefusedStart` and `DeviceError` before the first command, `InvalidInput` for a log that exists, and
        `CannotWrite` where the log cannot begin.
        """
        try:
            with self.recorder, self.device, self._stops:
                ending = self._live()
        finally:
            if self._unforeseen is not None:  # rather than an exception while the device is closed
                raise self._unforeseen
        return ending

    def _live(self) -> Ending:
        """Drive until the end, and stop safely."""
        try:
            self._drive()
            ending = Ending(Reason.FINISHED, "")
        except BaseException as raised:
            self._stops.interruptible = False
            ending, foreseen = ending_of(raised, self._calling, self._commanded)
            self._unforeseen = None if foreseen else raised
        self.ending = ending = self._end(ending)
        return ending

    def _drive(self) -> None:
        self._stops.interruptible = True
        try:
            self._begin()
            self._ramp_up()
            while self._tick(self.source.decide):
                pass
        finally:
            self._stops.interruptible = False

    @property
    def lateness(self) -> Lateness:
        """Distribution of lateness so far, without that of the safe stop."""
        columns = self.recorder.columns
        here = columns["phase"] != Phase.STOP
        return Lateness.of(columns["late"][here], columns["missed"][here], self.dt)

    # --- start ------------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Read the joint's position, and refuse to move a joint outside its limits."""
        reading = self._first_reading()
        measured = reading.P if all(map(isfinite, reading.P)) else self.settings.start.given(reading.P)
        if wrong := self._guard.broken(reading) or self._guard.broken(reading._replace(P=measured)):
            raise RefusedStart(f"{wrong.message}; nothing was commanded")
        low, high = self.limits.pressure
        self._sent: Pressures = tuple(min(max(P, low), high) for P in measured)
        self._began = self._seen = self._taken = self.clock.now()
        self._last_read = -inf  # that one may be read again
        self._next, self._missed = 0, 0
        self._writing = 0.0  # time of the last call [s]
        self._lacking, self._observed = "", False  # one silent joint of many is the observer's affair, once it runs

    def _first_reading(self) -> Reading:
        for _ in range(_PATIENCE):
            self._stops.beat()
            try:
                reading = self._asked()
            except NoAnswer as silent:
                why = str(silent)
                self.clock.sleep_until(self.clock.now() + self.dt)
                continue
            lacking = self._guard.lacking(reading)
            why = f"it measures {lacking}" if lacking else self._guard.misdated(reading, self.clock.now())
            if not why:
                return reading
        raise RefusedStart(f"{_PATIENCE} readings were asked for and none can be used ({why}); nothing was commanded")

    def _ramp_up(self) -> None:
        """Move all pressures linearly to those of the first command, and wait there."""
        start, begin, end = self.settings.start, self._sent, self.source.first
        way = max(abs(b - a) for a, b in zip(begin, end, strict=True))
        steps = max(1, ceil(way / start.rate / self.dt))

        def decide(tick: Tick) -> Decision | None:
            share = min(1.0, (tick.k + 1) / steps)
            return Decision(tuple(a + share * (b - a) for a, b in zip(begin, end, strict=True)), Phase.RAMP)

        while self._next < steps + round(start.dwell / self.dt) or self._lacking:
            self._tick(decide)
        self._observed = True
        self._guard.angle_margin = self.settings.watchdog.angle_margin

    # --- a sample ---------------------------------------------------------------------------------------------------

    def _tick(self, decide: Callable[[Tick], Decision | None]) -> bool:
        """Perform one sample; return whether there was a decision."""
        self.clock.sleep_until(self._began + self._next * self.dt)
        self._leave_out()
        deadline, began = self._began + self._next * self.dt, self.clock.now()
        self._stops.beat()
        self._stops.check()
        reading = self._read()
        self._check(reading)
        self._calling = ""
        decision = decide(Tick(self._next, self._missed, reading, self._sent, deadline, began - deadline))
        if decision is None:
            return False
        taken = self._write(self._guard.command(decision.u, self._sent))
        took = self.clock.now() - began
        row = self._row(reading, decision, began, began - deadline, took, taken)
        self.recorder.add(row)
        self._show(row)
        self._next, self._missed = self._next + 1, 0
        return True

    def _read(self) -> Reading:
        """Return the present reading; NaN if there is none, or only one of another time."""
        try:
            reading = self._asked()
        except NoAnswer:
            return self._guard.unread(nan)
        if not reading.t > self._last_read or self._guard.misdated(reading, self.clock.now()):
            return self._guard.unread(reading.t)
        self._last_read = reading.t
        return reading

    def _asked(self) -> Reading:
        self._calling = "read"
        reading = self._guard.checked(self.device.read())
        self._calling = ""
        return reading._replace(theta=reading.theta - self.settings.zero)

    def _check(self, reading: Reading) -> None:
        """Raise `Stopped` if readings are missing for too long, or a limit is violated."""
        now, patience = self.clock.now(), self.settings.watchdog.silence
        self._lacking = self._guard.lacking(reading)
        if not self._lacking or (self._observed and any(map(isfinite, self._guard.angles(reading)))):
            self._seen = now
        elif now - self._seen > patience:
            dated = self._guard.misdated(reading, now) if isfinite(reading.t) else ""
            raise Stopped(
                Reason.SILENT, f"{self._lacking} was read for {now - self._seen:.3g} s" + f"; {dated}" * bool(dated)
            )
        if (late := max(now - self._taken, self._writing)) > patience:
            raise Stopped(Reason.SILENT, f"the device took no command for {late:.3g} s")
        if wrong := self._guard.broken(reading):
            raise wrong

    def _write(self, u: Pressures) -> bool:
        self._commanded, self._calling, began = True, "write", self.clock.now()
        try:
            self.device.write(*u)
        except NoAnswer:
            taken = False
        else:
            taken, self._taken = True, self.clock.now()
        self._sent, self._calling, self._writing = u, "", self.clock.now() - began
        return taken

    def _row(self, reading: Reading, decision: Decision, began: float, late: float, took: float, taken: bool) -> Row:
        zero = self._began
        return Row(
            began - zero, reading.theta, reading.P, self._sent, int(decision.phase), self._missed, late,
            took, reading.t - zero, int(taken), **decision.about,
        )  # fmt: skip

    def _show(self, row: Row) -> None:
        """Call `watch`, which is dropped if it raises."""
        watch, self._watch, self._calling = self._watch, None, "watch"
        if watch is not None:
            watch(row)
        self._watch, self._calling = watch, ""

    def _leave_out(self) -> None:
        """Leave out missed samples, if that is the policy: the last one or the wake-up of the system took too long."""
        over = int((self.clock.now() - self._began) / self.dt * (1 + 1e-12)) - self._next
        if over < 1:
            return
        if self.settings.overrun is Overrun.STOP:
            raise Stopped(Reason.LATE, f"{over} samples were over before they could begin")
        if self.settings.overrun is Overrun.SKIP:
            self._next, self._missed = self._next + over, over

    # --- end --------------------------------------------------------------------------------------------------------

    def _end(self, ending: Ending) -> Ending:
        """Perform the safe stop and return the action taken. Failures are not raised."""
        if not self._commanded:
            return ending
        action = ending.action or self.settings.stop.action
        self._sighted = not (ending.reason is Reason.STALLED and self._calling == "read")
        cut, failed = self._stops.attempt(self._ramp_down) if action is Action.RAMP else (None, None)
        hold = action is Action.HOLD
        refused = self._stops.insist(partial(self.device.write, *self._sent) if hold else self.device.vent, self._pause)
        what = f"the device did not take it ({refused})" if refused else "done"
        if refused and not hold:  # a device that cannot vent may still take a command
            low = self.limits.pressure[0]
            if not self._stops.insist(partial(self.device.write, *[low] * len(self._sent)), self._pause):
                what += f", but a command of {low:g} Pa"
        why = said(failed) if failed else cut or ""
        ending = ending._replace(action=action, delivered=not refused, cut=why)
        self._stops.attempt(partial(self.recorder.remark, f"ended: {ending}; {ending.treatment}: {what}"))
        return ending

    def _ramp_down(self) -> str:
        """Let all pressures fall in proportion, and return why that ended early, or ""."""
        begin, low, began = self._sent, self.limits.pressure[0], self.clock.now()
        self._taken = began
        steps = ceil((max(begin) - low) / self.settings.stop.rate / self.dt)
        k = 0
        while k < steps:
            deadline = began + (k + 1) * self.dt
            self.clock.sleep_until(deadline)
            now = self.clock.now()
            k = min(max(k + 1, int((now - began) / self.dt)), steps)  # by the clock: slow calls do not prolong it
            self._stops.beat()
            if self._stops.urgent:
                return "a vent was requested"
            if now - self._taken > self.settings.watchdog.silence:
                return f"the device took no command for {now - self._taken:.3g} s"
            u = tuple(low + (1 - k / steps) * max(P - low, 0.0) for P in begin)
            began += self._descend(u, now, now - deadline)
        return ""

    def _descend(self, u: Pressures, now: float, late: float) -> float:
        """Perform a sample of the ramp; return the time [s] lost in a reading, which then was the last one.

        Only the command has to succeed. A reading that fails or is late is the last one.
        """
        reading, lost = None, 0.0
        if self._sighted:
            reading, failed = self._stops.attempt(self._read)
            took = self.clock.now() - now
            self._sighted = failed is None and took <= self.settings.watchdog.silence
            lost = 0.0 if self._sighted else took
        taken = self._write(u)
        row = self._row(reading or self._guard.unread(nan), Decision(u, Phase.STOP), now, late, 0.0, taken)
        for note in (self.recorder.add, self._show):
            self._stops.attempt(partial(note, row))
        return lost

    def _last_words(self, what: str) -> None:
        """Write into the log what became of a device with a call that hangs for ever."""
        if not self._calling:  # but the log itself
            return
        with suppress(CannotWrite):
            self.recorder.remark(f"ended: {Reason.STALLED}: {self._calling}() hangs; {what}")

    def _pause(self) -> None:
        self.clock.sleep_until(self.clock.now() + _PAUSE)
