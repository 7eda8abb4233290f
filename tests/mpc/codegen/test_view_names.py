"""Compiled functions that are generated have names of their own: kept code of another process must not take them."""

from mpc.codegen.views import measure, viewer
from mpc.tracking.compiled import records
from mpc.tracking.compiled.sample import layout as sampled


def test_no_two_generated_functions_have_one_name():
    viewed = [records.Given, records.Along, records.Setting, sampled.Made, sampled.State, sampled.Known]
    made = [*map(viewer, viewed), *map(measure, viewed)]
    names = {(function.py_func.__module__, function.py_func.__qualname__) for function in made}
    assert len(names) == len(made)
    assert all(module.startswith("mpc.") for module, _ in names)
