"""A library that is missing is named by our own imports, and by nobody else's."""

import builtins
import importlib
import importlib.util
import sys

import pytest

from allocator import MissingPackage, errors


@pytest.fixture
def without(monkeypatch):
    """Take a library away: no finder but ours knows it."""

    def take(name):
        monkeypatch.delitem(sys.modules, name, raising=False)
        ours = [finder for finder in sys.meta_path if isinstance(finder, errors._NameMissing)]
        monkeypatch.setattr(sys, "meta_path", ours)

    return take


def as_if_in(module, statement):
    exec(compile(statement, "x.py", "exec"), {"__name__": module, "__builtins__": builtins})


def test_our_own_import_of_what_is_missing_says_how_to_install_it(without):
    without("cma")
    with pytest.raises(MissingPackage, match="this needs cma, which is not installed: pip install cma"):
        as_if_in("allocator.somewhere", "import cma")
    with pytest.raises(ModuleNotFoundError) as other:
        as_if_in("somebody.else_", "import cma")
    assert not isinstance(other.value, MissingPackage)


def test_to_look_for_a_library_is_no_import(without):
    without("cma")
    assert importlib.util.find_spec("cma") is None


@pytest.mark.parametrize(
    ("library", "extra"), [("mujoco", "mujoco"), ("osqp", "solvers"), ("gymnasium", "gym"), ("pymodbus", "modbus")]
)
def test_an_extra_is_named_by_its_extra(without, library, extra):
    without(library)
    with pytest.raises(MissingPackage, match=rf"pip install 'antagonist\[{extra}\]'"):
        as_if_in("mpc.somewhere", f"import {library}")


def test_there_is_one_finder_however_often_it_is_asked_for():
    errors.name_what_is_missing()
    assert sum(isinstance(finder, errors._NameMissing) for finder in sys.meta_path) == 1
    assert importlib.import_module("osqp")
