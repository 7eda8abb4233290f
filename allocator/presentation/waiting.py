"""Progress of work of unknown duration, such as compilation, on stderr."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Thread
from time import monotonic

_TERMINAL, _PIPE = 1.0, 5.0  # [s] between two reports
_REPORTED: ContextVar[bool] = ContextVar("_REPORTED", default=False)  # whether the work is a part of reported work


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Report that `what` goes on, with the seconds so far: in a line of a terminal, else a line every five seconds.

    Nothing is printed about work that ends sooner, or about parts of reported work. The line in a terminal is removed
    at the end.
    """
    if _REPORTED.get():
        yield
        return
    done, terminal = Event(), sys.stderr.isatty()
    reporter = Thread(target=_report, args=(what, done, terminal), daemon=True)
    reporter.start()
    token = _REPORTED.set(True)
    try:
        yield
    finally:
        _REPORTED.reset(token)
        done.set()
        reporter.join()


def _report(what: str, done: Event, terminal: bool) -> None:
    """Print until the work is `done`."""
    began, end, text = monotonic(), "\r" if terminal else "\n", ""
    while not done.wait(_TERMINAL if terminal else _PIPE):
        text = f"{what}: {monotonic() - began:.0f} s"
        print(text, end=end, file=sys.stderr, flush=True)
    if terminal and text:
        print(" " * len(text), end=end, file=sys.stderr, flush=True)
