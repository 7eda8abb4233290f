"""CasADi functions printed as source: C99 for an export, and Python for a compiler, one assignment per operation.

A muscle's law is written once, in Python, and differentiated by CasADi. Compiled loops call the same graph without
CasADi's interpreter. The graph's numbers are an argument instead of a part of the source, so that joints that differ
only in their numbers share one compiled function.

CasADi's own generator of C is not used. Its files carry unused parameters and bookkeeping for CasADi's runtime. In
single precision they call the double-precision functions of math.h, which a microcontroller's FPU cannot compute.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from allocator.lazy import Function
from mpc.codegen.graphs import PYTHON, C, Output, Untranslatable, steps


def c_function(f: "Function", comment: str, single: bool) -> str:
    """Write the CasADi function `f` (SX, dense) as the C function `ant_model_<name>`; `comment` describes it.

    Inputs and outputs are arrays with the names in `f`, matrices by rows as the caller made them. Raises InvalidInput
    for an operation that has no C counterpart.
    """
    try:
        statements = list(_statements(f, single))
    except Untranslatable as error:
        raise InvalidInput(f"the model cannot be exported: {error}") from None
    written = "\n".join(statements)
    unused = [f"(void){name};" for name in map(f.name_in, range(f.n_in())) if f"{name}[" not in written]
    lines = [f"    {line}" for line in [*unused, *statements]]
    return "\n".join([f"/* {comment} */", c_prototype(f) + " {", *lines, "}"])


def c_prototype(f: "Function") -> str:
    """Return the prototype of the C function of `f`."""
    inputs = [f"const ant_real *{f.name_in(i)}" for i in range(f.n_in())]
    outputs = [f"ant_real *{f.name_out(i)}" for i in range(f.n_out())]
    return f"void ant_model_{f.name()}({', '.join([*inputs, *outputs])})"


def _statements(f: "Function", single: bool) -> Iterator[str]:
    for step in steps(f, C, lambda i, j: f"{f.name_in(i)}[{j}]", lambda value: number(value, single)):
        if isinstance(step, Output):
            yield f"{f.name_out(step.output)}[{step.entry}] = {step.expression};"
        else:
            yield f"const ant_real {step.name} = {step.expression};"


IMPORTS = """import math

import numpy as np

from mpc.codegen.jit import pick


"""  # that these functions need
_LONGEST = 3300  # operations that numba compiles in acceptable time: a controller takes up to 60 s of a CPU


@dataclass(frozen=True)
class Source:
    """The source of a Python function and the numbers that it takes."""

    text: str  # of a function of scalars and of `c`, which returns the tuple of its outputs, columns first
    c: Array  # the numbers, in the order of the graph


def translated(name: str, function: "Function", first: int = 0) -> Source:
    """Write the CasADi SX `function` as the Python function `name(i0_0, i0_1, …, c)`: inputs element by element.

    Its numbers are c[first], c[first + 1], …, the inverses of those that divide. Raises `Untranslatable` for an
    operation that is not in the table, and for a function with too many operations to compile.
    """
    numbers = _Numbers(name, function, first)
    results: dict[tuple[int, int], str] = {}
    body: list[str] = []
    for step in steps(function, PYTHON, "i{}_{}".format, numbers, inverses=True):
        if isinstance(step, Output):
            results[step.output, step.entry] = step.expression
        else:
            body.append(f"    {step.name} = {step.expression}")
    inputs = [f"i{i}_{j}" for i in range(function.n_in()) for j in range(function.nnz_in(i))]
    head = f"def {name}({', '.join([*inputs, 'c'])}):"
    returned = f"    return ({', '.join(results[place] for place in sorted(results))},)"
    return Source("\n".join([head, *body, returned, ""]), numbers.array)


def filling(name: str, function: "Function", first: int = 0) -> Source:
    """Write the CasADi SX `function` as the Python function `name(i0, i1, …, c, o0, o1, …)`, which fills arrays.

    Inputs and outputs are flat arrays of the nonzeros, columns first; no output may alias an input. Numbers and errors
    are those of `translated`, but none is inverted: the results equal CasADi's bit by bit.
    """
    numbers = _Numbers(name, function, first)
    body = []
    for step in steps(function, PYTHON, "i{}[{}]".format, numbers):
        target = f"o{step.output}[{step.entry}]" if isinstance(step, Output) else step.name
        body.append(f"    {target} = {step.expression}")
    given = [f"i{i}" for i in range(function.n_in())] + ["c"] + [f"o{i}" for i in range(function.n_out())]
    return Source("\n".join([f"def {name}({', '.join(given)}):", *body, ""]), numbers.array)


class _Numbers:
    """The numbers of a function, named c[first], c[first + 1], … in order of use."""

    def __init__(self, name: str, function: "Function", first: int) -> None:
        if function.n_instructions() > _LONGEST:
            raise Untranslatable(
                f"the law's function {name} has {function.n_instructions()} operations, more than the {_LONGEST} that "
                "are compiled in bearable time"
            )
        self._first, self._values = first, list[float]()

    def __call__(self, value: float) -> str:
        """Name a number at each use. Equal numbers are not shared: the source must not depend on values."""
        if value in (-1.0, 0.0, 1.0):
            return repr(value)
        self._values.append(value)
        return f"c[{self._first + len(self._values) - 1}]"

    @property
    def array(self) -> Array:
        """The numbers in the order of their names."""
        return np.array(self._values, float)
