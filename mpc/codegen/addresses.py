"""Addresses of the clock and of Python's arrays for compiled code, and calls without numba's dispatcher.

numba unpacks each array argument in 60 ns. An address costs nothing.
"""

import ctypes
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from numba import carray, from_dtype
from numba.core import cgutils, types
from numba.extending import intrinsic

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.codegen.records import Piece, dtype_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from llvmlite.ir import IRBuilder, Value
    from numba.core.base import BaseContext
    from numba.core.dispatcher import Dispatcher
    from numba.core.types import Type
    from numba.core.typing.templates import Signature

    Lowering = tuple[Signature, Callable[[BaseContext, IRBuilder, Signature, Sequence[Value]], Value]]


def entry_of(function: "Dispatcher", kinds: str) -> Callable[..., Any]:
    """Return the compiled entry of `function` for arguments of these `kinds`, without dispatch on types."""
    function.compile(kinds)
    [made] = function.overloads.values()
    entry: Callable[..., Any] = made.entry_point
    return entry


def clock() -> tuple[int, int]:
    """Return the address of the C clock behind `perf_counter` and its number, or (0, 0) if none is known."""
    known = getattr(time, "clock_gettime", None)
    address = ctypes.cast(ctypes.CDLL(None).clock_gettime, ctypes.c_void_p).value if known else None
    return (address, time.CLOCK_MONOTONIC) if address else (0, 0)


@intrinsic  # type: ignore[untyped-decorator]
def seconds_at(typing: object, address: "Type", name: "Type") -> "Lowering":
    """Return the time of the clock at this address [s], or 0.0 if the address is 0."""

    def generate(
        context: "BaseContext", builder: "IRBuilder", signature: "Signature", given: "Sequence[Value]"
    ) -> "Value":
        from llvmlite import ir

        whole, narrow, number = ir.IntType(64), ir.IntType(32), ir.DoubleType()
        read = cgutils.alloca_once(builder, ir.ArrayType(whole, 2), zfill=True)  # struct timespec: [s], [ns]
        with builder.if_then(builder.icmp_signed("!=", given[0], whole(0))):
            function = builder.inttoptr(given[0], ir.FunctionType(narrow, [narrow, read.type]).as_pointer())
            builder.store(ir.Constant(read.type.pointee, None), read)
            builder.call(function, [builder.trunc(given[1], narrow), read])
        s, ns = (builder.sitofp(builder.extract_value(builder.load(read), i), number) for i in (0, 1))
        return builder.fadd(s, builder.fmul(ns, number(1e-9)))

    return types.float64(types.int64, types.int64), generate


def opener(record: type, **sizes: int) -> "Dispatcher":
    """Return address ↦ the record (`mpc.codegen.records`) of these sizes at that address, for compiled code."""
    return _pointer(from_dtype(dtype_of(record, **sizes)))


def _pointer(kind: "Type") -> "Dispatcher":
    @intrinsic  # type: ignore[untyped-decorator]
    def pointer(typing: object, address: "Type") -> "Lowering":
        def generate(
            context: "BaseContext", builder: "IRBuilder", signature: "Signature", given: "Sequence[Value]"
        ) -> "Value":
            return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

        return kind(types.int64), generate

    made: Dispatcher = pointer
    return made


_floats = _pointer(types.CPointer(types.float64))  # type: ignore[attr-defined]


@inlined
def floats(piece: Piece) -> Array:
    """Return the array of a piece."""
    found: Array = carray(_floats(piece.address), piece.size)
    return found


@inlined
def floats_at(address: int, size: int) -> Array:
    """Return the array at an address without counting references to it."""
    found: Array = carray(_floats(address), size)
    return found
