"""Resolved calls are kept while a function is compiled, and only then."""

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError
from numba.core.types.functions import BaseFunction

from allocator.compilation.resolution import remembering


def summed(x, y):
    total = 0.0
    for i in range(x.size):
        total += x[i] * y[i] + x[i] * y[i] - y[i]
    return total


@pytest.fixture
def tried(monkeypatch):
    """Calls that numba itself resolved."""
    calls, resolve = [], BaseFunction.get_call_type

    def counted(self, context, args, kws):
        calls.append((self.typing_key, tuple(args)))
        return resolve(self, context, args, kws)

    monkeypatch.setattr(BaseFunction, "get_call_type", counted)
    return calls


def test_no_call_is_resolved_twice(tried):
    x, y = np.arange(3.0), np.array([2.0, 5.0, 7.0])
    plain = numba.njit(summed)
    assert plain(x, y) == summed(x, y)
    assert len(tried) > len(set(tried))
    wanted = set(tried)
    tried.clear()
    kept = numba.njit(summed)
    with remembering():
        assert kept(x, y) == summed(x, y)
    assert len(tried) == len(set(tried))
    assert set(tried) == wanted
    assert kept.signatures == plain.signatures
    single = x.astype(np.float32), y.astype(np.float32)
    with remembering():  # for other types there is another answer
        assert kept(*single) == pytest.approx(summed(x, y))
    assert kept.signatures[-1] != plain.signatures[0]


def test_numba_resolves_by_itself_again_even_after_an_error():
    before = BaseFunction.get_call_type
    with pytest.raises(TypingError), remembering():
        numba.njit(lambda x: x + {})(1.0)
    assert BaseFunction.get_call_type is before
