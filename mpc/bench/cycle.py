"""The cycle is what every loop on a device has in common, whatever decides on the commands.

    wait for the deadline t0 + k dt          absolute, so that lateness does not add up
    read                                     `NoAnswer`: a sample without a reading
    check                                    signals, silence, limits
    decide                                   by a `CommandSource`: controller, or list of commands
    guard and write                          within the supply's range and the slew limit
    record                                   after the command, in the time that is left

It begins with a soft start and ends with a safe stop (`mpc.bench.safety`), in every case: normally, by a signal, an
exception, a device that is lost or a log that cannot be written.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import IntEnum
from functools import partial
from math import ceil, inf, isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from allocator.errors import CannotWrite
from allocator.units import BAR, DEG
from mpc.bench.clock import Clock, MonotonicClock
from mpc.bench.device import Device, DeviceError, NoAnswer, Reading
from mpc.bench.lateness import Lateness
from mpc.bench.record import Recorder, Row
from mpc.bench.safety import Action, Ending, Reason, RefusedStart, SafeStop, SoftStart, Stopped, Watchdog
from mpc.bench.stops import Stops
from mpc.tracking.limits import Limits

Pressures = tuple[float, float]
_PATIENCE = 5  # readings to wait for before a start


class Phase(IntEnum):
    """A phase is a part of a loop's life."""

    RAMP = 0  # soft start: to the pressures of the first command
    SETTLE = 1  # controlled, at the first point of the reference
    RUN = 2
    STOP = 3  # safe stop


class Overrun(IntEnum):
    """An overrun policy says what follows where a sample took longer than there is between two."""

    SKIP = 0  # leave out the samples that are over: the reference goes with the clock
    CATCH_UP = 1  # do all of them, at once
    STOP = 2  # end the loop


class Tick(NamedTuple):
    """A tick is one sample of a loop."""

    k: int  # by the clock: those left out count
    missed: int  # left out before it
    reading: Reading  # NaN where there was none
    sent: Pressures  # the last command [Pa]
    due: float  # when it should have begun [s], on the clock of the reading


class Decision(NamedTuple):
    """A decision is what to send, and what a row says of it."""

    u: Pressures  # [Pa]
    phase: Phase = Phase.RUN
    about: dict[str, Any] = {}  # noqa: RUF012  # fields of `Row`; never written to


class CommandSource(Protocol):
    """A command source decides on the commands, one pair a sample of `dt` [s]."""

    @property
    def dt(self) -> float:
        """Return the sample time [s]."""

    @property
    def first(self) -> Pressures:
        """Return the pressures [Pa] that a soft start leads to."""

    def decide(self, tick: Tick) -> Decision | None:
        """Return the commands of this sample, None at the end. Raises `Stopped` where the joint is not well."""


class Settings(NamedTuple):
    """The settings of a cycle are those that every loop has."""

    overrun: Overrun = Overrun.SKIP
    start: SoftStart = SoftStart()
    watchdog: Watchdog = Watchdog()
    stop: SafeStop = SafeStop()


