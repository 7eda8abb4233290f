"""Compiling of functions by numba, once, kept on disk next to their file or where NUMBA_CACHE_DIR says.

numba is not imported before. Where it is missing, is told not to compile (NUMBA_DISABLE_JIT), or finds no directory of
the user's own to keep what it compiles (`allocator.compilation.cache`), `compiled` answers None and plain Python does
the work.
"""

from collections.abc import Callable, Iterable
from typing import Any

from allocator.errors import CacheFault, notice_once

Function = Callable[..., Any]

_OPTIONS = {"error_model": "numpy"}  # a division by zero is an infinity, not an exception: loops without branches


def compiled(function: Function, callees: Iterable[Function], *, inline: bool, unaliased: bool) -> Function | None:
    """Return `function`, compiled for each kind of arguments at its first call, or None if it cannot be.

    The `callees` it may call by their plain names, inlined or not; `unaliased` promises that no two of its arrays
    overlap and that it makes none, so that references need not be counted, which costs as much as a small loop.
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
    """Teach numba functions, so that compiled ones can call them by their plain names; arguments as in `compiled`."""
    from numba.extending import register_jitable

    for function in callees:
        register_jitable(forceinline=inline, _nrt=not unaliased, **_OPTIONS)(function)


def _unaliased() -> type:
    """Return a compiler that may assume that no two arrays overlap, and counts no references.

    Without the first loops over ten arrays do not vectorise.
    """
    from numba.core.compiler import Compiler

    class Unaliased(Compiler):  # type: ignore[misc]  # numba has no types
        def __init__(self, typingctx: object, targetctx: object, library: object, args: object, *rest: Any) -> None:
            flags = rest[1]
            flags.noalias = True
            flags.nrt = False
            super().__init__(typingctx, targetctx, library, args, *rest)

    return Unaliased
