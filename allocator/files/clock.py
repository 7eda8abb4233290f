"""Clock times and dates in seconds: `12:03:04.567`, `2024-05-13T12:03:04,567Z`, `13.05.2024 12:03:04`."""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from allocator.calculus import Array

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
