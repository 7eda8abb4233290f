"""Columns of a file by quantity, with their numbers in SI units.

The quantities follow from the names (see `headers`), or from the caller: `columns={"pressure": "p:bar", "force":
"F:-N"}` (quantity, name of the column and unit) is `--columns pressure=p:bar,force=F:-N` on the command line. A minus
sign before the unit reverses the sign; `bar(abs)` subtracts the standard atmosphere; `ignore=a;b` skips columns. Units
by the caller are trusted; a unit in a name is refused if the greatest number is implausible in it. `Measured.notes`
lists all columns that are not read.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files import bags
from allocator.files.cells import is_number, listed
from allocator.files.csv_table import Table, read_table
from allocator.files.text import FilePath
from allocator.identification import encoder
from allocator.identification.headers import UNITS, Meaning, is_unit, meaning_of, quantity_named, unit_of, unit_said
from allocator.units import BAR, DEG

ATMOSPHERE = 1.01325 * BAR
_PLAUSIBLE = {  # range of the greatest magnitude of a quantity, in SI units
    "contraction": (0.006, np.inf),  # `find_mistake` finds contractions beyond any muscle's
    "length": (0.02, 3.0),
    "pressure": (1 * BAR, 20 * BAR),
    "force": (8.0, 1e5),
    "theta": (2 * DEG, 2 * np.pi),
}


_WEIGHTS = {"kgf", "gf", "lbf", "N", "kN", "mN"}
IGNORE = "ignore"  # keyword for columns to skip
_STAMPS = 1e6  # [s] greater times are counted from the first row
_RISING = "up rising rise inflating inflation loading increasing auf steigend aufwärts montant + ↑"
_FALLING = "down falling fall deflating deflation unloading decreasing ab fallend abwärts descendant - ↓"
_DIRECTIONS = dict.fromkeys(_RISING.split(), 1.0) | dict.fromkeys(_FALLING.split(), -1.0)


class Column(NamedTuple):
    """A column of a file, its quantity and its unit."""

    place: int  # counted from 0
    name: str
    quantity: str
    unit: str
    scale: float  # to SI, negative if the sign is reversed
    offset: float  # [SI] subtracted
    certain: bool  # whether the caller gave the unit

    def contradiction(self, table: Table) -> str:
        """Return a sentence if the caller gave another unit than the file, or ""."""
        header = table.names[self.place]
        if not self.certain or (said := unit_said(header)) in ("", self.unit):
            return ""
        return f"{header!r} is read in {self.unit or 'no unit'}, as --columns says, not in {said}"


class Measured(NamedTuple):
    """Quantities of a file by name: their columns, and their values (n,) in SI units."""

    table: Table
    columns: Mapping[str, Column]
    values: Mapping[str, Array]
    notes: tuple[str, ...] = ()  # sentences about data not read or left out

    def mistake(self, quantity: str, sentence: str, row: int | None = None) -> InvalidFile:
        """Return the error for a quantity, located in `row` if given."""
        line = None if row is None else self.table.lines[row]
        return InvalidFile(self.table.path, sentence, line=line, column=self.columns[quantity].name)

    def lines(self, rows: Mask | NDArray[np.intp]) -> str:
        """Return the lines of some rows, marked (n,) or by their indices, in words."""
        return listed(np.array(self.table.lines)[rows].tolist())

    def where(self, keep: Mask, note: str) -> "Measured":
        """Return the rows marked in `keep`, with a note about the others."""
        values = {quantity: array[keep] for quantity, array in self.values.items()}
        return self._replace(table=self.table.where(keep), values=values, notes=(*self.notes, note))


def read_columns(
    path: FilePath,
    wanted: Sequence[tuple[str, ...]],
    optional: Sequence[str] = (),
    columns: Mapping[str, str] | None = None,
    *,
    skip_rows: int = 0,
    topics: str | None = None,
) -> Measured:
    """Read the quantities `wanted`, one of each tuple of alternatives, and the `optional` ones present.

    `skip_rows` lines are skipped at the beginning of the file. `topics` maps quantities to numbers of a recording (see
    `allocator.files.bags`); its lines are then the messages of the first topic. With a column of times, rows with a
    missing number are left out, unless they are half of all. Angles are readings of the encoder: a zero that the log's
    loop has subtracted is added again.

    Raises `InvalidFile`, with line and column, for a column that is missing, given twice, or implausible in its unit,
    and for an unread column with a unit of torque if a torque is wanted.
    """
    table = _table(path, skip_rows, topics)
    mapping = dict(columns or {})
    ignored = {_place(table, name.strip()) for name in mapping.pop(IGNORE, "").split(";") if name.strip()}
    groups = [*wanted, *((quantity,) for quantity in optional)]
    chosen = _choose(table, groups, len(wanted), mapping, ignored)
    unused = [i for i, name in enumerate(table.names) if name and i not in {c.place for c in chosen.values()}]
    _refuse_torque(table, [i for i in unused if i not in ignored], groups, chosen)
    values = {quantity: _values(table, column, gaps="time" in chosen) for quantity, column in chosen.items()}
    notes = table.notes
    if unused:
        notes = (*notes, f"columns not used: {', '.join(table.names[i] for i in unused)}")
    notes = (*notes, *filter(None, (column.contradiction(table) for column in chosen.values())))
    if "theta" in values and (zero := encoder.subtracted(table.comments)):
        values["theta"] = values["theta"] + zero
        notes = (*notes, f"angles are the encoder's readings: its zero, {zero / DEG:.4g}°, was added to theta again")
    measured = complete(Measured(table, chosen, values, notes))
    for kind in _PLAUSIBLE:
        _check_unit(measured, kind)
    return measured


def complete(measured: Measured) -> Measured:
    """Return the rows with a number in every column. Raises `InvalidFile` if there are none."""
    missing = np.asarray(np.isnan(np.stack(list(measured.values.values()))).any(axis=0))
    if missing.all():
        columns = ", ".join(measured.columns)
        raise InvalidFile(measured.table.path, f"no row has a number in each of the columns {columns}")
    if not missing.any():
        return measured
    return measured.where(~missing, f"rows without a number in every column were left out: {measured.lines(missing)}")


def _table(path: FilePath, skip_rows: int, topics: str | None) -> Table:
    """Return the table of a CSV file, or that of the `topics` of a recording."""
    place = Path(path)
    if topics is None:
        if bags.is_recording(place):
            with bags.opened(place) as bag:
                told = bags.described(bag)
            raise InvalidFile(path, f"is a recording: --topics has to map quantities to its numbers; topics: {told}")
        return read_table(path, skip_rows=skip_rows, is_unit=is_unit)
    if not bags.is_recording(place):
        raise InvalidFile(path, "is no recording, for which --topics is: .bag, .mcap, or the folder of a ROS 2 bag")
    names, values, left = bags.sampled(place, bags.Quantity.parse(topics))
    if not len(values):
        raise InvalidFile(path, "never has all these topics within a second")
    notes = (f"{left} messages without a recent one of the other topics were left out",) if left else ()
    rows = [[bags.FORMAT % value for value in row] for row in values.tolist()]
    return Table(path, names, rows, [*range(1, len(rows) + 1)], False, 1, notes)


def parse_columns(text: str | None) -> dict[str, str]:
    """Read the mapping `pressure=p:bar,force=F:N` of the command line."""
    if not text:
        return {}
    parts = [part.partition("=") for part in re.split(r",(?=[^,=]+=)", text)]
    for quantity, _, column in parts:
        if not (quantity.strip() and column.strip()):
            raise InvalidInput(f"--columns {text}: expected QUANTITY=NAME:UNIT, such as pressure=p:bar,force=F:N")
        if re.search(r"\s\w+=", column):
            raise InvalidInput(f"--columns {text}: separate quantities by commas, such as pressure=p:bar,force=F:N")
    if len({quantity.strip() for quantity, *_ in parts}) < len(parts):
        raise InvalidInput(f"--columns {text}: a quantity is given twice")
    return {quantity.strip(): column.strip() for quantity, _, column in parts}


def _values(table: Table, column: Column, *, gaps: bool) -> Array:
    """Return the column (n,) in SI units; with `gaps`, NaN in cells without a number."""
    hint = ""
    if column.quantity == "time":
        times = table.times(column.place, gaps=gaps)
        scale = 1.0 if table.is_clock(column.place) else column.scale
        first = times[np.isfinite(times)][:1]
        if first.size and abs(first[0]) * scale > _STAMPS:
            times = times - first[0]
        return np.asarray(times * scale)
    if column.quantity == "direction":
        hint = "; give +1 or up (rising), -1 or down (falling), or 0 (not known)"
        table = table.spelled(column.place, _DIRECTIONS)
    return np.asarray(table.numbers(column.place, gaps=gaps, hint=hint) * column.scale - column.offset)


# --- which column ---------------------------------------------------------------------------------------------------


def _fault(table: Table, sentence: str, column: str | None = None) -> InvalidFile:
    return InvalidFile(table.path, sentence, line=table.names_line, column=column)


def _refuse_torque(
    table: Table, unused: Sequence[int], groups: Sequence[tuple[str, ...]], chosen: Mapping[str, Column]
) -> None:
    """Refuse an unread column with a unit of torque if a torque could be read and none is."""
    if ("torque",) not in groups or "torque" in chosen:
        return
    for i in unused:
        unit = unit_said(table.names[i])
        if unit in UNITS["torque"]:
            raise _fault(
                table,
                f"has a unit of torque, but its name is not known: if it is the torque of the weight, name it 'torque "
                f'[{unit}]\' or say --columns "torque={table.names[i]}:{unit}"; if not, --columns '
                f'"{IGNORE}={table.names[i]}"',
                column=table.names[i],
            )


def _choose(
    table: Table, groups: Sequence[tuple[str, ...]], n_wanted: int, mapping: Mapping[str, str], ignored: set[int]
) -> dict[str, Column]:
    """Choose the column of every group; the first `n_wanted` groups are required."""
    if not mapping and all(map(is_number, table.names)):
        examples = ", ".join(f"{quantity} [{_usual(quantity)}]" for quantity, *_ in groups[:n_wanted])
        raise _fault(table, f"has no column names: name them, such as {examples}; or leave lines out by --skip-rows")
    chosen = dict(_mapped(table, quantity, text) for quantity, text in mapping.items())
    if strange := [quantity for quantity in chosen if not any(quantity in group for group in groups)]:
        known = ", ".join(q for group in groups for q in group)
        raise InvalidInput(f"columns: there is no {strange[0]} to be read, only {known}")
    taken = {column.place for column in chosen.values()} | ignored
    named = [(i, name, meaning_of(name)) for i, name in enumerate(table.names) if i not in taken]
    unclear: list[tuple[str, str]] = []  # names without a unit, and their quantities
    for number, group in enumerate(groups):
        if any(quantity in chosen for quantity in group):
            continue
        found = _found(table, [(i, n, m) for i, n, m in named if m and m.quantity in group])
        if found is None:
            if number < n_wanted:
                raise _missing(table, group, [name for _, name, meaning in named if meaning is None])
        elif isinstance(found, Column):
            chosen[found.quantity] = found
        else:
            unclear.append(found)
    if unclear:
        raise _without_unit(table, unclear)
    return chosen


def _found(table: Table, named: list[tuple[int, str, Meaning]]) -> Column | tuple[str, str] | None:
    """Return the only column among these; its name and quantity if it has no unit; None if there is none."""
    known = [each for each in named if each[2].unit in UNITS[each[2].quantity]]
    bare = [each for each in named if not each[2].unit]
    several = known or bare
    if len(several) > 1:
        raise _several(table, several)
    if known:
        index, name, (quantity, unit, absolute) = known[0]
        if absolute:
            raise _fault(
                table,
                "is absolute, gauge pressure is wanted: --columns "
                f'"{quantity}={name}:{unit}(abs)" takes the standard atmosphere off, {ATMOSPHERE / BAR:g} bar',
                column=name,
            )
        return Column(index, name, quantity, unit, UNITS[quantity][unit], 0.0, False)
    if bare:
        return bare[0][1], bare[0][2].quantity
    if named:
        _, name, (quantity, unit, _) = named[0]
        sentence = f"has an unknown unit {unit!r}; known are {_units(quantity) or 'none'}"
        if quantity == "torque" and unit in _WEIGHTS:
            sentence = "is a weight, not a torque: multiply it by its lever arm, and name it torque [Nm]"
        raise _fault(table, f'{sentence}; or leave it out by --columns "{IGNORE}={name}"', column=name)
    return None


def _mapped(table: Table, word: str, text: str) -> tuple[str, Column]:
    """Return the quantity and its column by the caller, as NAME:UNIT or NAME."""
    quantity = quantity_named(word)
    if quantity is None:
        raise InvalidInput(f"columns: {word!r} is no quantity; known are {', '.join(UNITS)}")
    name, _, said = text.rpartition(":") if text not in table.names and ":" in text else (text, "", "")
    name, said = name.strip(), said.strip()
    place = _place(table, name)
    unit, absolute = unit_of(said.removeprefix("-"))
    meaning = meaning_of(table.names[place])
    if not said and meaning and meaning.quantity == quantity:
        _, unit, absolute = meaning
    elif not said:
        unit = unit_said(table.names[place])
    if unit not in UNITS[quantity]:
        raise InvalidInput(f"columns: {word}={text} needs a unit after a colon, one of {_units(quantity)}")
    scale = (-1 if said.startswith("-") else 1) * UNITS[quantity][unit]
    return quantity, Column(place, name, quantity, unit, scale, ATMOSPHERE if absolute else 0.0, bool(said))


def _place(table: Table, name: str) -> int:
    """Return the index of the column with this name, ignoring case, with or without its unit."""
    same = [i for i, other in enumerate(table.names) if other == name]
    same = same or [i for i, other in enumerate(table.names) if other.casefold() == name.casefold()]
    same = same or [i for i, other in enumerate(table.names) if _without_brackets(other) == name.casefold()]
    if not same:
        raise _fault(table, f"has no column {name!r} among {', '.join(table.names)}")
    if len(same) > 1:
        raise _fault(table, f"has {len(same)} columns of the name {name!r}")
    return same[0]


def _without_brackets(name: str) -> str:
    """Return the name `Load [gf]` in lower case without its unit: `load`."""
    return re.sub(r"\s*(\[[^]]*\]|\([^)]*\))$", "", name).casefold()


def _several(table: Table, named: list[tuple[int, str, Meaning]]) -> InvalidFile:
    (_, first, one), (_, second, other), *_ = named
    if one.quantity != other.quantity:
        return _fault(
            table,
            f"has a {one.quantity}, {first!r}, and a {other.quantity}, {second!r}: choose by --columns "
            f'"{one.quantity}={first}" or "{other.quantity}={second}"',
        )
    if first == second:
        return _fault(table, f"has two columns of the name {first!r}; rename one")
    return _fault(
        table,
        f"columns {first!r} and {second!r} give the {one.quantity} twice; choose by --columns "
        f'"{one.quantity}={first}:{one.unit or _usual(one.quantity)}"',
    )


def _missing(table: Table, group: tuple[str, ...], unknown: Sequence[str]) -> InvalidFile:
    """Return the error for a quantity without a column. It suggests the `unknown` names with a unit of the quantity."""
    quantity, names = group[0], ", ".join(name for name in table.names if name)
    fitting = [f'"{kind}={name}"' for kind in group for name in unknown if unit_said(name) in {*UNITS[kind]} - {""}]
    return _fault(
        table,
        f"has no column for the {' or '.join(group)} among {names}; name it such as {quantity} [{_usual(quantity)}], "
        f"or say --columns {' or '.join(fitting) or f'{quantity}=NAME:{_usual(quantity)}'}",
    )


def _without_unit(table: Table, unclear: list[tuple[str, str]]) -> InvalidFile:
    (name, first), names = unclear[0], ", ".join(repr(name) for name, _ in unclear)
    say = ",".join(f"{quantity}={name}:{_usual(quantity)}" for name, quantity in unclear)
    which = f"column {names} has" if len(unclear) == 1 else f"columns {names} have"
    return _fault(
        table,
        f"{which} no unit: name them such as '{name} [{_usual(first)}]', or say --columns \"{say}\" with your units",
    )


def _usual(quantity: str) -> str:
    return next(iter(UNITS[quantity]))


def _units(quantity: str) -> str:
    return ", ".join(unit for unit in UNITS[quantity] if unit)


# --- plausibility of units -------- ----------------------------------------------------------------------------------


def _check_unit(measured: Measured, kind: str) -> None:
    """Refuse a column whose greatest number is implausible in its unit, and plausible in another."""
    values = {q: v for q, v in measured.values.items() if q in (kind, f"{kind}1", f"{kind}2")}
    if not values:
        return
    if "time" in measured.values:  # fewer than four rows of a log may be a spike
        from scipy.ndimage import median_filter

        values = {q: median_filter(v, 7, mode="nearest") for q, v in values.items()}
    quantity = max(values, key=lambda q: float(np.abs(values[q]).max()))
    column, (low, high) = measured.columns[quantity], _PLAUSIBLE[kind]
    row = int(np.argmax(np.abs(values[quantity])))
    greatest = abs(float(values[quantity][row]))
    if column.certain or low <= greatest <= high:
        return
    number, unit = greatest / abs(column.scale), column.unit or "ratio"
    likely = [other for other, scale in UNITS[quantity].items() if other and low <= number * scale <= high]
    if not likely:
        return
    shown = " or ".join(_with_unit(number, other) for other in likely)
    read = _with_unit(number, unit)
    what = f"{read} is too much" if greatest > high else f"never exceeds {read}, too little"
    sentence = f'{what}; was {shown} meant? If not, say --columns "{quantity}={column.name}:{unit}"'
    raise measured.mistake(quantity, sentence, row)


def _with_unit(number: float, unit: str) -> str:
    return f"a ratio of {number:g}" if unit == "ratio" else f"{number:g} {unit}"
