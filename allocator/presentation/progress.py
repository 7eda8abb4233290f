"""Progress of long work on stderr: counted, or of unknown duration such as compilation."""

import sys
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Thread
from time import perf_counter
from typing import TypeVar

T = TypeVar("T")
_TELLS = 10.0  # [s] between lines
_TERMINAL, _PIPE = 1.0, 5.0  # [s] between two reports
_REPORTED: ContextVar[bool] = ContextVar("_REPORTED", default=False)  # whether the work is a part of reported work


def counted(items: Iterable[T], title: str, total: int | None = None) -> Iterator[T]:
    """Yield the items and count them up to their `total` on stderr: a bar, or lines without a terminal.

    The lines are for notebooks and pipes: one every 10 s, with the remaining time. `total` is by default the length of
    the items.
    """
    from rich.console import Console
    from rich.progress import track

    if total is None:
        items = items if isinstance(items, Collection) else list(items)
        total = len(items)
    console = Console(stderr=True)
    if console.is_terminal:
        yield from track(items, title, total, console=console, transient=True)
        return
    began = told = perf_counter()
    for done, item in enumerate(items, 1):
        yield item
        if (now := perf_counter()) - told >= _TELLS:
            told, left = now, (now - began) / done * (total - done)
            print(f"{title}: {done} of {total}, about {left:.0f} s left", file=sys.stderr, flush=True)


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
    began, end, text = perf_counter(), "\r" if terminal else "\n", ""
    while not done.wait(_TERMINAL if terminal else _PIPE):
        text = f"{what}: {perf_counter() - began:.0f} s"
        print(text, end=end, file=sys.stderr, flush=True)
    if terminal and text:
        print(" " * len(text), end=end, file=sys.stderr, flush=True)
