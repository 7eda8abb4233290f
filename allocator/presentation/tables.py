"""Numbers, ranges and small tables for consoles and notebooks."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import SupportsFloat

import numpy as np
from numpy.typing import ArrayLike

_ROUNDING = 1e-12  # numbers below it are rounding errors of something that is zero


def number(value: SupportsFloat, digits: int = 4) -> str:
    """Return `value` with so many significant digits, and 0 for a rounding error."""
    shown = float(value)
    return f"{0.0 if abs(shown) < _ROUNDING else shown:.{digits}g}"


def span(values: ArrayLike, unit: str = "", digits: int = 4) -> str:
    """Return 'least … greatest unit' of the values that are numbers."""
    flat = np.ravel(values)
    finite = flat[np.isfinite(flat)]
    return f"{number(finite.min(), digits)} … {number(finite.max(), digits)} {unit}".rstrip() if finite.size else "none"


def first_of(warnings: Sequence[str]) -> str:
    """Return the first warning in a line of its own, and how many there are; nothing without warnings."""
    return f"\n  warning 1 of {len(warnings)}: {warnings[0]}" if warnings else ""


def html_table(title: str, rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Return a small HTML table with a title, and names of the columns if they are given."""

    def line(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line("td", row) for row in rows)
    return f"<table><caption>{escape(title)}</caption>{line('th', header) if header else ''}{body}</table>"
