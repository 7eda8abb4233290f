"""Compiled code finds by address what is not compiled into it: another module's function, the clock, Python's arrays.

A function that numba links is compiled into each of its callers anew, which for the solution of the QP takes longer
than all the rest of a step. By its address it is called in a nanosecond, and stays where it was made and kept. Nor are
arrays handed over one by one: numba opens and closes each, in 60 ns.
"""

import ctypes
import time
from collections.abc import Callable
from typing import Any

from numba import carray
from numba.core import cgutils, types
from numba.extending import intrinsic

from mpc.tracking.compiled.jit import inlined

_SETTLED: Any = types.Tuple((types.boolean, types.int64))  # type: ignore[attr-defined]


def address_of(settle: Any) -> int:
    """Return the address of `structured_qp.solve.settle`, which has been called with one kind of arguments.

    Raises a `TypeError` if it does not return what `settle_at` takes.
    """
    [made] = settle.overloads.values()
    if made.signature.return_type != _SETTLED:
        raise TypeError(f"{settle.__name__} returns {made.signature.return_type}, not {_SETTLED}")
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


def entry_of(function: Any, kinds: str) -> Callable[..., Any]:
    """Return what is compiled of `function` for arguments of these `kinds`, without numba's search for it by theirs."""
    function.compile(kinds)
    [made] = function.overloads.values()
    entry: Callable[..., Any] = made.entry_point
    return entry


def clock() -> tuple[int, int]:
    """Return the address of the clock of `perf_counter` in the C library and its name there; (0, 0): none is known."""
    known = getattr(time, "clock_gettime", None)
    address = ctypes.cast(ctypes.CDLL(None).clock_gettime, ctypes.c_void_p).value if known else None
    return (address, time.CLOCK_MONOTONIC) if address else (0, 0)


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def settle_at(
    typing: Any, address: Any, numbers: Any, starts: Any, given: Any, buffer: Any, guess: Any, z: Any
) -> tuple[Any, Any]:
    """Call `structured_qp.solve.settle`, which stands at this address."""
    arrays = (numbers, starts, given, buffer, guess, z)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        convention = context.call_conv
        pointer = convention.get_function_type(_SETTLED, arrays).as_pointer()
        function = builder.inttoptr(given[0], pointer)
        status, settled = convention.call_function(builder, function, _SETTLED, arrays, given[1:])
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return settled

    return _SETTLED(address, *arrays), generate


@intrinsic  # type: ignore[untyped-decorator]
def seconds_at(typing: Any, address: Any, name: Any) -> tuple[Any, Any]:
    """Return the time of the clock at this address [s], 0.0 if that is 0."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        from llvmlite import ir  # type: ignore[import-untyped]

        whole, narrow, number = ir.IntType(64), ir.IntType(32), ir.DoubleType()
        read = cgutils.alloca_once(builder, ir.ArrayType(whole, 2), zfill=True)  # struct timespec: [s], [ns]
        with builder.if_then(builder.icmp_signed("!=", given[0], whole(0))):
            function = builder.inttoptr(given[0], ir.FunctionType(narrow, [narrow, read.type]).as_pointer())
            builder.store(ir.Constant(read.type.pointee, None), read)
            builder.call(function, [builder.trunc(given[1], narrow), read])
        s, ns = (builder.sitofp(builder.extract_value(builder.load(read), i), number) for i in (0, 1))
        return builder.fadd(s, builder.fmul(ns, number(1e-9)))

    return types.float64(types.int64, types.int64), generate


def _pointer(kind: Any) -> Any:
    @intrinsic  # type: ignore[untyped-decorator]
    def pointer(typing: Any, address: Any) -> tuple[Any, Any]:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), generate  # type: ignore[attr-defined]

    return pointer


_floats, _integers, _signs = _pointer(types.float64), _pointer(types.int64), _pointer(types.int8)


@inlined
def floats_at(address: int, length: int) -> Any:
    """Return the array at this address."""
    return carray(_floats(address), length)


@inlined
def integers_at(address: int, length: int) -> Any:
    """Return the array at this address."""
    return carray(_integers(address), length)


@inlined
def signs_at(address: int, length: int) -> Any:
    """Return the array at this address."""
    return carray(_signs(address), length)


__all__ = ["address_of", "clock", "entry_of", "floats_at", "integers_at", "seconds_at", "settle_at", "signs_at"]
