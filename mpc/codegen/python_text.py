"""CasADi functions printed as Python source for a compiler, one assignment per operation.

A muscle's law is written once, in Python, and differentiated by CasADi. Compiled loops call the same graph without
CasADi's interpreter. The graph's numbers are an argument instead of a part of the source, so that joints that differ
only in their numbers share one compiled function.
"""

from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.lazy import Function
from mpc.codegen.graphs import PYTHON, Output, Untranslatable, steps

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
