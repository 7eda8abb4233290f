"""Tables of arrays and parts of arrays are in compiled code what they are in Python."""

from typing import Generic, NamedTuple, TypeVar

import numpy as np
import pytest
from numba.core.errors import TypingError
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen import records
from mpc.codegen.jit import compiled, inlined
from mpc.codegen.tables import opened, table_of
from mpc.codegen.views import part

pytestmark = pytest.mark.compiles


class Held(NamedTuple):
    """Arrays of every kind, and numbers between them."""

    x: Array
    count: int
    places: NDArray[np.int64]
    signs: NDArray[np.int8]
    share: float


held_at = opened(Held)


def test_compiled_code_reads_and_writes_the_arrays_of_a_table():
    held = Held(np.array([0.5, -1.5, 7.0]), -3, np.array([4, -5]), np.array([1, -2, 3, -4], np.int8), 0.25)

    @inlined
    def second(held):
        return held.x[1] * held.share

    @compiled
    def read(address):
        held = held_at(address)
        held.x[2], held.signs[3] = held.places[1], 9
        return held.x.size, held.places.size, held.signs.size, held.count, held.signs[1], second(held)

    table = table_of(held)
    assert read(table.ctypes.data) == (3, 2, 4, -3, -2, -0.375)
    np.testing.assert_array_equal(held.x, [0.5, -1.5, -5.0])
    np.testing.assert_array_equal(held.signs, [1, -2, 3, 9])


def test_an_unknown_field_of_a_table_is_not_compiled():
    @compiled
    def wrong(address):
        return held_at(address).y

    with pytest.raises(TypingError, match="Unknown attribute 'y'"):
        wrong(0)


@pytest.mark.parametrize("shape", [(5,), (2, 3), (2, 1, 4)])
def test_a_part_is_the_same_view_in_compiled_code(shape):
    @compiled
    def filled(flat, begin, shape, value):
        view = part(flat, begin, shape)
        total = view.sum()
        view[...] = value
        return total, view.shape, view.strides

    flat = np.arange(12.0)
    expected = part(flat, 3, shape)
    assert filled(flat.copy(), 3, shape, 0.0) == (expected.sum(), shape, expected.strides)
    filled(flat, 3, shape, -1.0)
    size = expected.size
    np.testing.assert_array_equal(flat, [0, 1, 2, *[-1.0] * size, *range(3 + size, 12)])


Number = TypeVar("Number")


class Alias(Generic[Number]):
    """An alias that is not replaced by its value, which `NDArray` is from NumPy 2.5 on."""


class Pieces:
    """An array of each kind, by the alias and written out."""

    counts: Alias[np.int8]
    numbers: np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def test_arrays_are_pieces_whether_their_alias_is_replaced_or_not(monkeypatch):
    monkeypatch.setattr(records, "NDArray", Alias)
    assert [records.kind_of(Pieces, name) for name in ("counts", "numbers")] == [np.int8, np.float64]
    assert set(records.dtype_of(Pieces)["counts"].names) == {"address", "size"}
