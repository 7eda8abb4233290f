"""Records of fixed size that Python and compiled code read in place by the names of their fields.

A class states names and shapes once. `dtype_of` makes its NumPy dtype, and `mpc.codegen.addresses.opener` the function
that opens such a record in compiled code. A `Piece` is the address of an array of variable length.
"""

from collections.abc import Mapping
from functools import cache
from typing import Annotated, TypeAlias, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array

_NUMBERS: dict[object, str] = {float: "f8", int: "i8"}
Records: TypeAlias = np.recarray[tuple[int], np.dtype[np.void]]


class Piece:
    """The address of an array of numbers and their count."""

    address: int
    size: int


def dtype_of(record: type, **sizes: int) -> np.dtype[np.void]:
    """Return the dtype of a class of numbers, other such classes, and arrays or lists `Annotated` with a shape.

    Entries of a shape may be expressions of the `sizes`. An array without a shape is stored as its `Piece`.
    """
    return np.dtype([(name, *_kind(hint, sizes)) for name, hint in _hints(record).items()])


def kind_of(record: type, name: str) -> type[np.generic] | None:
    """Return the type of the numbers of a field that is an array without a shape; None for any other field."""
    return _numbers(_hints(record)[name])


@cache  # they are evaluated from text, a tenth of the time in which a controller is made
def _hints(record: type) -> Mapping[str, object]:
    return get_type_hints(record, include_extras=True)


def _numbers(hint: object) -> type[np.generic] | None:
    """Return the type of the numbers of an array, None for any other hint."""
    origin, given = get_origin(hint), get_args(hint)
    if origin is NDArray:  # from NumPy 2.5 on, an alias that is not replaced by its value
        return cast("type[np.generic]", given[0])
    return get_args(given[1])[0] if origin is np.ndarray else None


def _kind(hint: object, sizes: Mapping[str, int]) -> tuple[object, ...]:
    if get_origin(hint) is Annotated:
        elements, *given = get_args(hint)
        shape = tuple(int(eval(size, dict(sizes))) if isinstance(size, str) else size for size in given)
        return *(("f8",) if elements == Array else _kind(get_args(elements)[0], sizes)), shape
    if _numbers(hint) is not None:
        hint = Piece
    return (dtype_of(hint, **sizes) if isinstance(hint, type) and hint not in _NUMBERS else _NUMBERS[hint],)


def new_records(record: type, **sizes: int) -> Records:
    """Return an array (1,) of a record of zeros, with its numbers as attributes."""
    return np.zeros(1, dtype_of(record, **sizes)).view(np.recarray)


def numbers_of(records: Records, name: str) -> tuple[int, int]:
    """Return the `Piece` of a field of floats of the record in `new_records`."""
    assert records.dtype.fields is not None
    kind, offset = records.dtype.fields[name][:2]
    return records.ctypes.data + offset, kind.itemsize // np.dtype(float).itemsize


def piece_of(array: NDArray[np.generic], kind: type[np.generic] = np.float64) -> tuple[int, int]:
    """Return the `Piece` of an array of this kind, valid while the array lives, or raise a `TypeError`."""
    if array.dtype != kind or not (array.flags.c_contiguous and array.flags.aligned):
        raise TypeError(f"numbers of the kind {array.dtype} are not {kind.__name__} in one piece")
    return array.ctypes.data, array.size
