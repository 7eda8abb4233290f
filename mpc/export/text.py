"""C text for numbers and tables."""

from collections.abc import Iterable, Mapping

from allocator.calculus import Array
from mpc.export.ccode import number


def header(guard: str, about: str, body: str, includes: Iterable[str] = ()) -> str:
    """A header file."""
    lines = [f"/* {about} */", f"#ifndef {guard}", f"#define {guard}", ""]
    lines += [*(f'#include "{name}"' for name in includes), "", body, "", f"#endif /* {guard} */"]
    return "\n".join(lines) + "\n"


def defines(numbers: Mapping[str, tuple[float | int, str]], single: bool) -> str:
    """A line `#define ANT_NAME value` for each of `numbers`, with what it is behind it."""
    rows = []
    for name, (value, meaning) in numbers.items():
        literal = str(value) if isinstance(value, int) else f"({number(value, single)})"
        rows.append(f"#define ANT_{name} {literal}" + (f" /* {meaning} */" if meaning else ""))
    return "\n".join(rows)


def table(name: str, meaning: str, values: Array, single: bool) -> str:
    """A constant array of one or two dimensions."""
    shape = "".join(f"[{n}]" for n in values.shape)
    rows = [values] if values.ndim == 1 else list(values)
    texts = [", ".join(number(float(v), single) for v in row) for row in rows]
    inner = texts[0] if values.ndim == 1 else ",\n    ".join(f"{{{text}}}" for text in texts)
    return f"/* {meaning} */\nstatic const ant_real {name}{shape} = {{\n    {inner}}};"


__all__ = ["defines", "header", "table"]
