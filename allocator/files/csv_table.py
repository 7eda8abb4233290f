"""Tables of CSV files: one line of column names, then one sample per line.

Separators are a comma, a semicolon, a tab or spaces; with all but the comma numbers may have decimal commas. `#` begins
a comment. Lines above the names, a row of units below them, and the headers of LabVIEW files are recognised
(`allocator.files.layout`).
"""

import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.cells import (
    clock_seconds,
    complaint,
    floats,
    is_clock,
    is_missing,
    is_misspelled,
    is_number,
    listed,
    thousands,
)
from allocator.files.layout import Layout, fill_times, filled_names, lay_out, without_headers
from allocator.files.text import FilePath, read_text


class Table(NamedTuple):
    """Cells of a file, as text."""

    path: FilePath
    names: list[str]  # of the columns, as written
    rows: list[list[str]]
    lines: list[int]  # of the rows, counted from 1
    decimal_comma: bool
    names_line: int = 1
    notes: tuple[str, ...] = ()  # about lines that were not read
    comments: tuple[str, ...] = ()  # whole lines, as written

    def numbers(self, index: int, *, gaps: bool = False, hint: str = "") -> Array:
        """Return the column (n,) as floats; with `gaps` a cell without a number is NaN, unless half of them are.

        `hint` is added to the message about such cells. Raises `InvalidFile` with the lines of all cells that are not
        finite numbers, or have ambiguous commas.
        """
        cells = [row[index] for row in self.rows]
        if self.decimal_comma:
            self._refuse_two_marks(index, cells)
        return self._known(index, floats(cells, self.decimal_comma), gaps, hint)

    def times(self, index: int, *, gaps: bool = False) -> Array:
        """Return the column (n,) as `numbers` does, or in seconds if it holds clock times. Raises `InvalidFile`."""
        cells = [row[index] for row in self.rows]
        if not self.is_clock(index):
            return self.numbers(index, gaps=gaps)
        return self._known(index, clock_seconds(cells), gaps, "")

    def is_clock(self, index: int) -> bool:
        """Return whether the first cell of the column that is not missing is a clock time."""
        return is_clock(
            next((row[index] for row in self.rows if row[index].strip() and not is_missing(row[index])), "")
        )

    def spelled(self, index: int, numbers: Mapping[str, float]) -> "Table":
        """Return the table with the words of a column replaced by `numbers`, whatever their case."""
        rows = [list(row) for row in self.rows]
        for row in rows:
            number = numbers.get(row[index].strip().casefold())
            row[index] = row[index] if number is None else f"{number:g}"
        return self._replace(rows=rows)

    def where(self, keep: Mask) -> "Table":
        """Return the table with those rows (n,) that are marked in `keep`."""
        chosen = np.flatnonzero(keep)
        return self._replace(rows=[self.rows[i] for i in chosen], lines=[self.lines[i] for i in chosen])

    def _known(self, index: int, values: Array, gaps: bool, hint: str) -> Array:
        wrong = ~np.isfinite(values)
        if not wrong.any():
            return values
        gaps = gaps and 2 * wrong.sum() < wrong.size
        rows = [i for i in np.flatnonzero(wrong).tolist() if not gaps or is_misspelled(self.rows[i][index])]
        if not rows:
            values[wrong] = np.nan
            return values
        i, *others = rows
        sentence = complaint(self.rows[i][index])
        if others:
            sentence += f"; nor is there a number in {listed([self.lines[k] for k in others])}"
        said = f"{sentence}{hint}" if 2 * len(others) < len(values) else sentence
        raise InvalidFile(self.path, said, line=self.lines[i], column=self.names[index])

    def _refuse_two_marks(self, index: int, cells: list[str]) -> None:
        """Raise `InvalidFile` for a column in which a comma or a point may separate thousands."""
        comma = next((i for i, cell in enumerate(cells) if "," in cell), None)
        point = next((i for i, cell in enumerate(cells) if "." in cell and is_number(cell)), None)
        like = "write all decimals alike, and thousands without a separator"
        if comma is not None and any("." in cell for cell in cells):
            point = next(i for i, cell in enumerate(cells) if "." in cell)
            what = f"{cells[comma]} has a comma and {cells[point]} (line {self.lines[point]}) a point"
            raise InvalidFile(self.path, f"{what}; {like}", line=self.lines[comma], column=self.names[index])
        if (i := thousands(cells)) is not None:
            what = f"the comma in {cells[i].strip()} seems to separate thousands"
            raise InvalidFile(self.path, f"{what}; {like}", line=self.lines[i], column=self.names[index])
        other = None if point is None else self._decimal_comma_elsewhere()
        if (
            other is not None
            and point is not None
            and thousands([cell.replace(".", ",") for cell in cells]) is not None
        ):
            what = f"{cells[point]} has a point and {other[1]} (line {other[0]}) a comma"
            raise InvalidFile(self.path, f"{what}; {like}", line=self.lines[point], column=self.names[index])

    def _decimal_comma_elsewhere(self) -> tuple[int, str] | None:
        """Return the line and text of a cell with a decimal comma, or None."""
        for line, row in zip(self.lines, self.rows, strict=True):
            for cell in row:
                if re.fullmatch(r"[+-]?\d+,\d+", cell):
                    return line, cell
        return None


