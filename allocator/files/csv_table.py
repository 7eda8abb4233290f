"""The text of a CSV file is taken apart here.

One line of column names, one sample a line. `#` starts a comment but among the names; the separator is a comma, a
semicolon or a tab, and with the latter two numbers may have decimal commas. The text is UTF-8, UTF-16 with its mark, or
else Windows-1252.
"""

import csv
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile

FilePath: TypeAlias = str | PathLike[str]


class Table(NamedTuple):
    """A table holds the cells of a file, not yet numbers."""

    path: FilePath
    names: list[str]  # of the columns, as written
    rows: list[list[str]]
    lines: list[int]  # of the rows, counted from 1
    decimal_comma: bool

    def numbers(self, index: int) -> Array:
        """Return the column (n,) as floats. Raises `InvalidFile` with the line of a cell that is no finite number."""
        cells = [row[index] for row in self.rows]
        if self.decimal_comma:
            self._refuse_both_marks(index, cells)
            cells = [cell.replace(",", ".") for cell in cells]
        try:
            values = np.fromiter(map(float, cells), float, len(cells))
        except ValueError:
            values = np.array([_float_or_nan(cell) for cell in cells])
        if (wrong := ~np.isfinite(values)).any():
            i = int(np.argmax(wrong))
            raise InvalidFile(self.path, _complaint(self.rows[i][index]), line=self.lines[i], column=self.names[index])
        return values

    def _refuse_both_marks(self, index: int, cells: list[str]) -> None:
        """Refuse a column with decimal commas and points: one of the two may separate thousands."""
        comma = next((i for i, cell in enumerate(cells) if "," in cell), None)
        point = next((i for i, cell in enumerate(cells) if "." in cell), None)
        if comma is not None and point is not None:
            what = f"{cells[comma]} has a comma and {cells[point]} (line {self.lines[point]}) a point"
            sentence = f"{what}; write all decimals alike, and thousands without a separator"
            raise InvalidFile(self.path, sentence, line=self.lines[comma], column=self.names[index])


def _float_or_nan(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _complaint(cell: str) -> str:
    if not cell.strip():
        return "a value is missing"
    shown = cell if len(cell) <= 40 else f"{cell[:40]}…"
    words = np.isnan(_float_or_nan(cell)) and cell.strip().lower() != "nan"
    return f"{shown!r} is not a number" if words else f"{shown} is not a finite number"


def read_table(path: FilePath) -> Table:
    """Take the file apart, by whatever separator it uses."""
    content = [(i, line) for i, line in enumerate(_text(path).splitlines(), 1) if line.partition("#")[0].strip()]
    if not content:
        raise InvalidFile(path, "is empty")
    header = content[0][1]
    content[1:] = [(i, line.partition("#")[0]) for i, line in content[1:]]  # a name may be "Sample #"
    separator = max(";\t,", key=header.count)
    numbered = _cells(path, content, separator)
    _, names = next(numbered)
    names = [name.strip() for name in names]
    lines, rows = [], []
    for line, row in numbered:
        if len(row) > len(names) and not any(row[len(names) :]):  # a spreadsheet's empty cells
            row = row[: len(names)]
        if len(row) != len(names):
            hint = "; with decimal commas, separate the columns by semicolons" if separator == "," else ""
            raise InvalidFile(path, f"has {len(row)} values under {len(names)} column names{hint}", line=line)
        if any(row):
            lines.append(line)
            rows.append(row)
    if not rows:
        raise InvalidFile(path, "has column names but no samples")
    return Table(path, names, rows, lines, separator != ",")


def _text(path: FilePath) -> str:
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise InvalidFile(path, "does not exist") from None
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror})") from None
    wide = data.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" in text:
            break
        return text
    raise InvalidFile(path, "is not a text file; save a spreadsheet as CSV")


def _cells(path: FilePath, content: list[tuple[int, str]], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Return the line and cells of every row; a quoted cell may go over several lines, of which the last is counted."""
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


__all__ = ["FilePath", "Table", "read_table"]
