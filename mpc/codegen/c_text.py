"""CasADi's expression graphs as plain C99 functions.

CasADi's own generator is not used for the text: its files carry unused parameters and bookkeeping for CasADi's runtime,
and in single precision call the functions of math.h for double, which a microcontroller's FPU cannot do. The graph, its
derivatives and the elimination of common terms are CasADi's; here every node becomes a line of C.
"""

from collections.abc import Iterator
from typing import Any

from allocator.errors import InvalidInput

_BINARY = {"OP_ADD": "{} + {}", "OP_SUB": "{} - {}", "OP_MUL": "{} * {}", "OP_DIV": "{} / {}"}
_COMPARISONS = {"OP_LT": "{} < {}", "OP_LE": "{} <= {}", "OP_EQ": "{} == {}", "OP_NE": "{} != {}"}
_COMPARISONS |= {"OP_AND": "{} != 0 && {} != 0", "OP_OR": "{} != 0 || {} != 0", "OP_NOT": "{} == 0"}
_UNARY = {"OP_NEG": "-{}", "OP_SQ": "{0} * {0}", "OP_TWICE": "{0} + {0}", "OP_INV": "1 / {}", "OP_ASSIGN": "{}"}
_FUNCTIONS = ("exp", "log", "sqrt", "sin", "cos", "tan", "tanh", "fabs")
_CALLS = {f"OP_{name.upper()}": f"ANT_F({name})({{}})" for name in _FUNCTIONS}
_CALLS |= {"OP_POW": "ANT_F(pow)({}, {})", "OP_CONSTPOW": "ANT_F(pow)({}, {})"}
_OTHER = {"OP_IF_ELSE_ZERO": "{} != 0 ? {} : 0"}
_FORMS = {**_BINARY, **_COMPARISONS, **_UNARY, **_CALLS, **_OTHER}


def number(value: float, single: bool) -> str:
    """The literal of `value`: all its digits, `f` behind those of single precision."""
    import numpy as np

    return f"{np.float32(value)!s}f" if single else repr(float(value))


def function(f: Any, comment: str, single: bool) -> str:
    """The C function `ant_model_<name>` of the CasADi function `f` (SX, dense); `comment` says what it computes.

    Inputs and outputs are arrays by the names in `f`, matrices row by row as the caller made them. An output may be
    NULL where it is not wanted.
    """
    statements = list(_statements(f, single))
    written = "\n".join(statements)
    unused = [f"(void){name};" for name in map(f.name_in, range(f.n_in())) if f"{name}[" not in written]
    lines = [f"    {line}" for line in [*unused, *statements]]
    return "\n".join([f"/* {comment} */", prototype(f) + " {", *lines, "}"])


def prototype(f: Any) -> str:
    """The head of that function."""
    inputs = [f"const ant_real *{f.name_in(i)}" for i in range(f.n_in())]
    outputs = [f"ant_real *{f.name_out(i)}" for i in range(f.n_out())]
    return f"void ant_model_{f.name()}({', '.join([*inputs, *outputs])})"


def _statements(f: Any, single: bool) -> Iterator[str]:
    import casadi as ca

    names = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
    registers: dict[int, str] = {}  # what each of CasADi's registers holds now
    used = 0
    for k in range(f.n_instructions()):
        op, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_CONST:
            registers[outputs[0]] = number(f.instruction_constant(k), single)
        elif op == ca.OP_INPUT:
            registers[outputs[0]] = f"{f.name_in(inputs[0])}[{inputs[1]}]"
        elif op == ca.OP_OUTPUT:
            yield f"{f.name_out(outputs[0])}[{outputs[1]}] = {registers[inputs[0]]};"
        else:
            form = _FORMS.get(names[op])
            if form is None:
                raise InvalidInput(f"the model cannot be exported: its formula uses CasADi's {names[op]}")
            arguments = [registers[i] for i in inputs]
            yield f"const ant_real t{used} = {form.format(*(_operand(a) for a in arguments))};"
            registers[outputs[0]] = f"t{used}"
            used += 1


def _operand(expression: str) -> str:
    return f"({expression})" if expression.startswith("-") else expression


__all__ = ["function", "number", "prototype"]
