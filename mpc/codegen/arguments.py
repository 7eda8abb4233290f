"""Arguments that lie ready in memory, for calls of compiled functions by their addresses.

Making and carving arrays takes numba longer to compile than filling them. A caller whose arrays stay the same describes
them once, in words of eight bytes: a number by itself, an array by the address of its data, its shape and its strides,
a tuple by its items.
"""

from collections.abc import Iterator, Sequence
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

if TYPE_CHECKING:
    from numba.core.base import BaseContext
    from numba.core.dispatcher import Dispatcher
    from numba.core.types import Type
    from numba.core.typing.templates import Signature

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
