"""Functions that are only linked into others compute the same, and have no machine code of their own."""

import numpy as np
import pytest
from numba import config, njit
from numba.core.codegen import JITCodeLibrary

from allocator.compilation.linked import INNER, Calling, Linked


@njit(**INNER)
def squares(n):
    if n < 0:
        raise ValueError("negative")
    made = np.empty(n)
    for i in range(n):
        made[i] = float(i) ** 2
    return made


@njit(**INNER)
def total(n):
    return squares(n).sum()


@njit
def mean(n):
    return total(n) / n


def test_nested_functions_compute_what_python_computes():
    assert mean(7) == np.mean(np.arange(7.0) ** 2)


def test_an_exception_comes_through():
    with pytest.raises(ValueError, match="negative"):
        mean(-1)


def test_only_the_outermost_has_machine_code():
    mean(3)
    inner, outer = (next(iter(f.overloads.values())).library for f in (total, mean))
    assert isinstance(inner, Linked)
    names = [f.name for f in inner.get_defined_functions()]
    assert names
    assert all(inner.get_pointer_to_function(name) == 0 for name in names)
    assert not isinstance(outer, Linked)
    assert any(outer.get_pointer_to_function(f.name) for f in outer.get_defined_functions())


def test_inner_functions_are_simplified_at_a_low_level_and_others_as_usual(monkeypatch):
    levels, simplify = set(), JITCodeLibrary._optimize_functions

    def noted(self, module):
        levels.add((isinstance(self, Linked), int(config.OPT)))
        simplify(self, module)

    monkeypatch.setattr(JITCodeLibrary, "_optimize_functions", noted)
    doubled = njit(**INNER)(lambda x: 2 * x)
    assert njit(lambda x: doubled(x) + 1)(3) == 7
    assert levels == {(True, 1), (False, int(config.OPT))}
    assert config.OPT > 1


def test_calling_functions_are_optimised_with_superword_parallelism_which_is_off_afterwards(monkeypatch):
    asked, optimise, before = [], JITCodeLibrary._optimize_final_module, config.SLP_VECTORIZE

    def noted(self):
        asked.append(config.SLP_VECTORIZE)
        optimise(self)

    monkeypatch.setattr(JITCodeLibrary, "_optimize_final_module", noted)
    made = njit(pipeline_class=Calling)(lambda x: total(x) + 1)
    assert made(3) == 6
    assert asked == [1]
    assert config.SLP_VECTORIZE == before
