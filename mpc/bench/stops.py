"""Requests that end a loop (signals, the program), and calls that hang or raise, which must not end it.

A signal only sets a flag, which the loop reads at its next sample, so that a command under way is not interrupted.
Ctrl-C (SIGINT), Ctrl-Z (SIGTSTP), SIGTERM and a closed terminal (SIGHUP, unless it is ignored as under nohup) ask for
the safe stop; a second signal, or SIGQUIT, requests a vent at once. If no sample is finished for `stall` seconds, a
thread interrupts the call that hangs by a signal whose handler raises `Stopped` in it. If that does not help twice, the
device is vented from that thread, and the process ends with exit code 4.

Signals reach the main thread only. A loop in another thread stops by `request` and when the process exits; its
hanging calls cannot be interrupted.
"""

import _thread
import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import Self, TypeAlias, TypeVar

from allocator.errors import AntagonistError, CannotWrite
from mpc.bench.device import Device, DeviceError, DeviceLost
from mpc.bench.safety import Action, Ending, Reason, RefusedStart, Stopped

EXIT = 4  # exit code of a process that had to be ended
_PATIENCE = 2  # interruptions before the process is ended
_TRIES = 8  # of a command that has to succeed
_OF_DEVICE = "read", "write"
_ENDING = {
    "SIGINT": Reason.INTERRUPTED,
    "SIGTSTP": Reason.INTERRUPTED,  # a suspended process would hold the pressures indefinitely
    "SIGTERM": Reason.TERMINATED,
    "SIGHUP": Reason.TERMINATED,
    "SIGQUIT": Reason.TERMINATED,
}
_T = TypeVar("_T")
Handler: TypeAlias = Callable[[int, FrameType | None], object] | int | None  # of a signal


