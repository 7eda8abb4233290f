"""CasADi functions printed as plain C99 functions.

CasADi's own generator is not used. Its files carry unused parameters and bookkeeping for CasADi's runtime. In single
precision they call the double-precision functions of math.h, which a microcontroller's FPU cannot compute.
"""

from collections.abc import Iterator

from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from allocator.lazy import Function
from mpc.codegen.graphs import C, Output, Untranslatable, steps


def function(f: "Function", comment: str, single: bool) -> str:
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
    return "\n".join([f"/* {comment} */", prototype(f) + " {", *lines, "}"])


def prototype(f: "Function") -> str:
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
