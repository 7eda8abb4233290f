"""Addresses of the clock and of Python's arrays for compiled code, and calls without numba's dispatcher.

numba opens and closes each array that it is handed over, in 60 ns. An address costs nothing.
"""

import ctypes
import time
from collections.abc import Callable
from typing import Any

from numba import carray, from_dtype
from numba.core import cgutils, types
from numba.extending import intrinsic

from mpc.codegen.jit import inlined
from mpc.codegen.records import Piece, dtype_of


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


def opener(record: type) -> Any:
    """Return address ↦ the record (`mpc.codegen.records`) that stands there, for compiled code."""
    return _pointer(from_dtype(dtype_of(record)))


def _pointer(kind: Any) -> Any:
    @intrinsic  # type: ignore[untyped-decorator]
    def pointer(typing: Any, address: Any) -> tuple[Any, Any]:
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

        return kind(types.int64), generate

    return pointer


_floats, _integers, _signs = (
    _pointer(types.CPointer(kind))  # type: ignore[attr-defined]
    for kind in (types.float64, types.int64, types.int8)
)


@inlined
def floats(piece: Piece) -> Any:
    """Return the array of a piece."""
    return carray(_floats(piece.address), piece.size)


@inlined
def integers(piece: Piece) -> Any:
    """Return the array of a piece."""
    return carray(_integers(piece.address), piece.size)


@inlined
def signs(piece: Piece) -> Any:
    """Return the array of a piece."""
    return carray(_signs(piece.address), piece.size)


@inlined
def floats_at(address: int, size: int) -> Any:
    """Return the array at an address, whose references are not counted."""
    return carray(_floats(address), size)
