"""The functions of `kernels` compiled by numba: when they are used, once, and kept on disk.

numba is not imported before. Where it is missing, is told not to compile (NUMBA_DISABLE_JIT), or finds no directory to
keep what it compiles, `kernel` answers None and the readable implementation does the work.

In other compiled code a law is called like any compiled function:

    tondu_exact = kernel("tondu_exact")         # θ, K, T, p → P1, P2, T, K, status, limits, sure
    p = tuple(TonduNumbers.of(joint))           # `joint_numbers`; of(joint) is None: not of this kind
    @numba.njit(error_model="numpy")
    def plan(theta, K, T, p): P1, P2, *_ = tondu_exact(theta, K, T, p)
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from allocator.allocation import kernels

_OPTIONS = {"error_model": "numpy"}  # a division by zero is an infinity, not an exception: loops without branches


@cache
def kernel(name: str) -> Callable[..., Any] | None:
    """The function `name` of `kernels`, compiled (for each kind of arguments at its first call); None if it cannot be.

    A compilation takes about a second and is kept on disk, next to this package or where NUMBA_CACHE_DIR says.
    """
    try:
        register()
        import numba

        if numba.config.DISABLE_JIT:
            return None
        options = {"cache": True, "nogil": True, "pipeline_class": _unaliased(), **_OPTIONS}
        return numba.njit(**options)(getattr(kernels, name))  # type: ignore[no-any-return]  # numba has no types
    except ImportError:
        return None
    except RuntimeError as error:
        if "cannot cache function" not in str(error):
            raise
        return None


@cache
def register() -> None:
    """Teach numba the laws, so that compiled functions can call each other by their plain names."""
    from numba.extending import register_jitable

    for law in kernels.LAWS:
        register_jitable(forceinline=True, **_OPTIONS)(law)


def threads() -> int:
    """How many threads compiled loops may use: numba's own number, by default that of the processors."""
    import numba

    return int(numba.config.NUMBA_NUM_THREADS)


def _unaliased() -> type:
    """A compiler that may assume that no two arrays overlap: without this loops over ten arrays do not vectorise."""
    from numba.core.compiler import Compiler

    class Unaliased(Compiler):  # type: ignore[misc]  # numba has no types
        def __init__(self, typingctx: Any, targetctx: Any, library: Any, args: Any, *rest: Any) -> None:
            flags = rest[1]
            flags.noalias = True
            super().__init__(typingctx, targetctx, library, args, *rest)

    return Unaliased


__all__ = ["kernel", "register", "threads"]
