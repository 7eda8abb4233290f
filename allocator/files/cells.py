"""Numbers in the cells of a table, and the message about a cell without a number.

Clock times and dates in seconds: `12:03:04.567`, `2024-05-13T12:03:04,567Z`, `13.05.2024 12:03:04`.
"""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from allocator.calculus import Array

_MISSING_WORDS = (  # spellings of a missing value
    "nan -nan na n/a #n/a #nv #n/v n.a. null none nil missing - -- --- ? . 1.#qnan -1.#qnan 1.#ind -1.#ind "
    "-nan(ind) nan(ind) #wert! #value! #div/0!"
)
_MISSING = frozenset(_MISSING_WORDS.split())
_MOST = 8  # lines that are listed
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


def listed(lines: Sequence[int]) -> str:
    """Return the numbers of lines in words: `line 5`, `lines 5, 7 and 9`, `lines 5, 7, … and 12 more`."""
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > _MOST:
        return f"lines {', '.join(map(str, lines[: _MOST - 1]))} and {len(lines) - _MOST + 1} more"
    return f"lines {', '.join(map(str, lines[:-1]))} and {lines[-1]}"


def _float(cell: str) -> float:
    try:
        return float(cell.replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        return float("nan")


_DAY = 86_400.0  # [s]
_PATTERN = re.compile(
    r"(?:(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{4})[T\s_]+)?"
    r"(?:(?P<h>\d{1,2}):)?(?P<m>\d{1,2}):(?P<s>\d{2}(?:[.,:]\d+)?)"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|z|[+-]\d{2}:?\d{2})?"
)
_BACK = 12 * 3600.0  # [s] least backward step of a clock without dates at midnight
_EPOCH = date(1970, 1, 1)


def is_clock(cell: str) -> bool:
    """Return whether the cell is a clock time to the second, with or without a date."""
    return _PATTERN.fullmatch(cell.strip()) is not None


def clock_seconds(cells: Sequence[str]) -> Array:
    """Return the times (n,) in seconds since midnight, or since 1970 if dates are given; NaN for other cells.

    Without dates a clock that goes back by more than 12 hours has passed midnight. Of `05/06/2024` the first number is
    the month, unless any cell begins with a number above 12; with points it is the day.
    """
    matches = [_PATTERN.fullmatch(cell.strip()) for cell in cells]
    day_first = any(_begins_with_day(match["date"]) for match in matches if match and match["date"])
    days: dict[str, float] = {}
    seconds = np.full(len(matches), np.nan)
    for i, match in enumerate(matches):
        if match is None:
            continue
        text = match["date"]
        if text and text not in days:
            days[text] = _days(text, day_first)
        seconds[i] = _of_day(match) + (days[text] * _DAY if text else 0.0)
    if not days:
        known = np.isfinite(seconds)
        wraps = np.diff(seconds[known], prepend=seconds[known][:1]) < -_BACK
        seconds[known] += _DAY * np.cumsum(wraps)
    return seconds


def _of_day(match: re.Match[str]) -> float:
    hour, minute = int(match["h"] or 0), int(match["m"])
    second = float(re.sub("[,:]", ".", match["s"]))
    if half := match["half"]:
        hour = hour % 12 + (12 if half.lower() == "pm" else 0)
    if hour > 24 or minute > 59 or second >= 61:
        return float("nan")
    zone = match["zone"] or ""
    shift = 0.0
    if len(zone) > 1:
        digits = zone[1:].replace(":", "")
        shift = (1 if zone[0] == "+" else -1) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))
    return 3600.0 * hour + 60.0 * minute + second - shift


def _begins_with_day(text: str) -> bool:
    first, mark = re.match(r"(\d+)([-/.])", text).groups()  # type: ignore[union-attr]  # the pattern's own text
    return len(first) <= 2 and (mark == "." or int(first) > 12)


def _days(text: str, day_first: bool) -> float:
    """Return the days since 1970, NaN for no date."""
    numbers = [int(part) for part in re.split("[-/.]", text)]
    if numbers[0] > 31:
        year, month, day = numbers
    elif day_first:
        day, month, year = numbers
    else:
        month, day, year = numbers
    try:
        return float((date(year, month, day) - _EPOCH).days)
    except ValueError:
        return float("nan")