def read_table(path: FilePath, *, skip_rows: int = 0, is_unit: Callable[[str], bool] = lambda text: False) -> Table:
    """Read a table with any supported separator.

    `skip_rows` lines are skipped at the beginning of the file; `is_unit` recognises the cells of a row of units.

    Raises `InvalidFile` for a file that is not a table, and `InvalidInput` for more `skip_rows` than lines.
    """
    text = read_text(path)
    lines = list(enumerate(re.split("\r\n|\r|\n", text), 1))
    if not 0 <= skip_rows < len(lines):
        raise InvalidInput(f"skip_rows = {skip_rows}: expected 0 to {len(lines) - 1}, as {path} has {len(lines)} lines")
    lines = lines[skip_rows:]
    header = without_headers(lines)
    found = lay_out(path, lines if header is None else header.lines, is_unit)
    names = found.names if header is None else filled_names(found.names, header.units)
    while len(names) > 1 and not names[-1] and all(len(row) < len(names) or not row[-1] for _, row in found.rows):
        names = names[:-1]
    numbers, rows, repeated, cut = _samples(path, names, found, whole=text.endswith(("\n", "\r")))
    if not rows:
        raise InvalidFile(path, "has column names but no samples")
    if header is not None:
        fill_times(names, rows, header.step)
    first = min((i for i, line in lines if line.strip()), default=1)
    notes = []
    if header is not None or found.before:
        above = f"lines {first} to {found.line - 1}" if first < found.line - 1 else f"line {first}"
        notes.append(f"not read: {above}, above the column names")
    notes += [f"the column names are repeated in {listed(repeated)}"] if repeated else []
    notes += [f"line {cut}, the last one, is cut off and was not read"] if cut else []
    comments = tuple(line for _, line in lines if line.startswith("#"))
    return Table(path, names, rows, numbers, found.separator != ",", found.line, tuple(notes), comments)


def _samples(
    path: FilePath, names: list[str], found: Layout, whole: bool
) -> tuple[list[int], list[list[str]], list[int], int | None]:
    """Return lines and cells of the samples, the lines that repeat the names, and a truncated last line."""
    lines: list[int] = []
    rows: list[list[str]] = []
    repeated: list[int] = []
    plain = [re.sub(r"\s*\[[^]]*\]$", "", name) for name in names]
    heads = (names[0], plain[0], *found.units[:1])
    for k, (line, row) in enumerate(found.rows):
        if len(row) > len(names) and not any(row[len(names) :]):  # a spreadsheet's empty cells
            row = row[: len(names)]
        if not any(row):
            continue
        if row[0].strip() in heads and [cell.strip() for cell in row] in (names, plain, found.units):
            repeated.append(line)
            continue
        if len(row) != len(names):
            if len(row) < len(names) and k == len(found.rows) - 1 and rows and not whole:
                return lines, rows, repeated, line
            raise InvalidFile(path, _uneven(len(row), names, found), line=line)
        lines.append(line)
        rows.append(row)
    return lines, rows, repeated, None


def _uneven(count: int, names: list[str], found: Layout) -> str:
    commas = found.separator == "," and count > len(names) > 1
    hint = "; with decimal commas, separate the columns by semicolons" if commas else ""
    above = f"has {count} values under {len(names)} column names"
    where = f" (line {found.line}; if that is not the line of names, say --skip-rows)" if len(names) == 1 else ""
    return f"{above}{where}{hint}"
