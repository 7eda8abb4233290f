"""Printed functions compute what Python computes: every construct is run as it stands, for NumPy and, by gcc, as C."""

import ctypes
import linecache
import math
import subprocess
from itertools import product

import numpy as np
import pytest

from allocator import AntagonistError
from allocator.allocation.two_muscles.kernels import source
from allocator.allocation.two_muscles.kernels.choice import AffineNumbers, TonduNumbers
from allocator.compilation.printer import (
    INT,
    REAL,
    ArrayKind,
    Constants,
    Outside,
    Unprintable,
    array_functions,
    c_functions,
    with_called,
)

from ...rigs.needs import needs
from .constructs import BOTH_REFUSE, C_REFUSES, CONSTRUCTS, NUMPY_REFUSES
from .test_kernels import JOINTS, coefficients, mixed_targets

needs_gcc = needs("gcc")
STRICT = (
    "-std=c99",
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wdouble-promotion",
    "-Wfloat-equal",
    "-ffp-contract=off",
)
PREAMBLE = """#include <math.h>
#ifdef SINGLE
typedef float ant_real;
#define ANT_R(number) number##f
#define ANT_F(function) function##f
#else
typedef double ant_real;
#define ANT_R(number) number
#define ANT_F(function) function
#endif
#define ANT_INFINITY ((ant_real)INFINITY)
static inline ant_real ant_abs(ant_real x) { return x < 0 ? -x : x; }
static inline int ant_equal(ant_real a, ant_real b) { return a <= b && a >= b; }
"""


NUMBERS = (-2.0, -0.75, 0.0, 1.0, 2.25)
C = {"which": "ant_equal(which, 0)"}


def made_of(text):
    """The function `f` of a text, whose source is known."""
    space, file = {}, f"<{hash(text)}>"
    linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file  # for `inspect.getsource`
    exec(compile(text, file, "exec"), space)
    return space["f"]


def c_form(text, single=False, name="f", kinds=None, outside=Outside()):  # noqa: B008  # frozen
    """`f` and the functions that it calls as C, with real arguments."""
    made = with_called([made_of(text)])
    return c_functions(made, kinds or {}, single, {"f": name}, {}, outside._replace(usual=REAL))


def both(text):
    """The function in Python, and the rows of arguments to run it with."""
    f = made_of(text)
    more = [()] if f.__code__.co_argcount == 2 else [(0.0,), (2.0,)]
    return f, [(*pair, *which) for pair in product(NUMBERS, NUMBERS) for which in more]


def python_answers(f, rows):
    answers = []
    for row in rows:
        given = [None if i == 2 and x == 0 else x for i, x in enumerate(row)]
        try:
            answers.append(float(f(*given)))
        except ZeroDivisionError:
            answers.append(math.nan)  # C and NumPy have numbers for it
    return np.array(answers)


@pytest.mark.parametrize("text", CONSTRUCTS.values(), ids=CONSTRUCTS)
def test_every_construct_gives_an_array_what_it_gives_its_numbers(text):
    f, rows = both(text)
    wanted = python_answers(f, rows)
    for which in {row[2:] for row in rows}:
        chosen = np.array([row[2:] == which for row in rows])
        x, y = np.array(rows)[chosen, :2].T
        with np.errstate(all="ignore"):
            got = array_functions(f)[0](x, y, *(w or None for w in which)) + 0 * x
        fine = ~np.isnan(wanted[chosen])
        np.testing.assert_array_equal(got[fine], wanted[chosen][fine])


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "single"])
def test_every_construct_is_clean_c_and_computes_the_same(precision, tmp_path):
    made, single = [], precision == "single"
    for k, text in enumerate(CONSTRUCTS.values()):
        f, rows = both(text)
        printed = c_form(text, single, f"f_{k}", {"low": INT, "high": INT}, Outside(absent=C))
        (tmp_path / f"{k}.c").write_text(f"{PREAMBLE}\n{printed.head}\n{printed.body}\n")
        made.append((f"f_{k}", " int f" in f" {printed.head}", python_answers(f, rows), rows))
    flags = [*STRICT, *(["-DSINGLE"] if single else []), "-O1", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, *tmp_path.glob("*.c"), "-o", "all.so", "-lm"], cwd=tmp_path, check=True)
    library, real = ctypes.CDLL(str(tmp_path / "all.so")), ctypes.c_float if single else ctypes.c_double
    for name, whole, wanted, rows in made:
        function = library[name]
        function.restype, function.argtypes = ctypes.c_int if whole else real, [real] * len(rows[0])
        got, fine = np.array([function(*row) for row in rows]), ~np.isnan(wanted)
        assert got[fine] == pytest.approx(wanted[fine], rel=1e-6 if single else 0, abs=0), name


