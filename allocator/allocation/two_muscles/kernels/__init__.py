"""Functions of `source` compiled by numba at their first use and cached on disk.

If they cannot be compiled (`allocator.compilation.jit`), `kernel` returns None and the readable implementation does the
work.

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
    """Return the function `name` of `source`, compiled at the first call with each argument signature, or None.

    A compilation takes about a second.
    """
    return jit.compiled(getattr(source, name), source.FUNCTIONS, inline=True, unaliased=True)


@cache
def register() -> None:
    """Register the functions of `source`, so that compiled functions can call each other by their plain names."""
    jit.register(source.FUNCTIONS, inline=True)


def threads() -> int:
    """Return the number of threads of compiled loops: numba's own, by default that of processors; else 1."""
    numba = sys.modules.get("numba")
    return int(numba.config.NUMBA_NUM_THREADS) if numba else 1
