"""Every operation of both tables, compiled and run, does what CasADi does: by numba, and by gcc in both precisions."""

import ctypes
import math
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numba import njit

from allocator import report_joint
from allocator.calculus import is_symbol
from allocator.errors import InvalidInput
from allocator.muscles import FunctionMuscle
from mpc.codegen import text as printer
from mpc.codegen.graphs import PYTHON, C, Untranslatable, operation_names
from mpc.codegen.jit import merged
from mpc.codegen.text import translated
from mpc.export import entry, export

from ...rigs import toolchain as tools
from ...rigs.needs import needs

RNG = np.random.default_rng(8)
ODD = (-math.inf, -710.5, -2.5, -1.0, -0.3, -0.0, 0.0, 1e-300, 0.3, 0.5, 1.0, 2.5, 710.5, math.inf, math.nan)
SOURCES = Path(entry.__file__).parent / "c"
MOST = 60  # outputs of a function that is compiled here


def unary(x):
    """CasADi's operations of one number."""
    return [
        -x, 2 * x, x * x, 1 / x, x**2.5, x**-1.3, ca.exp(x), ca.expm1(x), ca.log(x), ca.log1p(x), ca.sqrt(x), ca.sin(x),
        ca.cos(x), ca.tan(x), ca.asin(x), ca.acos(x), ca.atan(x), ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.asinh(x),
        ca.acosh(x), ca.atanh(x), ca.erf(x), ca.fabs(x), ca.floor(x), ca.ceil(x), ca.sign(x), ca.logic_not(x),
        x + math.inf, ca.fmin(x, math.inf), x * -math.inf, x + ca.SX(math.nan), ca.SX(3.5) * x, ca.SX(-0.0) * x,
    ]  # fmt: skip


def binary(x, y):
    """And of two."""
    return [
        x + y, x - y, x * y, x / y, x**y, ca.atan2(x, y), ca.hypot(x, y), ca.fmod(x, y), ca.copysign(x, y), x < y,
        x <= y, x == y, x != y, ca.logic_and(x, y), ca.logic_or(x, y), ca.if_else(x, y, 7.0), ca.if_else(x < y, x, y),
        ca.remainder(x, y),
    ]  # fmt: skip


def function_of(*outputs):
    """The CasADi function `all` of `x` and `y` with these outputs in one vector."""
    return ca.Function("all", ARGUMENTS, [ca.densify(ca.vertcat(*outputs))], ["x", "y"], ["out"])


ARGUMENTS = ca.SX.sym("x"), ca.SX.sym("y")
ALL = function_of(*unary(ARGUMENTS[0]), *binary(*ARGUMENTS))
BOTH = function_of(ca.fmin(*ARGUMENTS), ca.fmax(*ARGUMENTS))
CONSTANTS = function_of(math.inf, -math.inf, math.nan, -0.0, 0.1, 1e-300, ARGUMENTS[0] + 1e300)


def by_numba(function, folder=None):
    """The translation of the CasADi `function`, compiled as in `mpc.tracking.compiled`."""
    source, names = translated("law", function), {}
    exec(printer.IMPORTS + source.text, names)
    law = merged(names["law"])
    called = njit(lambda x, y, c: law(x, y, c), error_model="numpy")
    return lambda x, y: np.array(called(x, y, source.c))


def by_gcc(function, folder, single):
    """The C of the CasADi `function`, compiled as a shared library in `folder` without a warning."""
    text = printer.c_function(function, "all of them", single)
    (folder / "antagonist_config.h").write_text("#define ANT_SINGLE\n" if single else "\n")
    (folder / "model.c").write_text(f'#include "real.h"\n\n{printer.c_prototype(function)};\n\n{text}\n')
    flags = *tools.STRICT, "-O2", "-shared", "-fPIC", f"-I{SOURCES}", f"-I{SOURCES / 'allocate'}"
    command = ["gcc", *flags, "model.c", "-lm", "-o", "model.so"]
    subprocess.run(command, cwd=folder, check=True)
    real = ctypes.c_float if single else ctypes.c_double
    run = getattr(ctypes.CDLL(str(folder / "model.so")), f"ant_model_{function.name()}")

    def called(x, y):
        out = (real * MOST)()
        run(ctypes.byref(real(x)), ctypes.byref(real(y)), out)
        return np.array(out[: function.nnz_out(0)])

    return called


def rounded(x, dtype):
    """`x` as far as numbers of `dtype` go."""
    with np.errstate(over="ignore"):
        return np.asarray(x).astype(dtype).astype(float)


EXACT = {np.float64: (1e-14, 0.0), np.float32: (2e-6, 1.2e-38)}  # relative, and the least normal number


needs_gcc = needs("gcc")
COMPILERS = [
    pytest.param((np.float64, by_numba), id="numba"),
    pytest.param((np.float64, lambda *a: by_gcc(*a, single=False)), id="gcc, double", marks=needs_gcc),
    pytest.param((np.float32, lambda *a: by_gcc(*a, single=True)), id="gcc, single", marks=needs_gcc),
]


