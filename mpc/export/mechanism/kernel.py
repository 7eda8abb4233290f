"""The kernel of mechanisms as C is printed from the text that Python and numba run: `kernel.h` and `kernel.c`."""

import ast
import inspect
import textwrap
from collections.abc import Iterator

from allocator.allocation.kernels import source
from allocator.allocation.status import Status
from allocator.compilation.printer import (
    INT,
    MIN_AND_MAX,
    REAL,
    ArrayKind,
    Kind,
    Outside,
    Source,
    StructKind,
    c_form,
    c_functions,
)
from allocator.mechanism.kernel import data, levels, residual
from mpc.export import text

_SIZES = {"m": "ANT_VARIABLES", "p": "ANT_LINES", "K": "ANT_LEVELS"}
_SIDE = "signed char"
_ELEMENTS = {"np.int64": INT, "np.int8": _SIDE, "np.bool_": _SIDE}

MOST_ROUNDS, MOST_FIRST = 1000, 200  # in C: a bound for the longest call
SINGLE = {  # what rounding of single precision leaves
    "GAP": 3e2,
    "POSITIVE": 1e-6,
    "RANK": 1e-9,
    "MISSED": 1e-6,
    "CANCELS": 3e-5,
    "OUTSIDE": 1e-6,
    "EXCEEDED": 1e-4,
}
ENTRIES = {name: f"ant_kernel_{name}" for name in ("prepare", "scale", "solve", "residual")}


def kernel_files(single: bool) -> dict[str, str]:
    """Return the files of the kernel, which are the same for every mechanism; sizes stand in antagonist_config.h."""
    structs = _structs()
    functions = (*levels.FUNCTIONS, *residual.FUNCTIONS)
    numbers = {"MOST_ROUNDS": MOST_ROUNDS, "MOST_FIRST": MOST_FIRST} | (SINGLE if single else {})
    made = c_functions(functions, _kinds(structs), single, ENTRIES, numbers)
    about = "Lexicographic least squares in a box, printed from Python's text of it."
    bounds = c_form(Source.of(source), "interval", _OUTSIDE)
    head = "\n\n".join([*(struct.definition() for struct in structs.values()), made.head, bounds.head])
    body = "\n\n".join(
        [f'/* {about} */\n#include "antagonist.h"\n#include "real.h"', MIN_AND_MAX, made.body, bounds.body]
    )
    return {
        "src/kernel.h": text.header("ANT_KERNEL_H", about, head),
        "src/kernel.c": f"{body}\n",
    }


_OUTSIDE = Outside(
    names={"clip": "ant_clip"} | {s.name: f"ANT_{s.name}" for s in Status if hasattr(source, s.name)},
    functions={"interval": "ant_interval"},
    structs={("low", "high", "status"): "ant_bounds"},
    arrays=frozenset({"bounds"}),
)


def _structs() -> dict[str, StructKind]:
    """Return what C has for the named tuples."""
    m, p, K = _SIZES.values()
    rows = {
        "A": ArrayKind(REAL, (p, m), True),
        "b": ArrayKind(REAL, (p,), True),
        "onesided": ArrayKind(_SIDE, (p,), True),
        "ends": ArrayKind(INT, (K,), True),
    }
    bounds = {name: ArrayKind(REAL, (m,), True) for name in data.Box._fields}
    memory = dict(zip(data.Work._fields, _memory(), strict=True))
    return {
        "levels": StructKind("ant_levels", rows, False),
        "box": StructKind("ant_box", bounds, False),
        "work": StructKind("ant_work", memory, True),
    }


def _memory() -> Iterator[ArrayKind]:
    """Yield the arrays that `workspace` makes."""
    [made] = [node.value for node in ast.walk(_parsed(data.workspace)) if isinstance(node, ast.Return)]
    assert isinstance(made, ast.Call)
    for array in made.args:
        assert isinstance(array, ast.Call)
        shape, *kind = array.args
        sizes = shape.elts if isinstance(shape, ast.Tuple) else [shape]
        yield ArrayKind(_ELEMENTS[ast.unparse(kind[0])] if kind else REAL, tuple(map(_size, sizes)))


def _parsed(function: object) -> ast.Module:
    return ast.parse(textwrap.dedent(inspect.getsource(function)))  # type: ignore[arg-type]  # a function


def _size(node: ast.expr) -> str:
    return " ".join(_SIZES.get(part, part) for part in ast.unparse(node).split())


def _kinds(structs: dict[str, StructKind]) -> dict[str, Kind]:
    """Return what arguments are, by their names in all functions."""
    m, p, K = _SIZES.values()
    memory = structs["work"].fields
    return {
        **structs,
        **{name: memory[name] for name in ("B", "Q", "L", "right", "tries")},
        "x": ArrayKind(REAL, (m,)),
        "centre": ArrayKind(REAL, (m,), True),
        "side": ArrayKind(_SIDE, (f"{m} + {p}",)),
        "held": ArrayKind(_SIDE, (f"{m} + {p}",)),
        "mu": ArrayKind(REAL, (f"{K} + 1", p)),
        "ends": ArrayKind(INT, (K,), True),
        **dict.fromkeys(("longest", "pull", "near", "to_centre", "greatest"), REAL),
    }
