"""Positions of the column names and samples of a table, and the character that separates the columns.

The samples begin at the first row that is mostly numbers, as are those below it. The row above holds the names; if that
is a row of units, the names are above it. A row of names may also be the last comment (`# t p1 p2`, as `numpy.savetxt`
writes it).

Headers of LabVIEW measurement files (`.lvm`, or text that ends its header by `***End_of_Header***`).
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

from allocator.errors import InvalidFile
from allocator.files.cells import floats, is_clock, is_number
from allocator.files.text import FilePath

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
        segments = [k for k in range(begin, end) if begin and _entries(lines[k][1])[0].casefold() == _BEGIN]
        header = segments[0] if segments else begin
        kept += lines[begin:header]
        for _, line in lines[header:end]:
            name, *values = _entries(line)
            entries[name.casefold()] = values
        begin = end + 1
    kept = _with_comments(kept + lines[begin:])
    steps = floats(entries.get("delta_x", [])[:1], decimal_comma=True)
    return LabView(kept, entries.get("y_unit_label", []), float(steps[0]) if steps.size and steps[0] > 0 else None)


def _with_comments(lines: list[Line]) -> list[Line]:
    """Return the lines with an empty cell where LabVIEW has left out the last column, that of comments."""
    names = next((line for _, line in lines if line.casefold().startswith("x_value")), "")
    if _entries(names)[-1].casefold() != "comment":
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


def _entries(line: str) -> list[str]:
    return [cell.strip() for cell in re.split("\t|;" if "\t" in line or ";" in line else ",", line)]


Row = tuple[int, list[str]]

_LOOKED_AT = 200  # lines
_SEPARATORS = ";\t,|"  # and spaces
_IN_A_ROW = 3  # consecutive rows of numbers that begin the samples
_SPREADSHEET = r"N/A|NV|N/V|WERT|VALUE|DIV|ZAHL|NUM|REF|BEZUG|NAME|NULL|QNAN|INF|IND"
_HASH = re.compile(rf"(?<!\.)#(?!{_SPREADSHEET}|[,;\t])", re.IGNORECASE)
_SPACED = re.compile(r"\S+(?:\s+[\[(][^\])]*[\])])?")  # a name, and its unit in brackets after a space


class Layout(NamedTuple):
    """Names of the columns, and all rows below them."""

    names: list[str]
    line: int  # of the names
    units: list[str]  # as written in the row of units; empty if there is none
    rows: list[Row]
    before: list[int]  # lines above the names that are not comments
    separator: str


def lay_out(path: FilePath, lines: list[Line], is_unit: Callable[[str], bool]) -> Layout:
    """Find names and rows among the lines. Raises `InvalidFile` if there are none."""
    separator = ""
    if lines and (said := re.fullmatch(r'"?sep=(.)"?\s*', lines[0][1], re.IGNORECASE)):
        separator, lines = said[1], lines[1:]
    bare = [(i, _uncommented(line)) for i, line in lines]
    content = [(i, line) for i, line in bare if line.strip(" \t,;")]
    if not content:
        raise InvalidFile(path, "is empty")
    separator = separator or _separator([line for _, line in content])
    rows = list(_cells(path, content, separator))
    rows[:_LOOKED_AT] = [(i, [cell.strip() for cell in row]) for i, row in rows[:_LOOKED_AT]]
    if all(len(row) == 1 and line.startswith('"') for (_, row), (_, line) in zip(rows, content, strict=False)):
        unquoted = [(i, row[0]) for i, row in rows]  # whole lines were quoted
        if any(mark in unquoted[0][1] for mark in _SEPARATORS):
            return lay_out(path, unquoted, is_unit)
    first = _first_sample(rows)
    if first:
        rows[first - 1] = _parted(rows[first - 1], len(rows[first][1]))
    if first == 0:
        commented = _commented_names(lines, rows[0], separator)
        return Layout(commented[1], commented[0], [], rows, [], separator) if commented else _plain(rows, separator)
    above = rows[first - 1][1] if first else []
    if first is None or _numeric(above) or not _alike(above, rows[first][1]):
        return _plain(rows, separator)
    line, names = rows[first - 1]
    units: list[str] = []
    at = first - 1
    if at and _alike(rows[at - 1][1], names) and any(is_unit(cell) for cell in names):
        units, at = names, at - 1
        line, names = rows[at]
        names = [_with_unit(name, units[k] if k < len(units) else "") for k, name in enumerate(names)]
    return Layout(names, line, units, rows[first:], [i for i, _ in rows[:at]], separator)


def _plain(rows: list[Row], separator: str) -> Layout:
    """Return the layout of a table whose first row holds the names."""
    return Layout(rows[0][1], rows[0][0], [], rows[1:], [], separator)


def _parted(row: Row, count: int) -> Row:
    """Split a row of one cell by another separator if that gives `count` cells, as in names with tabs over commas."""
    line, cells = row
    for separator in _SEPARATORS if len(cells) == 1 < count else "":
        parts = [part.strip() for part in cells[0].split(separator)]
        if len(parts) == count:
            return line, parts
    return row


def _with_unit(name: str, unit: str) -> str:
    unit = unit.strip().strip("[]()").strip()
    return f"{name} [{unit}]" if unit not in ("", "-") and not re.search(r"[\[(]", name) else name


def _uncommented(line: str) -> str:
    """Return the line up to a `#` that begins a comment: not in quotes, and not in a spreadsheet's error (#N/A)."""
    for mark in _HASH.finditer(line) if "#" in line else ():
        before = line[: mark.start()]
        if before.count('"') % 2 == 0:
            return before
    return line


