"""The loops of the search are compiled by numba here."""

from functools import cache
from hashlib import sha256
from pathlib import Path

from allocator.compilation import jit
from allocator.search import arcs, curves, loops, pairs, stretches

_FILES = curves, stretches, pairs, arcs, loops


@cache
def compiled(name: str) -> jit.Function | None:
    """Return the loop of this name, compiled for each kind of arguments at its first call (some fifteen seconds), or
    None.
    """
    callees = (function for file in _FILES for function in file.FUNCTIONS)
    return jit.compiled(_versioned(loops.LOOPS[name]), callees, inline=False, unaliased=False)


def _versioned(loop: jit.Function) -> jit.Function:
    """Return `loop` in a closure over a number that changes with the files that it is made of.

    To see whether what it has on disk is out of date numba compares the date of one file, and what a closure holds.
    """
    text = "".join(Path(str(file.__file__)).read_text(encoding="utf-8") for file in _FILES)
    version = int(sha256(text.encode()).hexdigest()[:12], 16)

    def entry(*arguments):  # type: ignore[no-untyped-def]
        return loop(*arguments) if version > 0 else None

    return entry
