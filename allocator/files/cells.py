"""Numbers in the cells of a table, and the message about a cell without a number."""

import re
from collections.abc import Sequence

import numpy as np

from allocator.calculus import Array

_MISSING_WORDS = (  # spellings of a missing value
    "nan -nan na n/a #n/a #nv #n/v n.a. null none nil missing - -- --- ? . 1.#qnan -1.#qnan 1.#ind -1.#ind "
    "-nan(ind) nan(ind) #wert! #value! #div/0!"
)
_MISSING = frozenset(_MISSING_WORDS.split())
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_WITH_UNIT = re.compile(r"[+-]?\d+([.,]\d+)?\s*[^\W\d_°%]*[°%]?(/\w+)?")


def floats(cells: Sequence[str], decimal_comma: bool) -> Array:
    """Return the numbers (n,) in the cells, NaN for cells without one."""
    if decimal_comma:
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        return np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        return np.array([_float(cell) for cell in cells])


def is_number(cell: str) -> bool:
    """Return whether the cell is a number with a decimal point or comma, or a spelling of a missing one."""
    return is_missing(cell) or not np.isnan(_float(cell.replace(",", ".", 1)))


def is_missing(cell: str) -> bool:
    """Return whether the cell is a spelling of a missing value, such as NaN, N/A or #NV."""
    return cell.strip().casefold() in _MISSING


def is_misspelled(cell: str) -> bool:
    """Return whether the cell has a digit and is neither a number nor a spelling of a missing one."""
    return bool(re.search(r"\d", cell)) and not is_number(cell)


def complaint(cell: str) -> str:
    """Return the message about a cell that is not a finite number."""
    text = cell.strip()
    if not text:
        return "a value is missing"
    short = text if len(text) <= 40 else f"{text[:40]}…"
    shown = repr(short)
    if "," in text and np.isfinite(_float(text.replace(",", "."))):
        return f"{shown} has a comma; with decimal commas, separate the columns by semicolons, and write no thousands"
    if text.lower() == "nan" or not np.isnan(_float(text)):
        return f"{short} is not a finite number"
    if is_missing(text):
        return f"a value is missing ({shown})"
    if re.fullmatch(r"[+-]?[\d.,'’\s]+", text):
        return f"{shown} is not a number; write thousands without a separator"
    hint = "; write the unit into the column's name" if _WITH_UNIT.fullmatch(text) else ""
    return f"{shown} is not a number{hint}"


def thousands(cells: Sequence[str]) -> int | None:
    """Return the index of a comma that separates thousands, not decimals; None if nothing indicates one.

    The indication: every comma precedes three digits, and a number without a comma has three digits.
    """
    commas = [i for i, cell in enumerate(cells) if "," in cell]
    if not commas or not all(_THOUSANDS.fullmatch(cells[i].strip()) for i in commas):
        return None
    whole = any(re.fullmatch(r"[+-]?[1-9]\d\d", cell.strip()) for cell in cells)
    return commas[0] if whole else None


def listed(lines: Sequence[int], most: int = 8) -> str:
    """Return the numbers of lines in words: `line 5`, `lines 5, 7 and 9`, `lines 5, 7, … and 12 more`."""
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > most:
        return f"lines {', '.join(map(str, lines[: most - 1]))} and {len(lines) - most + 1} more"
    return f"lines {', '.join(map(str, lines[:-1]))} and {lines[-1]}"


def _float(cell: str) -> float:
    try:
        return float(cell.replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        return float("nan")
