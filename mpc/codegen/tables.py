"""Tables of the addresses of arrays, whose fields compiled code reads by name where it needs them.

Compiled functions pass such a table as one number. A named tuple of its arrays would have seven numbers for each of
them, which every function would have to take, keep and pass on.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from numba.core import types
from numba.core.datamodel import models
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, register_model
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import from_dtype

from mpc.codegen.records import Records, dtype_of, kind_of, new_records, piece_of

if TYPE_CHECKING:
    from numba.core.base import BaseContext
    from numba.core.types import Type

R = TypeVar("R")


def table_of(values: NamedTuple) -> Records:
    """Return an array (1,) of the addresses of arrays, and of numbers, in the order of their record.

    Raises a `TypeError` for an array whose memory layout differs from the one that is read.
    """
    records = new_records(type(values))
    for name, value in zip(values._fields, values, strict=True):
        kind = kind_of(type(values), name)
        records[0][name] = piece_of(value, kind) if kind else value
    return records


class Table(types.Type):
    """Type of the address of a `table_of` a record, with that record's fields as attributes."""

    def __init__(self, record: type) -> None:
        self.offsets = {name: offset for name, (_, offset, *_) in (dtype_of(record).fields or {}).items()}
        self.kinds = {name: _kind(record, name) for name in get_type_hints(record)}
        super().__init__(f"Table({record.__module__}.{record.__qualname__})")


def _kind(record: type, name: str) -> Any:
    """Return the type of a field."""
    kind = kind_of(record, name)
    if kind is None:
        return from_dtype(dtype_of(record)[name])
    return types.Array(from_dtype(np.dtype(kind)), 1, "C")


def opened(record: type[R]) -> Callable[[int], R]:
    """Return the address of a `table_of` such a record ↦ the record, for compiled code."""
    table = Table(record)

    @intrinsic  # type: ignore[untyped-decorator]  # numba has no types
    def opens(typing: object, address: "Type") -> Any:
        return table(types.int64), lambda context, builder, signature, given: given[0]

    made: Callable[[int], R] = opens
    return made


@register_model(Table)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Table) -> None:
        super().__init__(manager, kind, manager[types.int64].get_value_type())


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    key = Table

    def generic_resolve(self, kind: Table, name: str) -> "Type | None":
        return kind.kinds.get(name)


@lower_getattr_generic(Table)  # type: ignore[untyped-decorator]
def _field(context: "BaseContext", builder: Any, kind: Table, address: Any, name: str) -> object:
    """Return a number, or the array of a `Piece`."""
    found, offset = kind.kinds[name], kind.offsets[name]

    def word(place: int) -> Any:
        where = builder.add(address, address.type(offset + 8 * place))
        return builder.load(builder.inttoptr(where, address.type.as_pointer()))

    if not isinstance(found, types.Array):
        return builder.bitcast(word(0), context.get_value_type(found))
    element = context.get_data_type(found.dtype)
    made, size = context.make_array(found)(context, builder), address.type(context.get_abi_sizeof(element))
    data = builder.inttoptr(word(0), element.as_pointer())
    populate_array(made, data=data, shape=[word(1)], strides=[size], itemsize=size, meminfo=None)
    return made._getvalue()