class Stops:
    """Signals, requests and the watch over hanging calls, in force while entered as a context."""

    def __init__(self, device: Device, stall: float, note: Callable[[str], object]) -> None:
        self._device, self._stall = device, stall
        self._note = note  # called with the outcome of an end by the watching thread
        self._asked: Reason | None = None
        self.urgent = False  # whether there was more than one request
        self.interruptible = False  # whether `Stopped` may interrupt a hanging call
        self._interrupting = False
        self._beat = time.monotonic()
        self._left = threading.Event()
        self._before: dict[signal.Signals, Handler] = {}
        self._thread = threading.Thread(target=self._guard, name="antagonist-watchdog", daemon=True)

    def __enter__(self) -> Self:
        """Handle signals, if this is the main thread, and begin to watch."""
        self._runs_in = threading.get_ident()
        self._main = threading.get_ident() if threading.current_thread() is threading.main_thread() else None
        self._beat = time.monotonic()
        self._thread.start()
        atexit.register(self._at_exit)
        if self._main is not None:
            for name in _ENDING:
                number = getattr(signal.Signals, name, None)
                if number and not (name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN):
                    self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *raised: object) -> None:
        self._left.set()
        self._thread.join()
        atexit.unregister(self._at_exit)
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: not set by Python

    def request(self, reason: Reason = Reason.REQUESTED) -> None:
        """Request the end, from any thread; a second request makes it urgent."""
        self.urgent, self._asked = self._asked is not None, self._asked or reason

    def beat(self) -> None:
        """Report progress."""
        self._beat = time.monotonic()

    def check(self) -> None:
        """Raise `Stopped` if the end was requested."""
        if self._asked is not None:
            raise Stopped(self._asked)

    def attempt(self, call: Callable[[], _T]) -> tuple[_T | None, BaseException | None]:
        """Return the result of `call` and None, or None and its exception; a hanging call is interrupted."""
        before = self.interruptible
        try:
            self.interruptible = True
            try:
                return call(), None
            finally:
                self.interruptible = before
        except BaseException as raised:
            return None, raised

    def insist(self, command: Callable[[], object], pause: Callable[[], None]) -> str:
        """Try `command` several times, with a `pause` between; return the reason of its failure, or ""."""
        why = ""
        for k in range(_TRIES):
            if k:
                self.attempt(pause)
            self.beat()
            failed = self.attempt(command)[1]
            if failed is None:
                return ""
            why = said(failed)
        return why

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._interrupting:
            self._interrupting = False
            if self.interruptible:
                raise Stopped(Reason.STALLED, f"a call hung for {self._stall:g} s")
            return
        name = signal.Signals(number).name
        self.request(_ENDING[name])
        self.urgent = self.urgent or name == "SIGQUIT"

    def _at_exit(self) -> None:
        """Wait for the safe stop of a loop in another thread, which the end of the process would cut off."""
        if threading.get_ident() != self._runs_in:
            self.request(Reason.TERMINATED)
            while not self._left.is_set():
                try:
                    self._left.wait()
                except KeyboardInterrupt:
                    self.request()

    # --- a call that hangs ------------------------------------------------------------------------------------------

    def _guard(self) -> None:
        beat, since, interrupted = self._beat, self._beat, 0
        while not self._left.wait(self._stall / 4):
            if self._beat != beat:
                beat, since, interrupted = self._beat, self._beat, 0
            elif time.monotonic() - since > self._stall:
                if self._main is None or interrupted == _PATIENCE:
                    self._abandon()
                interrupted, since = interrupted + 1, time.monotonic()
                self._interrupt(self._main)

    def _interrupt(self, main: int | None) -> None:
        self._interrupting = True
        if main is not None and hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main, signal.SIGINT)  # also ends a system call
        else:
            _thread.interrupt_main()

    def _abandon(self) -> None:
        """Vent without the hanging thread, and end the process."""
        outcome: list[str] = []

        def vent() -> None:
            for _ in range(_TRIES):
                try:
                    self._device.vent()
                except BaseException as error:
                    outcome[:] = [f"it could not be vented ({said(error)})"]
                    time.sleep(self._stall / 4 / _TRIES)
                else:
                    outcome[:] = ["it was vented"]
                    return

        _aside(vent, self._stall)
        what = outcome[0] if outcome else "it could not be vented either"
        _aside(partial(self._note, what), self._stall / 4)
        os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, f"antagonist: a call hangs; {what}\n".encode())
        os._exit(EXIT)


def _aside(call: Callable[[], object], patience: float) -> None:
    """Make a call that may hang in a thread, and wait for it for at most `patience` [s]."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(patience)


def ending_of(raised: BaseException, calling: str, commanded: bool) -> tuple[Ending, bool]:
    """Return the ending that an exception means, and whether it is foreseen.

    `calling` is the function of the device that raised it, or "watch", "" for none of them; `commanded` is whether the
    device has got a command before.
    """
    if isinstance(raised, Stopped):
        return raised.ending, True
    if isinstance(raised, KeyboardInterrupt):
        return Ending(Reason.INTERRUPTED, ""), True
    if isinstance(raised, CannotWrite):
        return Ending(Reason.LOG, str(raised)), True
    if isinstance(raised, RefusedStart) and not commanded:
        return Ending(Reason.REFUSED, str(raised)), False
    if isinstance(raised, DeviceError):
        lost = isinstance(raised, DeviceLost)  # the device may not take the commands of a ramp
        return Ending(Reason.DEVICE, str(raised), Action.VENT if lost else None), commanded
    message = f"{calling}() raised {said(raised)}" if calling else said(raised)
    return Ending(Reason.DEVICE if calling in _OF_DEVICE else Reason.ERROR, message), False


def said(error: BaseException) -> str:
    """Return type and message of an exception, whose `__str__` may fail as well."""
    try:
        message = str(error)
    except Exception:
        message = "no message"
    if isinstance(error, AntagonistError) and message:
        return message
    name = type(error).__name__
    return f"{name}: {message}" if message else name
