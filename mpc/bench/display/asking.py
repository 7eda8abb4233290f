"""Requests to a person at a running loop, which does not wait for the answer."""

import sys
from collections.abc import Callable
from threading import Thread

from mpc.bench.safety import Reason, Stopped

REQUEST = "hang the weight so that it pulls θ {1} with {0:.3g} N·m, and press Enter; the pressures are held"


class Asking:
    """Request for a weight by `ask`, called with its torque [N·m]; a thread waits for the Enter key."""

    def __init__(self, ask: Callable[[float], None]) -> None:
        self._ask = ask
        self._wanted: float | None = None
        self._line: str | None = None

    def __call__(self, torque: float) -> bool:
        """Return whether Enter was pressed since this torque [N·m] was asked for.

        Raises `Stopped` where input or output of the terminal end.
        """
        if self._wanted != torque:
            self._wanted, self._line = torque, None
            try:
                self._ask(torque)
            except OSError:
                raise Stopped(
                    Reason.TERMINATED, "the request to hang a weight cannot be answered: the terminal is closed"
                ) from None
            Thread(target=self._read, daemon=True).start()
        if self._line == "":
            raise Stopped(
                Reason.REQUESTED, "the request to hang a weight cannot be answered: standard input is at its end"
            )
        return self._line is not None

    def _read(self) -> None:
        try:
            self._line = sys.stdin.readline()
        except (OSError, ValueError):  # closed, or not text
            self._line = ""
