"""Answers of numba are kept while a function is compiled, and only then."""

import numba
import numpy as np
import pytest
from numba.core.base import BaseContext
from numba.core.compiler import Flags
from numba.core.errors import TypingError
from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction

from allocator.compilation.cache import remembering


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


def test_no_type_is_measured_twice(monkeypatch):
    asked, measure = [], BaseContext.get_abi_sizeof

    def counted(self, kind):
        asked.append(str(kind))
        return measure(self, kind)

    monkeypatch.setattr(BaseContext, "get_abi_sizeof", counted)
    x, y = np.arange(3.0), np.array([2.0, 5.0, 7.0])
    numba.njit(summed)(x, y)
    assert len(asked) > len(set(asked))
    wanted = set(asked)
    asked.clear()
    with remembering():
        numba.njit(summed)(x, y)
    assert len(asked) == len(set(asked))
    assert set(asked) == wanted


def test_options_are_those_that_numba_lists():
    flags = Flags()
    flags.nrt, flags.error_model = True, "numpy"
    wanted = flags.values()
    with remembering():
        assert flags.values() == wanted
        assert list(flags.values()) == list(wanted)
        assert flags == flags.copy()
        assert flags != Flags()


def test_numba_asks_by_itself_again_even_after_an_error():
    before = methods()
    with remembering():
        assert all(now is not then for now, then in zip(methods(), before, strict=True))
    with pytest.raises(TypingError), remembering():
        numba.njit(lambda x: x + {})(1.0)
    assert methods() == before


def methods():
    return BaseFunction.get_call_type, BaseContext.get_abi_sizeof, TargetConfig.values
