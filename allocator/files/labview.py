"""Headers of LabVIEW measurement files (`.lvm`, or text that ends its header by `***End_of_Header***`)."""

import re
from typing import NamedTuple

from allocator.files.cells import floats

Line = tuple[int, str]  # its number, counted from 1, and its text

_END = "***end_of_header***"
_BEGIN = "channels"  # of the header of a segment


class LabView(NamedTuple):
    """Lines without the headers, and the entries of the headers that belong to columns."""

    lines: list[Line]
    units: list[str]  # of the columns except X_Value; empty if none are given
    step: float | None  # [s] between rows, None if not given


def without_headers(lines: list[Line]) -> LabView | None:
    """Return the lines without the headers; None if no header ends in these lines."""
    ends = [k for k, (_, line) in enumerate(lines) if line.strip().casefold().startswith(_END)]
    if not ends:
        return None
    kept: list[Line] = []
    entries: dict[str, list[str]] = {}
    begin = 0
    for end in ends:
        segments = [k for k in range(begin, end) if begin and _cells(lines[k][1])[0].casefold() == _BEGIN]
        header = segments[0] if segments else begin
        kept += lines[begin:header]
        for _, line in lines[header:end]:
            name, *values = _cells(line)
            entries[name.casefold()] = values
        begin = end + 1
    kept += lines[begin:]
    steps = floats(entries.get("delta_x", [])[:1], decimal_comma=True)
    kept = _with_comments(kept)
    return LabView(kept, entries.get("y_unit_label", []), float(steps[0]) if steps.size and steps[0] > 0 else None)


def _with_comments(lines: list[Line]) -> list[Line]:
    """Return the lines with an empty cell where LabVIEW has left out the last column, that of comments."""
    names = next((line for _, line in lines if line.casefold().startswith("x_value")), "")
    if _cells(names)[-1].casefold() != "comment":
        return lines
    mark = next(mark for mark in "\t;," if mark in names)
    count = names.count(mark)
    return [(k, line + mark * (count - line.count(mark) if line.strip() else 0)) for k, line in lines]


def filled_names(names: list[str], units: list[str]) -> list[str]:
    """Return the names of the columns with their units; X_Value is a time, and Comment has none."""
    left = iter(units)
    return [name if _is_other(name) else _named(name, next(left, "")) for name in names]


def fill_times(names: list[str], rows: list[list[str]], step: float | None) -> None:
    """Write the times into a column X_Value that LabVIEW left empty."""
    if step is not None and names and names[0].casefold() == "x_value" and not any(row[0].strip() for row in rows):
        for k, row in enumerate(rows):
            row[0] = f"{k * step:.9g}"


def _named(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit.strip() else name


def _is_other(name: str) -> bool:
    return name.casefold().startswith("x_value") or name.casefold() in ("comment", "")


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split("\t|;" if "\t" in line or ";" in line else ",", line)]
