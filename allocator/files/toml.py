"""TOML files: tables that report faults by file, table and entry, and the text of written values."""

import json
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.text import FilePath

T = TypeVar("T")


@dataclass(frozen=True)
class Table:
    """A table of a TOML file, or the whole file, whose `name` is empty."""

    path: FilePath
    entries: Mapping[str, Any]
    name: str = ""

    @classmethod
    def read(cls, path: FilePath) -> Self:
        """Read a file. Raises `InvalidFile`."""
        try:
            text = Path(path).read_text(encoding="utf-8-sig")  # some editors write a byte order mark
        except FileNotFoundError:
            raise InvalidFile(path, "does not exist") from None
        except OSError as error:
            raise InvalidFile(path, f"cannot be read ({error.strerror})") from None
        except UnicodeDecodeError:
            raise InvalidFile(path, "is not TOML: it is no text in UTF-8; save it so") from None
        return cls.parsed(path, text)

    @classmethod
    def parsed(cls, path: FilePath, text: str) -> Self:
        """Return the file with the content `text`; `path` is used in messages. Raises `InvalidFile`."""
        try:
            return cls(path, tomllib.loads(text))
        except ValueError as error:  # also raised by an integer with thousands of digits
            raise InvalidFile(path, f"is not TOML: {error}") from None
        except RecursionError:
            raise InvalidFile(path, "cannot be read as TOML: its brackets are nested too deeply") from None

    def fault(self, what: object) -> InvalidFile:
        """Return the error for the fault `what` in this table."""
        return InvalidFile(self.path, f"[{self.name}]: {what}" if self.name else str(what))

    def table(self, name: str) -> "Table | None":
        """Return the table called `name`; None if there is none. Raises `InvalidFile` for anything else."""
        given, inside = self.entries.get(name), self._inside(name)
        if given is not None and not isinstance(given, dict):
            raise InvalidFile(self.path, f"[{inside}] has to be a table")
        return None if given is None else Table(self.path, given, inside)

    def needed(self, name: str, what: str) -> "Table":
        """Return the required table called `name`; `what` names the kind of file. Raises `InvalidFile`."""
        found = self.table(name)
        if found is None:
            raise InvalidFile(self.path, f"is not {what}: the table [{self._inside(name)}] is missing")
        return found

    def each(self, name: str) -> list["Table"]:
        """Return the tables [[name]]. Raises `InvalidFile`."""
        given = self.entries.get(name, [])
        if not isinstance(given, list) or not all(isinstance(entries, dict) for entries in given):
            raise InvalidFile(self.path, f"[[{self._inside(name)}]] has to be tables with this line above each")
        return [Table(self.path, entries, self._inside(f"{name} {i + 1}")) for i, entries in enumerate(given)]

    def only(self, names: Iterable[str], whose: str = "") -> None:
        """Raise `InvalidFile` unless all entries are among `names`."""
        if surplus := self.entries.keys() - set(known := list(names)):
            who = ": ".join(filter(None, (f"[{self.name}]" if self.name else "", whose))) or "it"
            raise InvalidFile(self.path, f"{who} has no {', '.join(sorted(surplus))}; it has {', '.join(known)}")

    def made(self, kind: Callable[..., T], whose: str = "", **more: Any) -> T:
        """Return the object that `kind` makes of the entries and of `more`. Raises `InvalidFile`."""
        arguments = {name: p for name, p in signature(kind).parameters.items() if name not in more}
        self.only(arguments, whose)
        if missing := [n for n, p in arguments.items() if p.default is Parameter.empty and n not in self.entries]:
            raise self.fault(f"{whose or 'it'} needs {', '.join(missing)}")
        try:
            return kind(**self.entries, **more)
        except (InvalidInput, TypeError, ValueError, OverflowError) as error:
            raise self.fault(error) from None

    def _inside(self, name: str) -> str:
        return f"{self.name}.{name}" if self.name else name


def section(name: str, values: Mapping[str, object], note: str = "") -> list[str]:
    """Return the lines of the table called `name`, or "[name]" for an array of tables; `note` gives the units."""
    return ["", f"[{name}]  # {note}" if note else f"[{name}]", *entries(values)]


def entries(values: Mapping[str, object]) -> list[str]:
    """Return the lines of entries, with one line per row of a matrix."""
    lines = []
    for name, value in values.items():
        plain = tuple(value.tolist()) if isinstance(value, np.ndarray) else value
        if isinstance(plain, tuple) and plain and all(isinstance(row, tuple | list) for row in plain):
            lines += [f"{key(name)} = [", *(f"    {written(tuple(row))}," for row in plain), "]"]
        else:
            lines.append(f"{key(name)} = {written(plain)}")
    return lines


def written(value: object) -> str:
    """Return a value in TOML."""
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float | np.number):
        return repr(float(value)) if isinstance(value, float | np.floating) else str(int(value))
    raise InvalidInput(f"source: {value!r} is neither text nor a number")


def key(name: str) -> str:
    """Return the name of an entry in TOML, quoted if necessary."""
    return name if name.replace("_", "").isalnum() and name.isascii() else _text(name)


def _text(value: str) -> str:
    """Return a string in TOML: as in JSON, but U+007F has to be escaped as well."""
    if any("\ud800" <= character <= "\udfff" for character in value):
        raise InvalidInput(f"the text {value!r} has half a character (a lone surrogate), which no UTF-8 file can hold")
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
