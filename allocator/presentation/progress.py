"""Progress of long work, on stderr."""

import sys
from collections.abc import Collection, Iterable, Iterator
from time import perf_counter
from typing import TypeVar

T = TypeVar("T")
_TELLS = 10.0  # [s] between lines


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