def _separator(lines: list[str]) -> str:
    """Return the character that most lines contain equally often, as does a line of names."""
    looked_at = lines[:_LOOKED_AT]
    found = []
    for separator in _SEPARATORS:
        counts = [re.sub(r'"[^"]*"', "", line).count(separator) for line in looked_at]
        (most, times), *_ = Counter(count for count in counts if count).most_common(1) or [(0, 0)]
        if 2 * times >= len(looked_at):
            named = any(
                n == most and not _numeric(line.split(separator)) for n, line in zip(counts, looked_at, strict=True)
            )
            found.append((named, separator))
    if found:
        return max(found, key=lambda pair: pair[0])[1]
    spaced = [len(line.split()) for line in looked_at]
    if min(spaced[1:], default=1) > 1:
        return " "
    return max(_SEPARATORS, key=looked_at[0].count)


def _numeric(cells: list[str]) -> bool:
    """Return whether most of the cells that are not empty are numbers, or two or more and half of them."""
    filled = [cell for cell in cells if cell.strip()]
    count = sum(is_number(cell) or is_clock(cell) for cell in filled)
    return 2 * count > len(filled) or 2 * count == len(filled) > 2


def _first_sample(rows: list[Row]) -> int | None:
    """Return the index of the first row of samples, or None."""
    numeric = [_numeric(row) for _, row in rows[:_LOOKED_AT]]
    counts = Counter(len(row) for (_, row), is_sample in zip(rows, numeric, strict=False) if is_sample)
    usual = counts.most_common(1)[0][0] if counts else 0
    numeric = [is_sample and len(row) == usual for (_, row), is_sample in zip(rows, numeric, strict=False)]
    for k, starts in enumerate(numeric):
        if starts and all(numeric[k : k + _IN_A_ROW]):
            return k
    return None


def _alike(above: list[str], below: list[str]) -> bool:
    """Return whether two rows have the same number of cells, except for empty ones at their ends."""
    return len(above) == len(below) or _filled(above) == _filled(below)


def _filled(row: list[str]) -> int:
    return max((k for k, cell in enumerate(row, 1) if cell), default=0)


def _commented_names(lines: list[Line], first: Row, separator: str) -> Row | None:
    """Return the names in the last comment above the first row, None if they do not fit."""
    above = [(i, line) for i, line in lines if i < first[0] and line.strip().startswith("#")]
    for line, text in reversed(above):
        names = [name.strip() for name in _split(text.strip().lstrip("#").strip(), separator, len(first[1]))]
        if len(names) == len(first[1]) and not _numeric(names):
            return line, names
    return None


def _split(text: str, separator: str, count: int) -> list[str]:
    if separator != " ":
        return text.split(separator)
    return text.split() if len(text.split()) == count else _SPACED.findall(text)


def _cells(path: FilePath, content: list[Line], separator: str) -> Iterator[Row]:
    """Return the line and cells of every row; a quoted cell may span several lines, of which the last counts."""
    if separator == " ":
        count = Counter(len(line.split()) for _, line in content[1:]).most_common(1)
        yield from ((i, _split(line, " ", count[0][0] if count else 0)) for i, line in content)
        return
    reader = csv.reader((line for _, line in content), delimiter=separator, strict=True)
    first = 0
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            long = "limit" in str(error)
            what = f"a cell has over {csv.field_size_limit()} characters" if long else "a quotation mark is not closed"
            raise InvalidFile(path, what, line=content[first][0]) from None
        first = min(reader.line_num, len(content) - 1)
        yield content[reader.line_num - 1][0], row
