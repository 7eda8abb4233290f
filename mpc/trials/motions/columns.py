"""Columns of a motion's file by name and unit: `t`, `Zeit [ms]`, `x_mm`, `x [m]`, `elbow (rad)`, `K11 [N·m/rad]`.

A column `x_mm` may also be called `x` with another unit of length. A time without a unit is in seconds, a stiffness
without one in the unit of the motion; angles and positions need a unit.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, notice
from allocator.files.csv_table import Table, read_table
from allocator.identification.headers import UNITS, is_unit, quantity_named, unit_of
from allocator.units import DEG, MM

JOINT_STIFFNESS, HAND_STIFFNESS = "N·m/rad", "N/m"
_FACTORS: Mapping[str, Mapping[str, float]] = {  # of the units that may stand in place of one
    "s": UNITS["time"],
    "deg": {unit: factor / DEG for unit, factor in UNITS["theta"].items()},
    "mm": {unit: factor / MM for unit, factor in UNITS["length"].items()},
    JOINT_STIFFNESS: {"": 1.0, "Nm/rad": 1.0, "Nm/deg": 1 / DEG, "Nm/°": 1 / DEG},
    HAND_STIFFNESS: {"": 1.0, "N/m": 1.0, "N/mm": 1e3},
}
_ALIASES = {"t": "time", "theta": "theta"}  # names with synonyms in several languages
_SYNONYMS = {"stiffness": ("k", "steifigkeit", "drehsteifigkeit", "raideur")}
_NAME = re.compile(r"(.+?)(?:\s*[\[(](.*)[\])]|_([^\W_]+))?\s*")


class UnusedColumns(UserWarning):
    """Warning that a motion's file has columns that are not read."""


@dataclass(frozen=True)
class MotionColumns:
    """Table of a motion, and the columns that were found in it."""

    table: Table
    found: Mapping[str, tuple[int, float]]  # place and factor of each column, by its usual name

    @classmethod
    def read(cls, path: str | Path, wanted: Mapping[str, str]) -> Self:
        """Read the table in `path`, and find the columns `wanted`, usual names with their units.

        Raises `InvalidFile` for a unit that is missing or unknown, and for a column that is there twice.
        """
        table, found = read_table(path, is_unit=is_unit), {}
        for place, header in enumerate(table.names):
            for name, unit in wanted.items():
                factor = _factor(table, header, name, unit)
                if factor is None:
                    continue
                if name in found:
                    raise InvalidFile(path, f"there are two columns of {name}", line=table.names_line, column=header)
                found[name] = place, factor
        return cls(table, found)

    def tell_unused(self) -> None:
        """Warn with `UnusedColumns` if there are other columns."""
        read = {place for place, _ in self.found.values()}
        if others := [name for i, name in enumerate(self.table.names) if name and i not in read]:
            notice(f"{self.table.path}: columns not used: {', '.join(others)}", UnusedColumns)

    def numbers(self, name: str) -> Array:
        """Return the numbers (M,) of a column in its usual unit. Raises `InvalidFile` if there is none."""
        if name not in self.found:
            there = ", ".join(self.table.names)
            raise InvalidFile(
                self.table.path, f"this column is missing; found: {there}", line=self.table.names_line, column=name
            )
        place, factor = self.found[name]
        return self.table.numbers(place) * factor

    def refuse(self, name: str, wrong: Mask, values: Array, sentence: str) -> None:
        """Raise `InvalidFile` at the first of the `values` of a column that are marked `wrong`."""
        if wrong.any():
            i = int(np.argmax(wrong))
            column = self.table.names[self.found[name][0]] if name in self.found else name
            raise InvalidFile(self.table.path, sentence.format(values[i]), line=self.table.lines[i], column=column)


def _factor(table: Table, header: str, name: str, unit: str) -> float | None:
    """Return the factor from the unit in a `header` to the `unit` of the column `name`; None for another column."""
    if header == name:
        return 1.0
    match = _NAME.fullmatch(header)
    if match is None or not _is_called(match[1], name.removesuffix(f"_{unit}")):
        return None
    known, own = _FACTORS[unit], match[2] or match[3] or ""
    spelled = re.sub(r"[\s·⋅*.]", "", own) if "/" in unit else unit_of(own)[0] if own else ""
    if spelled not in known and match[3]:
        return None  # a further word, as in theta_ref
    if spelled not in known:
        fault = f"the unit {own!r} is unknown" if own else "has no unit"
        raise InvalidFile(
            table.path, f"{fault}; known are {', '.join(filter(None, known))}", line=table.names_line, column=header
        )
    return known[spelled]


def _is_called(said: str, base: str) -> bool:
    quantity = _ALIASES.get(base)
    return _plain(said) in (_plain(base), *_SYNONYMS.get(base, ())) or (
        quantity is not None and quantity_named(said) == quantity
    )


def _plain(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip()).casefold()
