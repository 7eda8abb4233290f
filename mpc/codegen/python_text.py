"""CasADi expressions as Python source: one assignment an operation, for a compiler to take over.

The muscle's law is then written once, in Python, and differentiated by CasADi; what a compiled loop calls is the same
graph without CasADi's interpreter. The numbers of the graph are not part of the source but come as an argument, so that
joints that differ in their numbers only share one compiled function.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from allocator.calculus import Array

_LONGEST = 1500  # operations that numba compiles in bearable time


class Untranslatable(ValueError):
    """An operation of the graph has no counterpart among the translated ones, or there are too many."""


@dataclass(frozen=True)
class Source:
    """A Python function and the numbers that go with it."""

    text: str  # of a function of scalars and of `c`, which returns the tuple of its outputs, columns first
    c: Array  # the numbers [as they come in the graph]


def translated(name: str, function: Any, first: int = 0) -> Source:
    """The CasADi SX `function` as the Python function `name(i0_0, i0_1, …, c)`: inputs element by element.

    Its numbers are c[first], c[first + 1], …
    """
    if function.n_instructions() > _LONGEST:
        raise Untranslatable(
            f"the law's function {name} has {function.n_instructions()} operations, more than the {_LONGEST} that are "
            "compiled in bearable time"
        )
    kinds = _operations()
    values: dict[int, str | float] = {}  # what CasADi's work vector holds: an expression, or a number
    results: dict[tuple[int, ...], str] = {}
    body: list[str] = []
    numbers: list[float] = []

    def operand(i: int) -> str:
        """Where it is used, a number is named: sharing one among those that happen to be equal would be structure."""
        value = values[i]
        if isinstance(value, str):
            return value
        if value in (-1.0, 0.0, 1.0):
            return f"({value!r})"
        numbers.append(value)
        return f"c[{first + len(numbers) - 1}]"

    for k in range(function.n_instructions()):
        kind = function.instruction_id(k)
        taken, given = function.instruction_input(k), function.instruction_output(k)
        if kind == kinds["OP_OUTPUT"]:
            results[tuple(given)] = operand(taken[0])
        elif kind == kinds["OP_INPUT"]:
            values[given[0]] = f"i{taken[0]}_{taken[1]}"
        elif kind == kinds["OP_CONST"]:
            values[given[0]] = float(function.instruction_constant(k))
        else:
            formula = _formula(kind).format(*map(operand, taken))
            values[given[0]] = f"v{len(body)}"
            body.append(f"v{len(body)} = {formula}")
    inputs = [f"i{i}_{j}" for i in range(function.n_in()) for j in range(function.nnz_in(i))]
    lines = [f"def {name}({', '.join([*inputs, 'c'])}):", *(f"    {line}" for line in body)]
    lines.append(f"    return ({', '.join(results[place] for place in sorted(results))},)")
    return Source("\n".join(lines) + "\n", np.array(numbers, float))


_MATH = (
    "exp", "expm1", "log", "log1p", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "erf",
)  # fmt: skip
_FORMULAS = {  # all are numbers: numba's bool is none
    "OP_ASSIGN": "{0}",
    "OP_ADD": "{0} + {1}",
    "OP_SUB": "{0} - {1}",
    "OP_MUL": "{0} * {1}",
    "OP_DIV": "{0} / {1}",
    "OP_NEG": "-{0}",
    "OP_TWICE": "2.0 * {0}",
    "OP_SQ": "{0} * {0}",
    "OP_INV": "1.0 / {0}",
    "OP_POW": "{0} ** {1}",
    "OP_CONSTPOW": "{0} ** {1}",
    **{f"OP_{name.upper()}": f"math.{name}({{0}})" for name in _MATH},
    "OP_ATAN2": "math.atan2({0}, {1})",
    "OP_HYPOT": "math.hypot({0}, {1})",
    "OP_FMOD": "np.fmod({0}, {1})",
    "OP_COPYSIGN": "math.copysign({0}, {1})",
    "OP_FABS": "abs({0})",
    "OP_FLOOR": "np.floor({0})",  # that of `math` is an integer, which infinity is not
    "OP_CEIL": "np.ceil({0})",
    "OP_SIGN": "1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else {0}",
    "OP_LT": "1.0 if {0} < {1} else 0.0",
    "OP_LE": "1.0 if {0} <= {1} else 0.0",
    "OP_EQ": "1.0 if {0} == {1} else 0.0",
    "OP_NE": "1.0 if {0} != {1} else 0.0",
    "OP_NOT": "1.0 if {0} == 0.0 else 0.0",
    "OP_AND": "1.0 if {0} != 0.0 and {1} != 0.0 else 0.0",
    "OP_OR": "1.0 if {0} != 0.0 or {1} != 0.0 else 0.0",
    "OP_FMIN": "{0} if {0} < {1} or {1} != {1} else {1}",  # of a number and NaN the number, as in C
    "OP_FMAX": "{0} if {0} > {1} or {1} != {1} else {1}",
    "OP_IF_ELSE_ZERO": "{1} if {0} != 0.0 else 0.0",
}
"""What CasADi's operations are in Python; ERFINV, REMAINDER and PRINTME, which no law needs, numba has not."""


@cache
def _operations() -> dict[str, int]:
    """CasADi's numbers for its operations."""
    import casadi as ca

    return {name: getattr(ca, name) for name in (*_FORMULAS, "OP_INPUT", "OP_OUTPUT", "OP_CONST")}


@cache
def _formula(kind: int) -> str:
    for name, formula in _FORMULAS.items():
        if _operations()[name] == kind:
            return formula
    raise Untranslatable(f"the law uses CasADi's operation {_named(kind)}, which has no translation")


def _named(kind: int) -> str:
    import casadi as ca

    return next((name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == kind), f"number {kind}")


__all__ = ["Source", "Untranslatable", "translated"]