def test_what_is_said_in_python_is_said_in_c():
    printed = c_form(CONSTRUCTS["unused names and comments"]).body
    assert "/* Return theta^2 <= y. */" in printed
    assert printed.index("/* to be found again */") < printed.index("/* at the end */") < printed.index("return x + y;")


def test_names_numbers_and_arrays_can_be_c_s_own():
    text = "MET = 1e-9\ndef has(x): return x\n"
    text += "def f(x, p, one):\n    q, c = p\n    a, b = one\n    return has(q * x) + a * b + MET"
    kinds = {"p": Constants([("ANT_Q", REAL), ("ANT_C", INT)]), "one": ArrayKind(REAL, ("2",), True)}
    printed = c_form(text, name="g", kinds=kinds, outside=Outside({"has": "c_has_it", "MET": "ANT_MET"}))
    assert printed.head == "ant_real g(ant_real x, const ant_real *one);"
    assert "ant_real q = ANT_Q;" in printed.body
    assert "ant_real b = one[1];" in printed.body
    assert "return c_has_it(q * x) + a * b + ANT_MET;" in printed.body


@pytest.mark.parametrize("text", BOTH_REFUSE.values(), ids=BOTH_REFUSE)
def test_what_cannot_be_printed_is_refused_with_its_line(text):
    for form in (lambda text: array_functions(made_of(text))), c_form:
        with pytest.raises(Unprintable, match=r"line \d+ cannot be printed"):
            form(text)
    assert issubclass(Unprintable, AntagonistError)


@pytest.mark.parametrize("text", C_REFUSES.values(), ids=C_REFUSES)
def test_what_c_has_not_is_refused_with_its_line(text):
    with pytest.raises(Unprintable, match=r"line \d+ cannot be printed"):
        c_form(text)


@pytest.mark.parametrize("text", NUMPY_REFUSES.values(), ids=NUMPY_REFUSES)
def test_what_numpy_has_not_is_refused_with_its_line(text):
    with pytest.raises(Unprintable, match=r"line \d+ cannot be printed"):
        array_functions(made_of(text))


@pytest.mark.parametrize("limits", [(None, None), (0.0, None), (40.0, 400.0)], ids=str)
@pytest.mark.parametrize("slew", [(None, None, None), (2e5, 2.5e5, 4e4)], ids=["anywhere", "slew"])
@pytest.mark.parametrize("first", [None, True], ids=["torque", "stiffness"])
@pytest.mark.parametrize("joint", [JOINTS["report"], JOINTS["sarosi, unequal, lever"]], ids=["tondu", "affine"])
def test_the_kernels_for_arrays_give_the_digits_of_the_kernels(joint, first, slew, limits):
    theta, K, T = mixed_targets(joint, 400, seed=7)
    name = "tondu" if joint.tondu_pulley else "affine"
    numbers, sides = TonduNumbers.of(joint), []
    if name == "affine":
        numbers = AffineNumbers.of(joint)
        sides = [
            tuple(np.broadcast_to(c, theta.shape) for c in side)
            for side in coefficients(joint, np.clip(theta, *joint.angle_range))
        ]
    options = tuple(numbers), *limits, *slew, first
    exact = array_functions(getattr(source, f"{name}_exact"))[0]
    with np.errstate(all="ignore"):
        found = exact(theta, K, T, *sides, *options)
    plain = getattr(source, f"{name}_exact")
    rows = zip(
        theta.tolist(),
        K.tolist(),
        T.tolist(),
        *(zip(*(c.tolist() for c in s), strict=True) for s in sides),
        strict=True,
    )
    for array, one_by_one in zip(found, zip(*(plain(*row, *options) for row in rows), strict=True), strict=True):
        np.testing.assert_array_equal(np.broadcast_to(array, theta.shape), one_by_one)
