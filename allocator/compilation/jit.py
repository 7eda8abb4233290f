"""Compilation of functions by numba, cached on disk next to their file or in NUMBA_CACHE_DIR.

numba is imported on first use. If it is missing, disabled (NUMBA_DISABLE_JIT), or has no private cache directory
(`allocator.compilation.cache`), `compiled` returns None and plain Python does the work.
"""

from collections.abc import Callable, Iterable
from typing import Any

from allocator.errors import CacheFault, notice_once

Function = Callable[..., Any]

_OPTIONS = {"error_model": "numpy"}  # a division by zero is an infinity, not an exception: loops without branches


def compiled(function: Function, callees: Iterable[Function], *, inline: bool, unaliased: bool) -> Function | None:
    """Return `function`, compiled at the first call with each argument signature, or None if it cannot be.

    It may call the `callees` by their plain names, inlined or not. `unaliased` promises that no two of its arrays
    overlap and that it creates none, which saves reference counting (as costly as a small loop).
    """
    try:
        import numba

        from allocator.compilation.cache import Refused, keep
    except ImportError:
        return None
    if numba.config.DISABLE_JIT:
        return None
    callees = tuple(callees)
    register(callees, inline=inline, unaliased=unaliased)
    options = {"pipeline_class": _unaliased()} if unaliased else {}
    made: Function = numba.njit(nogil=True, **_OPTIONS, **options)(function)
    try:
        return keep(made, callees)
    except Refused as refusal:
        notice_once(f"allocate works without compiled code: {refusal}", CacheFault)
        return None
    except OSError:  # there is no such directory
        return None


def register(callees: Iterable[Function], *, inline: bool, unaliased: bool = False) -> None:
    """Register functions that compiled ones may call by their plain names; arguments as in `compiled`."""
    from numba.extending import register_jitable

    from allocator.compilation.linked import INNER

    for function in callees:
        register_jitable(forceinline=inline, _nrt=not unaliased, **_OPTIONS, **INNER)(function)


def _unaliased() -> type:
    """Return a compiler that assumes that no two arrays overlap and does not count references.

    Loops over ten arrays do not vectorise without the first assumption.
    """
    from numba.core.compiler import Compiler

    class Unaliased(Compiler):  # type: ignore[misc]  # numba has no types
        def __init__(self, typingctx: object, targetctx: object, library: object, args: object, *rest: Any) -> None:
            flags = rest[1]
            flags.noalias = True
            flags.nrt = False
            super().__init__(typingctx, targetctx, library, args, *rest)

    return Unaliased
