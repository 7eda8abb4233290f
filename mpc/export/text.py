"""Numbers and tables as C."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from allocator.compilation.printer import number

Table = NDArray[np.float64] | NDArray[np.int64]  # of floats or of integers, in one or two dimensions


def header(guard: str, about: str, body: str, includes: Iterable[str] = ()) -> str:
    """Return a header file with the comment `about`."""
    included = "".join(f'#include "{name}"\n' for name in includes)
    pieces = [f"/* {about} */\n#ifndef {guard}\n#define {guard}\n", included, f"{body}\n", f"#endif /* {guard} */\n"]
    return "\n".join(piece for piece in pieces if piece)


def defines(numbers: Mapping[str, tuple[float | int | str, str]], single: bool) -> str:
    """Return a line `#define ANT_NAME value` for each of `numbers`, with its comment."""
    rows = []
    for name, (value, meaning) in numbers.items():
        literal = f"({number(value, single)})" if isinstance(value, float) else str(value)
        rows.append(f"#define ANT_{name} {literal}" + (f" /* {meaning} */" if meaning else ""))
    return "\n".join(rows)


def table_head(name: str, meaning: str, values: Table) -> str:
    """Return the declaration of a constant array, and its meaning."""
    return f"extern {_declarator(name, values)}; /* {meaning} */"


def table(name: str, values: Table, single: bool) -> str:
    """Return the definition of a constant array."""
    if values.ndim == 1:
        return f"{_declarator(name, values)} = {{{_row(values, single)}}};"
    rows = ",\n".join(f"    {{{_row(row, single)}}}" for row in values)
    return f"{_declarator(name, values)} = {{\n{rows},\n}};"


def _declarator(name: str, values: Table) -> str:
    kind = "int" if values.dtype.kind == "i" else "ant_real"
    return f"const {kind} {name}{''.join(f'[{n}]' for n in values.shape)}"


def _row(values: Table, single: bool) -> str:
    if values.dtype.kind == "i":
        return ", ".join(map(str, values.tolist()))
    return ", ".join(number(v, single) for v in np.asarray(values, float).tolist())


def config(numbers: Mapping[str, tuple[float | int | str, str]], single: bool) -> str:
    """Return antagonist_config.h with these numbers, see `defines`."""
    lines = ["#define ANT_SINGLE /* numbers are float */"] * single + [defines(numbers, single)] * bool(numbers)
    return header("ANTAGONIST_CONFIG_H", "Choices at export.", "\n".join(lines))


def demonstration(names: str, rows: Table, single: bool, skipped: bool = False) -> str:
    """Return src/demonstration.h with `rows` of `names`, which main.c prints unless they are `skipped`."""
    count = f"enum {{ ANT_DEMONSTRATIONS = {0 if skipped else len(rows)} }};"
    body = f"{count}\n\n/* {names} */\nstatic {table('ANT_DEMONSTRATION', rows, single)}"
    return header("ANT_DEMONSTRATION_H", "Options of main.c.", body, ["antagonist.h"])
