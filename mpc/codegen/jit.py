"""Functions are compiled alike: IEEE arithmetic, division by zero included, but products and sums may be fused."""

from collections.abc import Callable
from typing import TypeVar

from numba import config, njit

from allocator.calculus import Array
from allocator.compilation.cache import keep

if config.DISABLE_JIT:
    raise ImportError("numba is told not to compile")

KEPT = "antagonist_"  # begins the names of the modules whose compiled code is kept: hashes of all that it is made from
F = TypeVar("F", bound=Callable[..., object])
_OPTIONS: dict[str, object] = {"error_model": "numpy", "fastmath": {"contract"}}
_INNER: dict[str, object] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # they take long to compile

_COUNTED: dict[str, object] = {"_nrt": True}  # whoever calls
_FLAT: dict[str, object] = {"_nrt": False}


def compiled(function: F) -> F:
    """Compile `function` when it is first called; an `OSError` if the result is to be kept on disk and cannot be.

    numba sees when the file of a function changes, but not those of the functions that it calls: results are kept only
    of modules that `mpc.codegen.modules` names.
    """
    made: F = njit(**_OPTIONS)(function)
    return keep(made) if function.__module__.startswith(KEPT) else made


def exactly(function: F) -> F:
    """Compile `function` as `compiled` does, but fuse nothing: what comes out is what Python would give, bit by bit."""
    made: F = njit(error_model="numpy")(function)
    return keep(made) if function.__module__.startswith(KEPT) else made


def inlined(function: F) -> F:
    """Compile `function` as a part of compiled functions that call it; Python cannot."""
    made: F = njit(**_COUNTED, **_INNER, **_OPTIONS)(function)
    return made


def compiled_flat(function: F) -> F:
    """Compile `function` as `compiled` does, one that makes no arrays and returns none.

    References to arrays are not counted then, whose code takes as long to compile as a third of all the rest.
    """
    made: F = njit(**_FLAT, **_OPTIONS)(function)
    return keep(made) if function.__module__.startswith(KEPT) else made


def inlined_flat(function: F) -> F:
    """Compile `function` as `inlined` does, one that makes no arrays and returns none."""
    made: F = njit(**_FLAT, **_INNER, **_OPTIONS)(function)
    return made


def merged(function: F) -> F:
    """Compile `function` of numbers into its only caller, which then does not wait for a tuple to go through the
    memory.
    """
    made: F = njit(forceinline=True, **_FLAT, **_INNER, **_OPTIONS)(function)
    return made


@inlined
def assign(target: Array, source: Array) -> None:
    """Copy `source` into `target`, of the same shape.

    With `target[:] = source` numba compiles, for three seconds, what writes the message that two shapes differ.
    """
    for i in range(target.size):
        target.flat[i] = source.flat[i]