@pytest.fixture(scope="module", params=COMPILERS)
def way(request, tmp_path_factory):
    """A precision, and each of the functions with what a compiler made of it."""
    dtype, make = request.param
    folders = (tmp_path_factory.mktemp("codegen") for _ in range(3))
    return dtype, [(f, make(f, next(folders))) for f in (ALL, BOTH, CONSTANTS)]


def check(dtype, function, law, x, y):
    x, y = float(rounded(x, dtype)), float(rounded(y, dtype))
    wanted, found = rounded(function(x, y).full()[:, 0], dtype), law(x, y)
    rtol, atol = EXACT[dtype]
    np.testing.assert_allclose(found, wanted, rtol=rtol, atol=atol)
    return wanted, found


@pytest.mark.parametrize("x", ODD)
def test_every_operation_compiled_is_casadi_s(way, x):
    dtype, [(function, law), *_] = way
    for y in ODD:
        wanted, found = check(dtype, function, law, x, y)
        numbers = ~np.isnan(wanted)
        np.testing.assert_array_equal(np.signbit(found[numbers]), np.signbit(wanted[numbers]))  # of zeros, too


def test_every_operation_is_casadi_s_at_random(way):
    dtype, [(function, law), *_] = way
    for x, y in RNG.normal(0.0, 3.0, (300, 2)) * RNG.choice([0.1, 1.0, 3.0], (300, 1)):
        check(dtype, function, law, x, y)


def test_the_lesser_and_the_greater_of_two_are_casadi_s(way):
    dtype, [_, (function, law), _] = way
    for x, y in product(ODD, ODD):  # of 0 and -0 either may be the lesser
        x, y = float(rounded(x, dtype)), float(rounded(y, dtype))
        np.testing.assert_array_equal(law(x, y), rounded(function(x, y).full()[:, 0], dtype))


def test_every_constant_is_written_infinite_ones_and_none_too(way):
    dtype, [_, _, (function, law)] = way
    wanted, found = check(dtype, function, law, 1.0, 0.0)
    np.testing.assert_array_equal(np.signbit(found[3]), np.signbit(wanted[3]))


def test_both_tables_hold_the_same_operations_and_all_are_tried():
    tried = {operation_names()[f.instruction_id(k)] for f in (ALL, BOTH) for k in range(f.n_instructions())}
    tried -= {"OP_INPUT", "OP_CONST", "OP_OUTPUT"}
    assert {*PYTHON.operations} == {*C.operations} == tried | {"OP_ASSIGN"}  # CasADi does not leave it in a graph


def untabled():
    """CasADi's functions with an operation of numbers that no table has."""
    x, y = ARGUMENTS
    inner = ca.Function("inner", [x], [ca.sin(x)], {"never_inline": True})
    return {"OP_ERFINV": ca.erfinv(x), "OP_PRINTME": x.printme(y), "OP_CALL": inner(x)}


@pytest.mark.parametrize("name", untabled())
def test_an_operation_without_translation_is_said_with_the_table(name):
    function = ca.Function("error", ARGUMENTS, [untabled()[name]], ["x", "y"], ["out"])
    with pytest.raises(Untranslatable, match=f"the function error uses CasADi's {name}, .* table .* Python has not"):
        translated("law", function)
    with pytest.raises(InvalidInput, match=f"cannot be exported: .* uses CasADi's {name}, .* for C has not"):
        printer.c_function(function, "what cannot be", single=False)


def test_every_operation_that_casadi_counts_as_elementary_is_in_the_tables():
    assert {name for number, name in operation_names().items() if number < ca.OP_CONST} <= {*PYTHON.operations}


def test_a_function_that_is_too_long_to_compile_is_said(monkeypatch):
    monkeypatch.setattr(printer, "_LONGEST", 10)
    with pytest.raises(Untranslatable, match=r"law's function law has \d+ operations, more than the 10"):
        translated("law", ALL)


def test_the_printer_follows_the_table(monkeypatch):
    monkeypatch.setattr(printer, "PYTHON", replace(PYTHON, operations={"OP_SIN": "float({0} > 0.0)"}))
    function = ca.Function("one", ARGUMENTS, [ca.sin(ARGUMENTS[0])], ["x", "y"], ["out"])
    assert "v0 = float(i0_0 > 0.0)" in translated("law", function).text


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_muscle_is_exported_whatever_functions_its_law_takes(precision, tmp_path):
    # `arctan` was in the table for Python only: this muscle could be tracked, and not exported
    muscle = FunctionMuscle(
        lambda eps: 3e-4 * (1 - 1.6 * (ca.atan(eps) if is_symbol(eps) else np.arctan(eps))), lambda eps: -40 * eps
    )
    out = export(tmp_path / "c", joint=report_joint(muscle), what="allocate", precision=precision)
    printed = tools.run(tools.compiled(out, out / "main.c", "demonstration"))
    assert "atan" in (out / "src" / "model.c").read_text()
    assert "status 0" in printed
