"""Whatever wants a loop to end comes here: Ctrl-C, SIGTERM, a closed terminal, the program, or a call that hangs.

A signal only sets a flag, which the loop sees at its next sample: a command on its way is not torn. A second one makes
a ramp that is under way a vent. Where no sample was done for `stall` seconds a thread interrupts whatever call hangs,
by a signal whose handler raises `Stopped` in it. If that does not help for as long again, the device is vented
from that thread, and the process ends with exit code 4. Signals reach the main thread only: a loop that runs in
another one stops by `request`, and its hanging calls cannot be interrupted.
"""

import _thread
import os
import signal
import sys
import threading
import time
from types import FrameType, TracebackType
from typing import Any, Self

from mpc.bench.device import Device
from mpc.bench.safety import Reason, Stopped

EXIT = 4  # exit code of a process that had to be ended
_PATIENCE = 2  # interruptions before the process is ended
_ENDING = {"SIGINT": Reason.INTERRUPTED, "SIGTERM": Reason.TERMINATED, "SIGHUP": Reason.TERMINATED}


class Stops:
    """The stops of a loop are in force while it is entered as a context."""

    def __init__(self, device: Device, stall: float) -> None:
        self._device, self._stall = device, stall
        self._asked: Reason | None = None
        self.urgent = False  # whether it was asked for more than once
        self._interrupting = False
        self._beat = time.monotonic()
        self._left = threading.Event()
        self._before: dict[signal.Signals, Any] = {}
        self._thread = threading.Thread(target=self._guard, name="antagonist-watchdog", daemon=True)

    def __enter__(self) -> Self:
        """Listen to signals, where this is the main thread, and begin to watch."""
        self._main = threading.get_ident() if threading.current_thread() is threading.main_thread() else None
        if self._main is not None:
            for name in _ENDING:
                if number := getattr(signal.Signals, name, None):
                    self._before[number] = signal.signal(number, self._handle)
        self._beat = time.monotonic()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Leave the signals as they were."""
        self._left.set()
        self._thread.join()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def request(self, reason: Reason = Reason.REQUESTED) -> None:
        """Ask for the end, from any thread; asked twice it is urgent."""
        self.urgent, self._asked = self._asked is not None, self._asked or reason

    def beat(self) -> None:
        """Say that there is progress."""
        self._beat = time.monotonic()

    def check(self) -> None:
        """Raise `Stopped` if the end was asked for."""
        if self._asked is not None:
            raise Stopped(self._asked)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._interrupting:
            self._interrupting = False
            raise Stopped(Reason.STALLED, f"a call hung for {self._stall:g} s")
        self.request(_ENDING[signal.Signals(number).name])

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
            signal.pthread_kill(main, signal.SIGINT)  # ends a system call, too
        else:
            _thread.interrupt_main()

    def _abandon(self) -> None:
        """Vent without the thread that hangs, and end the process."""
        said = []

        def vent() -> None:
            try:
                self._device.vent()
                said.append("it was vented")
            except Exception as error:  # of whoever wrote the device; it is told, and the process ends
                said.append(f"it could not be vented ({error})")

        venting = threading.Thread(target=vent, daemon=True)
        venting.start()
        venting.join(self._stall)
        what = said[0] if said else "it could not be vented either"
        os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, f"antagonist: a call hangs; {what}\n".encode())
        os._exit(EXIT)


__all__ = ["EXIT", "Stops"]
