"""Addresses of the clock and of Python's arrays for compiled code, and calls without numba's dispatcher.

numba unpacks each array argument in 60 ns. An address costs nothing.

Arguments may also lie ready in memory. Making and carving arrays takes numba longer to compile than filling them. A
caller whose arrays stay the same describes them once, in words of eight bytes: a number by itself, an array by the
address of its data, its shape and its strides, a tuple by its items.
"""

import ctypes
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import carray, from_dtype
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.codegen.records import Piece, dtype_of

if TYPE_CHECKING:
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


Words = NDArray[np.int64]


def described(*values: object) -> Words:
    """Return the words of these arguments, valid while their arrays live."""
    return np.array([word for value in values for word in _words(value)], np.int64)


def _words(value: Any) -> Iterator[int]:
    if isinstance(value, tuple):
        for item in value:
            yield from _words(item)
    elif isinstance(value, np.ndarray):
        yield from (value.ctypes.data, *value.shape, *value.strides)
    else:
        yield int(np.float64(value).view(np.int64)) if isinstance(value, float) else int(value)


def described_at(kinds: "tuple[Type, ...]") -> "Dispatcher":
    """Return the address of words ↦ the tuple of arguments of these `kinds`, for compiled code."""

    @intrinsic  # type: ignore[untyped-decorator]  # numba has no types
    def arguments(typing: object, address: "Type") -> "tuple[Signature, object]":
        def generate(context: "BaseContext", builder: Any, signature: "Signature", given: Sequence[Any]) -> object:
            whole = context.get_value_type(types.int64)
            words, places = builder.inttoptr(given[0], whole.as_pointer()), count()

            def word() -> Any:
                return builder.load(builder.gep(words, [whole(next(places))]))

            return _value(context, builder, signature.return_type, word)

        return types.Tuple(kinds)(types.int64), generate  # type: ignore[attr-defined]

    made: Dispatcher = arguments
    return made


def _value(context: Any, builder: Any, kind: Any, word: Any) -> object:
    """Return a value of this `kind`, read word by word."""
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        return context.make_tuple(builder, kind, [_value(context, builder, part, word) for part in kind])
    if not isinstance(kind, types.Array):
        stored = context.get_value_type(kind)
        return builder.bitcast(word(), stored) if isinstance(kind, types.Float) else builder.trunc(word(), stored)
    made, element = context.make_array(kind)(context, builder), context.get_data_type(kind.dtype)
    data = builder.inttoptr(word(), element.as_pointer())
    shape, strides = ([word() for _ in range(kind.ndim)] for _ in range(2))
    size = context.get_constant(types.intp, context.get_abi_sizeof(element))
    populate_array(made, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
    return made._getvalue()
