"""Functions of `source` compiled by numba: at their first use, once, and kept on disk.

Where they cannot be compiled (`allocator.compilation.jit`) `kernel` answers None and the readable implementation does
the work.

In other compiled code a kernel is called like any compiled function:

    tondu_exact = kernel("tondu_exact")         # θ, K, T, p → P1, P2, T, K, status, limits, sure
    p = tuple(TonduNumbers.of(joint))           # `of` is None: not of this kind
    @numba.njit(error_model="numpy")
    def plan(theta, K, T, p): P1, P2, *_ = tondu_exact(theta, K, T, p)
"""

import sys
from functools import cache

from allocator.allocation.two_muscles.kernels import source
from allocator.compilation import jit


@cache
def kernel(name: str) -> jit.Function | None:
    """Return `source`'s function `name`, compiled for each kind of arguments at its first call; None if it cannot be.

    A compilation takes about a second.
    """
    return jit.compiled(getattr(source, name), source.FUNCTIONS, inline=True, unaliased=True)


@cache
def register() -> None:
    """Teach numba the functions of `source`, so that compiled functions can call each other by their plain names."""
    jit.register(source.FUNCTIONS, inline=True)


def threads() -> int:
    """Return how many threads compiled loops may use: numba's own number, by default that of processors; else 1."""
    numba = sys.modules.get("numba")
    return int(numba.config.NUMBA_NUM_THREADS) if numba else 1
