"""Python's functions of arrays and the C that is printed of them compute the same."""

import ctypes
import subprocess
from typing import NamedTuple

import numpy as np
import pytest

from allocator.compilation.printer import (
    INT,
    REAL,
    ArrayKind,
    StructKind,
    Unprintable,
    c_functions,
    with_called,
)

from ...rigs import toolchain as tools
from ...rigs.needs import needs
from .test_operations import SOURCES

N, SCALE, WIDTH = 5, 0.25, (1.0, 2.0, 4.0)


class Box(NamedTuple):
    lower: np.ndarray
    upper: np.ndarray


class Work(NamedTuple):
    box: Box
    places: np.ndarray


def assign(target, source):
    """Copy as `mpc.codegen.jit.assign` does, which only compiled functions can call."""
    target[:] = source


def ends(x):
    """Return the least and the greatest of `x`, and whether all are finite."""
    least, greatest, sound = x[0], x[0], True
    for i in range(1, x.shape[0]):
        least, greatest = min(least, x[i]), max(greatest, x[i])
    for i in range(x.size):
        sound = sound and np.isfinite(x[i])
    return least, greatest, sound


def inside(box, x):
    """Return how many of `x` are within the box."""
    lower, upper = box
    number = 0
    for i in range(len(x)):
        number += 1 if lower[i] <= x[i] < upper[i] else 0
    return number


def mixed(work, x, out):
    """Fill `out` (5, 3) by all that is printed otherwise than it stands, and return a number."""
    box, lower = work.box, work.box.lower
    own, sums = x.copy(), np.zeros((2, 3))
    out[:, 0], out[1:, 1], out[:2, 2], out[2:, 2] = SCALE, -1.0, 3.0, 0.0
    out[0, 1:] = lower[0]
    least, greatest, sound = ends(own)
    found = inside(work.box, x)
    any_negative = False
    for k in work.places:
        any_negative |= x[k] < 0.0
        low, high = (x[k], WIDTH[1]) if x[k] < WIDTH[1] else (WIDTH[1], x[k])
        own[k] = sums[0, 1] = high**2 - low**3
        sums[1, 2] += max(low, high, 1.5, own[k])
    if sound and not any_negative:
        assign(own, work.box.upper)
        out[1, 1:3] = own[4]
    return float(sums[0, 1] + sums[1, 2] + least * greatest + found + 10.0 ** out[0, 0] + abs(box.upper[0]))


KINDS = {
    "x": ArrayKind(REAL, (str(N),), True),
    "out": ArrayKind(REAL, (str(N), "3")),
    "box": StructKind("box", dict.fromkeys(("lower", "upper"), ArrayKind(REAL, (str(N),), True)), False),
}
KINDS["work"] = StructKind("work", {"box": KINDS["box"], "places": ArrayKind(INT, ("3",), True)}, False)


def compiled(folder, single):
    """`mixed` as a function of NumPy's arrays, printed, compiled by gcc without a warning and loaded."""
    made = c_functions(with_called([mixed]), KINDS, single, {"mixed": "ant_mixed"}, {})
    structs = "\n".join(KINDS[name].definition() for name in ("box", "work"))
    (folder / "antagonist_config.h").write_text("#define ANT_SINGLE\n" if single else "\n")
    (folder / "mixed.c").write_text(f'#include "real.h"\n\n{structs}\n{made.head}\n\n{made.body}\n')
    flags = *tools.STRICT, "-O2", "-shared", "-fPIC", f"-I{SOURCES}", f"-I{SOURCES / 'allocate'}"
    subprocess.run(["gcc", *flags, "mixed.c", "-lm", "-o", "mixed.so"], cwd=folder, check=True)
    run = ctypes.CDLL(str(folder / "mixed.so")).ant_mixed
    run.restype = ctypes.c_float if single else ctypes.c_double

    def called(work, x, out):
        given = [array.ctypes.data_as(ctypes.c_void_p) for array in (*work.box, work.places)]
        return run(
            (ctypes.c_void_p * 3)(*given), x.ctypes.data_as(ctypes.c_void_p), out.ctypes.data_as(ctypes.c_void_p)
        )

    return called


@needs("gcc")
@pytest.mark.parametrize(("single", "rtol"), [(False, 1e-14), (True, 1e-5)], ids=["double", "single"])
def test_what_c_has_no_word_for_is_printed_and_computes_the_same(single, rtol, tmp_path):
    called, rng, kind = compiled(tmp_path, single), np.random.default_rng(0), np.float32 if single else np.float64
    for _ in range(100):
        box = Box(*np.sort(rng.uniform(-1, 3, (2, N)), axis=0).astype(kind))
        work = Work(box, rng.integers(0, N, 3, dtype=np.int32))
        x, mine, theirs = rng.uniform(-0.3, 3, N).astype(kind), np.zeros((N, 3), kind), np.zeros((N, 3), kind)
        np.testing.assert_allclose(called(work, x, theirs), mixed(work, x, mine), rtol=10 * rtol, atol=rtol)
        np.testing.assert_allclose(theirs, mine, rtol=10 * rtol, atol=rtol)


def in_a_loop(x):
    """Make arrays again and again."""
    for _ in range(3):
        own = x.copy()
        own[0] = 1.0


def swapped(x):
    """Take what has just been assigned."""
    a, b = x[0], x[1]
    a, b = b, a
    return a - b


def comprehended(x):
    """Return what C has no sums of."""
    return sum(v for v in x)


@pytest.mark.parametrize(
    ("function", "why"),
    [(in_a_loop, "memory in a loop"), (swapped, "just been assigned"), (comprehended, "no such function")],
)
def test_what_cannot_be_printed_is_refused_with_its_line(function, why):
    with pytest.raises(Unprintable, match=f"line .* cannot be printed .*{why}"):
        c_functions([function], KINDS, False, {}, {})