class Cycle:
    """A cycle runs once; `run` returns how it ended."""

    def __init__(
        self,
        device: Device,
        source: CommandSource,
        limits: Limits,
        settings: Settings,
        *,
        log: str | Path | None = None,
        about: Sequence[str] = (),
        clock: Clock | None = None,
        watch: Callable[[Row], None] | None = None,
    ) -> None:
        self.device, self.source, self.dt, self.limits, self.settings = device, source, source.dt, limits, settings
        self.clock: Clock = MonotonicClock() if clock is None else clock
        self.recorder = Recorder(log, about)
        self.ending: Ending | None = None
        self._watch = watch
        self._stops = Stops(device, settings.watchdog.stall)

    def request_stop(self) -> None:
        """Ask for the end, from any thread; asked twice a ramp becomes a vent."""
        self._stops.request()

    def run(self) -> Ending:
        """Run to the end and return it. What a controller or a device raises unforeseen is raised after the safe stop.

        Raises `RefusedStart`, `DeviceError` where no connection is made, and `CannotWrite` where the log cannot begin.
        """
        with self.recorder, self.device, self._stops:
            self._begin()
            unforeseen = None
            try:
                self._ramp_up()
                while self._tick(self.source.decide):
                    pass
                ending = Ending(Reason.FINISHED, "")
            except RefusedStart:
                raise
            except BaseException as raised:
                ending = _ending(raised)
                unforeseen = raised if ending.reason is Reason.ERROR else None
            self.ending = self._end(ending)
        if unforeseen is not None:
            raise unforeseen
        return self.ending

    @property
    def lateness(self) -> Lateness:
        """Return the distribution of lateness so far, without that of the safe stop."""
        columns = self.recorder.columns
        here = columns["phase"] != Phase.STOP
        return Lateness.of(columns["late"][here], columns["missed"][here], self.dt)

    # --- start ------------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Find out where the joint is, and refuse to move one that is where it must not be."""
        reading = self._first_reading()
        measured = reading.P1, reading.P2
        present = self.settings.start.present
        if not all(map(isfinite, measured)):
            if present is None:
                raise RefusedStart(
                    "the device measures no pressures: say where they are, SoftStart(present=(P1, P2)) in Pa, or "
                    "--present on the command line (0:0 after venting)"
                )
            measured = present
        self._angle_margin = self.settings.start.angle_margin
        if wrong := self._broken(reading):
            raise RefusedStart(f"{wrong.message}; nothing was commanded")
        low, high = self.limits.pressure
        one, two = (min(max(P, low), high) for P in measured)
        self._sent: Pressures = one, two
        self._began = self._seen = self._taken = self.clock.now()
        self._last_read = -inf  # that one may be read again
        self._next, self._missed = 0, 0
        self._commanded = False

    def _first_reading(self) -> Reading:
        for _ in range(_PATIENCE):
            try:
                reading = self.device.read()
            except NoAnswer as silent:
                why = str(silent)
                self.clock.sleep_until(self.clock.now() + self.dt)
                continue
            if isfinite(reading.theta):
                return reading
            why = "it measures no angle"
        raise RefusedStart(f"{_PATIENCE} readings were asked for and none came ({why}); nothing was commanded")

    def _ramp_up(self) -> None:
        """Lead both pressures on a line to those of the first command, and wait there."""
        start, begin, end = self.settings.start, self._sent, self.source.first
        way = max(abs(b - a) for a, b in zip(begin, end, strict=True))
        steps = max(1, ceil(way / start.rate / self.dt))

        def decide(tick: Tick) -> Decision | None:
            share = min(1.0, (tick.k + 1) / steps)
            one, two = (a + share * (b - a) for a, b in zip(begin, end, strict=True))
            return Decision((one, two), Phase.RAMP)

        while self._next < steps + round(start.dwell / self.dt):
            self._tick(decide)
        self._angle_margin = self.settings.watchdog.angle_margin

    # --- a sample ---------------------------------------------------------------------------------------------------

    def _tick(self, decide: Callable[[Tick], Decision | None]) -> bool:
        """Do one sample; return whether there was a decision."""
        self.clock.sleep_until(self._began + self._next * self.dt)
        self._leave_out()
        deadline, began = self._began + self._next * self.dt, self.clock.now()
        self._stops.beat()
        self._stops.check()
        reading = self._read()
        self._check(reading)
        decision = decide(Tick(self._next, self._missed, reading, self._sent, deadline))
        if decision is None:
            return False
        taken = self._write(self._guarded(decision.u))
        took = self.clock.now() - began
        self._record(reading, decision, began, began - deadline, took, taken)
        self._next, self._missed = self._next + 1, 0
        return True

    def _read(self) -> Reading:
        """Return the reading of now; NaN where there is none, or an old one."""
        try:
            reading = self.device.read()
        except NoAnswer:
            return Reading(nan)
        if not reading.t > self._last_read:
            return Reading(reading.t)
        self._last_read = reading.t
        return reading

    def _check(self, reading: Reading) -> None:
        """Raise `Stopped` where nothing is seen for too long, or a limit is broken."""
        now, patience = self.clock.now(), self.settings.watchdog.silence
        if isfinite(reading.theta):
            self._seen = now
        elif now - self._seen > patience:
            raise Stopped(Reason.SILENT, f"no angle was read for {now - self._seen:.3g} s")
        if now - self._taken > patience:
            raise Stopped(Reason.SILENT, f"the device took no command for {now - self._taken:.3g} s")
        if wrong := self._broken(reading):
            raise wrong

    def _broken(self, reading: Reading) -> Stopped | None:
        """Return which limit a reading breaks; what is not measured breaks none."""
        watchdog, margin = self.settings.watchdog, self._angle_margin
        left, right = self.limits.theta
        if reading.theta < left - margin or reading.theta > right + margin:
            where = f"the joint's range {left / DEG:.1f} … {right / DEG:.1f}°"
            return Stopped(Reason.LIMIT, f"the angle {reading.theta / DEG:.1f}° is outside {where}")
        low, high = self.limits.pressure
        for name, P in (("P1", reading.P1), ("P2", reading.P2)):
            if P < low - watchdog.pressure_margin or P > high + watchdog.pressure_margin:
                where = f"the supply's range {low / BAR:g} … {high / BAR:g} bar"
                return Stopped(Reason.LIMIT, f"{name} = {P / BAR:.2f} bar is outside {where}", Action.VENT)
        return None

    def _guarded(self, u: Pressures) -> Pressures:
        """Return the command within supply and slew. Raises `Stopped` for one that is no number."""
        if not all(map(isfinite, u)):
            raise Stopped(Reason.COMMAND, f"the command was {u[0]} and {u[1]} Pa")
        (low, high), step = self.limits.pressure, self.limits.step
        one, two = (
            min(max(min(max(P, low), high), last - step), last + step) for P, last in zip(u, self._sent, strict=True)
        )
        return float(one), float(two)

    def _write(self, u: Pressures) -> bool:
        self._commanded = True
        try:
            self.device.write(*u)
        except NoAnswer:
            taken = False
        else:
            taken, self._taken = True, self.clock.now()
        self._sent = u
        return taken

    def _record(
        self, reading: Reading, decision: Decision, began: float, late: float, took: float, taken: bool
    ) -> None:
        zero = self._began
        row = Row(
            began - zero, reading.theta, reading.P1, reading.P2, *self._sent, int(decision.phase), self._missed, late,
            took, reading.t - zero, int(taken), **decision.about,
        )  # fmt: skip
        self.recorder.add(row)
        if self._watch is not None:
            self._watch(row)

    def _leave_out(self) -> None:
        """Leave out the samples that are over already, if that is the policy: the last one took too long, or so did the
        system to wake up.
        """
        over = int((self.clock.now() - self._began) / self.dt * (1 + 1e-12)) - self._next
        if over < 1:
            return
        if self.settings.overrun is Overrun.STOP:
            raise Stopped(Reason.LATE, f"{over} samples were over before they could begin")
        if self.settings.overrun is Overrun.SKIP:
            self._next, self._missed = self._next + over, over

    # --- end --------------------------------------------------------------------------------------------------------

    def _end(self, ending: Ending) -> Ending:
        """Bring the pressures to where they are to be; return what was done."""
        if not self._commanded:
            return ending
        action = ending.action or self.settings.stop.action
        if ending.reason is Reason.DEVICE:
            action = Action.VENT  # there may be nobody to ramp with
        try:
            if action is Action.RAMP:
                self._ramp_down()
            said = self._insist(partial(self.device.write, *self._sent) if action is Action.HOLD else self.device.vent)
        except Stopped as stalled:  # a call hung, now of all times
            said = self._insist(self.device.vent) or str(stalled.ending)
        ending = ending._replace(action=action, delivered=not said)
        what = f"the device did not take it ({said})" if said else "done"
        with suppress(CannotWrite):  # whoever reads the log misses this line: the rows before it are there
            self.recorder.remark(f"ended: {ending}; {action}: {what}")
        return ending

    def _ramp_down(self) -> None:
        """Let both pressures fall in proportion, until a signal is impatient or the device takes nothing more."""
        begin, low, began = self._sent, self.limits.pressure[0], self.clock.now()
        self._taken = began
        steps = ceil((max(begin) - low) / self.settings.stop.rate / self.dt)
        for k in range(1, steps + 1):
            deadline = began + k * self.dt
            self.clock.sleep_until(deadline)
            now = self.clock.now()
            self._stops.beat()
            if self._stops.urgent or now - self._taken > self.settings.watchdog.silence:
                return
            one, two = (low + (1 - k / steps) * max(P - low, 0.0) for P in begin)
            try:
                reading = self._read()
                taken = self._write((one, two))
            except DeviceError:
                return
            with suppress(CannotWrite):  # the recorder has said so before, or will not be asked again
                self._record(reading, Decision((one, two), Phase.STOP), now, now - deadline, 0.0, taken)

    def _insist(self, command: Callable[[], None]) -> str:
        """Send the last command, up to three times; return why it was not taken, or nothing."""
        why = ""
        for _ in range(3):
            self._stops.beat()
            try:
                command()
            except NoAnswer as silent:
                why = str(silent) or "no answer"
            except Exception as error:  # of whoever wrote the device: the ending tells it
                return f"{type(error).__name__}: {error}"
            else:
                return ""
        return why


def _ending(raised: BaseException) -> Ending:
    """Return the ending that an exception means."""
    if isinstance(raised, Stopped):
        return raised.ending
    if isinstance(raised, KeyboardInterrupt):
        return Ending(Reason.INTERRUPTED, "")
    if isinstance(raised, DeviceError):
        return Ending(Reason.DEVICE, str(raised))
    if isinstance(raised, CannotWrite):
        return Ending(Reason.LOG, str(raised))
    return Ending(Reason.ERROR, f"{type(raised).__name__}: {raised}")


__all__ = ["CommandSource", "Cycle", "Decision", "Overrun", "Phase", "Pressures", "Settings", "Tick"]
