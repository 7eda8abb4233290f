"""The loops of the search compiled by numba, once, and kept on disk next to this file or where NUMBA_CACHE_DIR says.

numba is not imported before. Where it is missing, is told not to compile (NUMBA_DISABLE_JIT), or finds no directory to
keep what it compiles, `compiled` answers None and plain Python does the work.
"""

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from allocator.search import arcs, curves, levels, loops, stretches

_FILES = curves, stretches, levels, arcs, loops
_OPTIONS = {"error_model": "numpy"}  # a division by zero is an infinity, not an exception


@cache
def compiled(name: str) -> Callable[..., Any] | None:
    """The loop of this name, compiled for each kind of arguments at its first call (some fifteen seconds), or None."""
    try:
        import numba
        from numba.extending import register_jitable

        if numba.config.DISABLE_JIT:
            return None
        for function in (function for file in _FILES for function in file.FUNCTIONS):
            register_jitable(**_OPTIONS)(function)
        return numba.njit(cache=True, nogil=True, **_OPTIONS)(_versioned(loops.LOOPS[name]))  # type: ignore[no-any-return]
    except ImportError:
        return None
    except RuntimeError as error:
        if "cannot cache function" not in str(error):
            raise
        return None


def _versioned(loop: Callable[..., Any]) -> Callable[..., Any]:
    """`loop` in a closure over a number that changes with the files that it is made of.

    To see whether what it has on disk is out of date numba compares the date of one file, and what a closure holds.
    """
    text = "".join(Path(str(file.__file__)).read_text(encoding="utf-8") for file in _FILES)
    version = int(sha256(text.encode()).hexdigest()[:12], 16)

    def entry(*arguments):  # type: ignore[no-untyped-def]
        return loop(*arguments) if version > 0 else None

    return entry


__all__ = ["compiled"]
