"""CasADi functions as assignments, one per operation and in CasADi's order, for every target language.

CasADi builds the graph, differentiates it and eliminates common terms. A `Language` maps its operations to source
text. Inputs, outputs and numbers look different in each text, so the caller writes those.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from allocator.errors import InvalidInput
from allocator.lazy import Function


class Untranslatable(InvalidInput):
    """A CasADi function that cannot be written in a language, with the reason as its message."""


@dataclass(frozen=True)
class Language:
    """A target language: the source text of each CasADi operation."""

    name: str
    operations: Mapping[str, str]  # CasADi's name: an expression of the operands {0} and {1}, which are atoms
    temporary: str  # the name of the n-th result {}


class Temporary(NamedTuple):
    """A named result of an operation."""

    name: str
    expression: str


class Output(NamedTuple):
    """An assignment to one entry of an output."""

    output: int
    entry: int  # among the nonzeros, columns first
    expression: str


def steps(
    function: "Function",
    language: Language,
    entry: Callable[[int, int], str],
    number: Callable[[float], str],
    *,
    inverses: bool = False,
) -> Iterator[Temporary | Output]:
    """Yield the CasADi SX `function` in `language`, step by step.

    `entry(i, j)` writes the nonzero j of input i. `number` writes a constant and is called at every place where one is
    used. With `inverses`, divisions become multiplications by an inverse that is computed once per divisor, which takes
    a third of the time and may change the last bit. Raises `Untranslatable` for an operation that the language's table
    lacks.
    """
    import casadi as ca

    registers: dict[int, str | float] = {}  # CasADi's work vector: expressions or numbers
    inverse: dict[str | float, str | float] = {}  # of divisors
    used = 0

    def operand(value: str | float) -> str:
        text = value if isinstance(value, str) else number(value)
        return f"({text})" if text.startswith("-") else text

    for k in range(function.n_instructions()):
        kind = function.instruction_id(k)
        taken, given = function.instruction_input(k), function.instruction_output(k)
        if kind == ca.OP_OUTPUT:
            yield Output(given[0], given[1], operand(registers[taken[0]]))
        elif kind == ca.OP_INPUT:
            registers[given[0]] = entry(*taken)
        elif kind == ca.OP_CONST:
            registers[given[0]] = float(function.instruction_constant(k))
        else:
            operands = [registers[register] for register in taken]
            if inverses and kind == ca.OP_DIV and _invertible(by := operands[1]):
                if by not in inverse:
                    inverse[by] = 1 / by if isinstance(by, float) else language.temporary.format(used)
                    if isinstance(by, str):
                        used += 1
                        yield Temporary(str(inverse[by]), _form(ca.OP_INV, function, language).format(operand(by)))
                kind, operands[1] = ca.OP_MUL, inverse[by]
            expression = _form(kind, function, language).format(*map(operand, operands))
            registers[given[0]] = name = language.temporary.format(used)
            used += 1
            yield Temporary(name, expression)


def _invertible(by: str | float) -> bool:
    """Return whether the inverse of a divisor is as exact as the divisor: of a result, and of most constants."""
    return isinstance(by, str) or 1e-150 < abs(by) < 1e150


def _form(kind: int, function: "Function", language: Language) -> str:
    """Return how `language` writes the operation that CasADi numbers `kind`."""
    name = operation_names().get(kind, f"operation number {kind}")
    form = language.operations.get(name)
    if form is None:
        raise Untranslatable(
            f"the function {function.name()} uses CasADi's {name}, which the table of operations for {language.name} "
            "has not"
        )
    return form


@cache
def operation_names() -> dict[int, str]:
    """Return CasADi's operations by their numbers."""
    import casadi as ca

    return {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


_BOTH = {
    "OP_ASSIGN": "{0}",
    "OP_ADD": "{0} + {1}",
    "OP_SUB": "{0} - {1}",
    "OP_MUL": "{0} * {1}",
    "OP_DIV": "{0} / {1}",
    "OP_NEG": "-{0}",
    "OP_SQ": "{0} * {0}",
}
_MATH = (
    "exp", "expm1", "log", "log1p", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "erf",
)  # fmt: skip
_MATH_OF_TWO = ("atan2", "hypot", "copysign")
_C_ONLY = ("fabs", "floor", "ceil")
_C_ONLY_OF_TWO = ("pow", "fmod", "remainder", "fmin", "fmax")

_R = "np.fmod({0}, {1})"  # remainder of {0} after division by {1}, rounded towards 0
_REMAINDER = (  # remainder after division, rounded to nearest, ties to even
    f"pick(abs({_R}) < abs({{1}}) - abs({_R}), {_R}, pick(abs({_R}) > abs({{1}}) - abs({_R}), "
    f"{_R} - math.copysign({{1}}, {{0}}), {_R} - 2.0 * np.fmod(0.5 * ({{0}} - {_R}), {{1}})))"
)

PYTHON = Language(
    "Python",
    {
        **_BOTH,
        "OP_TWICE": "2.0 * {0}",
        "OP_INV": "1.0 / {0}",
        "OP_POW": "{0} ** {1}",
        "OP_CONSTPOW": "{0} ** {1}",
        **{f"OP_{name.upper()}": f"math.{name}({{0}})" for name in _MATH},
        **{f"OP_{name.upper()}": f"math.{name}({{0}}, {{1}})" for name in _MATH_OF_TWO},
        "OP_FMOD": "np.fmod({0}, {1})",
        "OP_REMAINDER": _REMAINDER,  # which numba does not have
        "OP_FABS": "abs({0})",
        "OP_FLOOR": "np.floor({0})",  # `math.floor` returns an integer and fails for infinity
        "OP_CEIL": "np.ceil({0})",
        "OP_SIGN": "pick({0} > 0.0, 1.0, pick({0} < 0.0, -1.0, {0}))",
        "OP_LT": "pick({0} < {1}, 1.0, 0.0)",
        "OP_LE": "pick({0} <= {1}, 1.0, 0.0)",
        "OP_EQ": "pick({0} == {1}, 1.0, 0.0)",
        "OP_NE": "pick({0} != {1}, 1.0, 0.0)",
        "OP_NOT": "pick({0} == 0.0, 1.0, 0.0)",
        "OP_AND": "pick(({0} != 0.0) & ({1} != 0.0), 1.0, 0.0)",
        "OP_OR": "pick(({0} != 0.0) | ({1} != 0.0), 1.0, 0.0)",
        "OP_FMIN": "pick(({0} < {1}) | ({1} != {1}), {0}, {1})",  # a number wins over NaN, as in C
        "OP_FMAX": "pick(({0} > {1}) | ({1} != {1}), {0}, {1})",
        "OP_IF_ELSE_ZERO": "pick({0} != 0.0, {1}, 0.0)",
    },
    temporary="v{}",
)

C = Language(
    "C",
    {
        **_BOTH,
        "OP_TWICE": "{0} + {0}",
        "OP_INV": "1 / {0}",
        "OP_CONSTPOW": "ANT_F(pow)({0}, {1})",
        **{f"OP_{name.upper()}": f"ANT_F({name})({{0}})" for name in (*_MATH, *_C_ONLY)},
        **{f"OP_{name.upper()}": f"ANT_F({name})({{0}}, {{1}})" for name in (*_MATH_OF_TWO, *_C_ONLY_OF_TWO)},
        "OP_SIGN": "{0} > 0 ? 1 : {0} < 0 ? -1 : {0}",
        "OP_LT": "{0} < {1}",
        "OP_LE": "{0} <= {1}",
        "OP_EQ": "ant_equal({0}, {1}) ? 1 : 0",
        "OP_NE": "ant_equal({0}, {1}) ? 0 : 1",
        "OP_NOT": "ant_equal({0}, 0) ? 1 : 0",
        "OP_AND": "!ant_equal({0}, 0) && !ant_equal({1}, 0)",
        "OP_OR": "!ant_equal({0}, 0) || !ant_equal({1}, 0)",
        "OP_IF_ELSE_ZERO": "!ant_equal({0}, 0) ? {1} : 0",
    },
    temporary="t{}",
)
