"""What is put off until somebody looks is what it would have been, whoever looks, and whenever."""

import pickle
from copy import deepcopy

import numpy as np
import pytest

from mpc.tracking.plan import Deferred


class Counted(Deferred):
    """An object that counts how often it is filled in."""

    _put_off = "value", "double"

    def __init__(self):
        self.value, self.double, self.filled = 1, 2, 0

    def fill(self, value):
        self.value, self.double, self.filled = value, 2 * value, self.filled + 1


def test_it_is_filled_in_once_by_the_last_that_was_deferred():
    one = Counted()
    for value in (3, 4, 5):
        one.defer(Counted.fill, value)
    assert one.filled == 0
    assert (one.double, one.value, one.filled) == (10, 5, 1)
    one.defer(Counted.fill, 6)
    one.catch_up()
    one.catch_up()
    assert (one.__dict__["value"], one.filled) == (6, 2)


@pytest.mark.parametrize("copied", [deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copy", "pickle"])
def test_a_copy_is_filled_in(copied):
    one = Counted()
    one.defer(Counted.fill, 7)
    assert copied(one).__dict__ == {"value": 7, "double": 14, "filled": 1}


def test_what_is_not_there_at_all_is_said():
    one = Counted()
    for _ in range(2):
        with pytest.raises(AttributeError, match="a Counted has no 'valeu'"):
            _ = one.valeu
        one.defer(Counted.fill, np.pi)
