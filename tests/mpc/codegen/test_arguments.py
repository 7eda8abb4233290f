"""Arguments that are described in memory are those that compiled code reads and writes."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import typeof

from mpc.codegen.addresses import described, described_at
from mpc.codegen.jit import compiled

pytestmark = pytest.mark.compiles


class Two(NamedTuple):
    """A record of arrays."""

    numbers: np.ndarray
    signs: np.ndarray


def test_arrays_numbers_and_tuples_are_read_and_arrays_are_written():
    A, mask = np.arange(24.0).reshape(2, 3, 4), np.array([False, True, True])
    two = Two(np.array([[0.5, -1.5]]), np.array([1, -1, 2], np.int8))
    given = A, mask, np.array([7, -8]), two, True, False, 0.25, -3
    given_at = described_at(tuple(map(typeof, given)))

    @compiled
    def read(address):
        B, held, places, pair, yes, no, value, count = given_at(address)
        B[0, 1, 0] = -100.0
        pair.signs[0] = 5
        sizes = B.shape, held.size, places.size, pair.numbers.shape, pair.signs.size
        return sizes, B[1, 2, 1], held[0], held[2], places[1], pair.numbers[0, 1], pair.signs[2], yes, no, value, count

    words = described(*given)
    sizes = (2, 3, 4), 3, 2, (1, 2), 3
    assert read(words.ctypes.data) == (sizes, 21.0, False, True, -8, -1.5, 2, True, False, 0.25, -3)
    assert A[0, 1, 0] == -100.0
    assert two.signs[0] == 5
    first = described(A[:1], *given[1:])
    assert read(first.ctypes.data)[0][0] == (1, 3, 4)
