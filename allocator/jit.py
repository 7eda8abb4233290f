"""Functions compiled by numba, once, and kept on disk next to their file or where NUMBA_CACHE_DIR says.

numba is not imported before. Where it is missing, is told not to compile (NUMBA_DISABLE_JIT), or finds no directory to
keep what it compiles, `compiled` answers None and plain Python does the work.
"""

from collections.abc import Callable, Iterable
from typing import Any

Function = Callable[..., Any]

_OPTIONS = {"error_model": "numpy"}  # a division by zero is an infinity, not an exception: loops without branches


def compiled(function: Function, callees: Iterable[Function], *, inline: bool, unaliased: bool) -> Function | None:
    """`function`, compiled for each kind of arguments at its first call, or None if it cannot be.

    The `callees` it may call by their plain names, inlined or not; `unaliased` promises that no two of its arrays
    overlap.
    """
    try:
        register(callees, inline=inline)
        import numba

        if numba.config.DISABLE_JIT:
            return None
        options = {"pipeline_class": _unaliased()} if unaliased else {}
        return numba.njit(cache=True, nogil=True, **_OPTIONS, **options)(function)  # type: ignore[no-any-return]
    except ImportError:
        return None
    except RuntimeError as error:
        if "cannot cache function" not in str(error):
            raise
        return None


def register(callees: Iterable[Function], *, inline: bool) -> None:
    """Teach numba functions, so that compiled ones can call them by their plain names."""
    from numba.extending import register_jitable

    for function in callees:
        register_jitable(forceinline=inline, **_OPTIONS)(function)


def _unaliased() -> type:
    """A compiler that may assume that no two arrays overlap: without this loops over ten arrays do not vectorise."""
    from numba.core.compiler import Compiler

    class Unaliased(Compiler):  # type: ignore[misc]  # numba has no types
        def __init__(self, typingctx: Any, targetctx: Any, library: Any, args: Any, *rest: Any) -> None:
            flags = rest[1]
            flags.noalias = True
            super().__init__(typingctx, targetctx, library, args, *rest)

    return Unaliased


__all__ = ["compiled", "register"]
