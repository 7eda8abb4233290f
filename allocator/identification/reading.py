"""Measured forces from a CSV file.

One line of column names, one sample a line, `#` starts a comment; the separator is a comma, a semicolon or a tab, and
with the latter two numbers may have decimal commas. Columns, in any order, others are ignored:

    contraction | contraction_pct | length_mm | length_m        (lengths need the rest length)
    pressure_bar | pressure_kpa | pressure_mpa | pressure_psi | pressure_pa        gauge
    force_N
"""

from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.identification.samples import Samples, find_mistake
from allocator.records import records
from allocator.units import BAR, DEG, KPA, MM, MPA, PERCENT, PSI

FilePath: TypeAlias = str | PathLike[str]

_PRESSURE = {"bar": BAR, "kpa": KPA, "mpa": MPA, "psi": PSI, "pa": 1.0}

_UNITS = {
    "contraction": {"contraction": 1.0, "contraction_pct": PERCENT},
    "length": {"length_mm": MM, "length_m": 1.0},
    **{p: {f"{p}_{unit}": scale for unit, scale in _PRESSURE.items()} for p in ("pressure", "pressure1", "pressure2")},
    "force": {"force_n": 1.0},
    "theta": {"theta_rad": 1.0, "theta_deg": DEG},
    "torque": {"torque_nm": 1.0},
    "time": {"time_s": 1.0, "time_ms": 1e-3},
    "direction": {"direction": 1.0},
    "sweep": {"sweep": 1.0},
    "rest_length": {"rest_length_mm": MM, "rest_length_m": 1.0},
}


class Table(NamedTuple):
    """The text of a CSV file, taken apart."""

    names: list[str]  # of the columns, as written
    rows: list[list[str]]
    lines: list[int]  # of the rows, counted from 1
    decimal_comma: bool


def read_samples(path: FilePath, rest_length: float | None = None) -> Samples:
    """Read measured forces; `rest_length` [m] is needed for a column of lengths.

    Raises `InvalidFile`, with line and column, at anything that cannot be read or cannot be right.
    """
    table = read_table(path)
    P = quantity_of(path, table, "pressure")
    F = quantity_of(path, table, "force")
    eps = _contraction(path, table, rest_length)
    if mistake := find_mistake(eps, P, F):
        column = _column(path, table, mistake.quantity, ("length",) if mistake.quantity == "contraction" else ())
        raise InvalidFile(path, mistake.sentence, line=table.lines[mistake.place], column=table.names[column])
    return Samples.checked(eps, P, F)


def read_table(path: FilePath) -> Table:
    """Take the file apart, by whatever separator it uses."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InvalidFile(path, "does not exist") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidFile(path, f"cannot be read as text ({error})") from None
    content = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.partition("#")[0].strip()]
    if not content:
        raise InvalidFile(path, "is empty")
    header = content[0][1]
    separator = max(";\t,", key=header.count)
    parsed = records(path, ((i, line.partition("#")[0]) for i, line in content), separator)
    names, *rows = [[cell.strip() for cell in row] for _, row in parsed]
    lines = [i for i, _ in content[1:]]
    if not rows:
        raise InvalidFile(path, "has column names but no samples")
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(names):
            hint = "; with decimal commas, separate the columns by semicolons" if separator == "," else ""
            raise InvalidFile(path, f"has {len(row)} values under {len(names)} column names{hint}", line=line)
    return Table(names, rows, lines, separator != ",")


def _contraction(path: FilePath, table: Table, rest_length: float | None) -> Array:
    if find_column(path, table, "contraction") is not None:
        if find_column(path, table, "length") is not None:
            raise InvalidFile(path, "has a contraction and a length; keep one of the two columns")
        eps = quantity_of(path, table, "contraction")
        percent = table.names[_column(path, table, "contraction")].lower() == "contraction_pct"
        if percent and 0 < np.abs(eps).max() <= 0.6 * PERCENT:
            raise InvalidFile(path, "never exceeds 0.6 %; was the ratio meant for percent?", column="contraction_pct")
        return eps
    column = _column(path, table, "contraction", ("length",))
    length = quantity_of(path, table, "length")
    if rest_length is None:
        raise InvalidFile(path, "lengths need the rest length of the muscle", column=table.names[column])
    if not (np.isfinite(rest_length) and rest_length > 0):
        raise InvalidInput(f"rest_length = {rest_length!r} m has to be positive")
    if not 0.3 < np.median(length) / rest_length < 1.3:
        what = f"lengths around {np.median(length):.4g} m do not belong to a muscle of {rest_length:.4g} m"
        raise InvalidFile(path, f"{what}; mm for m?", column=table.names[column])
    return (rest_length - length) / rest_length


def find_column(path: FilePath, table: Table, quantity: str) -> int | None:
    """Index of the one column with this quantity, if there is one."""
    found = [i for i, name in enumerate(table.names) if name.lower() in _UNITS[quantity]]
    if len(found) > 1:
        both = " and ".join(repr(table.names[i]) for i in found)
        raise InvalidFile(path, f"columns {both} give the {quantity} twice")
    return found[0] if found else None


def _column(path: FilePath, table: Table, quantity: str, instead: Iterable[str] = ()) -> int:
    """Index of the column with this quantity, or one of those that serve instead."""
    quantities = (quantity, *instead)
    for each in quantities:
        if (index := find_column(path, table, each)) is not None:
            return index
    valid = ", ".join(
        name.replace("force_n", "force_N").replace("_nm", "_Nm") for each in quantities for name in _UNITS[each]
    )
    for name in table.names:
        if name.lower() in quantities:
            raise InvalidFile(path, f"has no unit; name it one of {valid}", column=name)
        if name.lower().partition("_")[0] in quantities:
            raise InvalidFile(path, f"has an unknown unit; known are {valid}", column=name)
    raise InvalidFile(path, f"has no column for the {quantity} (one of {valid}) among {', '.join(table.names)}")


def quantity_of(path: FilePath, table: Table, quantity: str) -> Array:
    """The column of this quantity in SI units."""
    column = _column(path, table, quantity)
    name = table.names[column]
    values = [
        number_of(path, row[column], table.decimal_comma, line, name)
        for line, row in zip(table.lines, table.rows, strict=True)
    ]
    return np.array(values) * _UNITS[quantity][name.lower()]


def number_of(path: FilePath, text: str, decimal_comma: bool, line: int, column: str) -> float:
    """The number in one cell."""
    try:
        value = float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        what = f"{text!r} is not a number" if text else "a value is missing"
        raise InvalidFile(path, what, line=line, column=column) from None
    if not np.isfinite(value):
        raise InvalidFile(path, f"{text} is not a finite number", line=line, column=column)
    return value


__all__ = ["FilePath", "Table", "find_column", "number_of", "quantity_of", "read_samples", "read_table"]
