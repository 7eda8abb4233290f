"""Muscles are kept as small TOML files. What one looks like:

model = "Hogan1984"

[parameters]            # SI units: Pa, m, rad, N
F_max = 1500.0
…

[volume]                # of the gas, as far as it is known, see `allocator.muscles.volume`
inner_radius = 0.01     # [m], for laws that have no radius
rest_volume = 1.257e-4  # [m³] at rest length
tube_volume = 2e-5      # [m³] between muscle and valve

[measured]              # corners of the convex hull of the samples of its fit, see `allocator.muscles.measured`
contraction = [0.0, …]  # [-]
pressure = [35000.0, …] # [Pa]

[source]                # where the numbers come from, for the reader; ignored when loading

[covariance]            # of a fitted muscle
rows = [[…], …]
"""

import json
import tomllib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.muscles.base import Muscle
from allocator.muscles.measured import MeasuredRegion
from allocator.units import BAR

M = TypeVar("M", bound=Muscle)


def save(muscle: Muscle, path: str | PathLike[str], source: Mapping[str, str | float]) -> None:
    """Write `muscle` to `path`."""
    write_text(path, dumps(muscle, source))


def dumps(muscle: Muscle, source: Mapping[str, str | float]) -> str:
    """Return the TOML text of `muscle`."""
    fields = type(muscle).number_fields()
    if not fields:
        raise InvalidInput(
            f"a {type(muscle).__name__} is made of Python functions and cannot be written to a file; "
            "sample them into a TableMuscle"
        )
    lines = [f"model = {toml(type(muscle).__name__)}", "", "[parameters]  # SI units: Pa, m, rad, N"]
    lines += [f"{name} = {toml(getattr(muscle, name))}" for name in fields]
    if volume := {name: getattr(muscle, name) for name in _VOLUME if getattr(muscle, name)}:
        lines += ["", "[volume]  # of the gas: m, m³", *(f"{name} = {toml(value)}" for name, value in volume.items())]
    if (region := muscle.measured) is not None:
        lines += ["", "[measured]  # convex hull of the samples: ratio, Pa"]
        lines += [f"contraction = {toml(region.contraction)}", f"pressure = {toml(region.pressure)}"]
    if source:
        lines += ["", "[source]", *(f"{toml_key(name)} = {toml(value)}" for name, value in source.items())]
    if muscle.covariance is not None:
        lines += ["", f"[covariance]  # of {', '.join(muscle.parameters)}", "rows = ["]
        lines += [*(f"    {toml(row)}," for row in muscle.covariance), "]"]
    return "\n".join(lines) + "\n"


def load(cls: type[M], path: str | PathLike[str]) -> M:
    """Read the muscle in `path`, which has to be a `cls`."""
    return muscle_from(cls, path, read(path))


def muscle_from(cls: type[M], path: str | PathLike[str], content: dict[str, Any]) -> M:
    """Return the muscle in the parsed `content`; `path` is for the messages."""
    model = _model(cls, path, content)
    given = content.get("parameters")
    if not isinstance(given, dict):
        raise InvalidFile(path, "has no table [parameters]")
    _compare(path, model, given)
    if surplus := content.keys() - _ENTRIES:
        raise InvalidFile(path, f"a muscle has no {', '.join(sorted(surplus))}; it has {', '.join(_ENTRIES)}")
    rows, volume, region = covariance_rows(path, content), _volume(path, content), _measured(path, content)
    try:
        muscle = model(**given, **volume, covariance=rows, measured=region)
    except (InvalidInput, TypeError, ValueError) as error:
        raise InvalidFile(path, str(error)) from None
    _try(path, muscle)
    return muscle


def read(path: str | PathLike[str]) -> dict[str, Any]:
    """Read the tables of a TOML file."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")  # some editors begin a file with a mark
    except FileNotFoundError:
        raise InvalidFile(path, "does not exist") from None
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InvalidFile(path, "is not TOML: it is no text in UTF-8; save it so") from None
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also of a whole number with thousands of digits
        raise InvalidFile(path, f"is not TOML: {error}") from None
    except RecursionError:
        raise InvalidFile(path, "is not TOML that can be read: its brackets are nested too deeply") from None


def covariance_rows(path: str | PathLike[str], content: dict[str, Any]) -> Any:
    """Return the entry `rows` of the table [covariance]; None if there is no such table."""
    if "covariance" not in content:
        return None
    table = content["covariance"]
    if not isinstance(table, dict) or table.keys() != {"rows"}:
        raise InvalidFile(path, "[covariance] has to be a table with the entry rows = [[…], …] and no other")
    return table["rows"]


def _volume(path: str | PathLike[str], content: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of the table [volume], none if there is no such table."""
    table = content.get("volume", {})
    if not isinstance(table, dict) or table.keys() - set(_VOLUME):
        raise InvalidFile(path, f"[volume] has to be a table of {', '.join(_VOLUME)}")
    return table


def _measured(path: str | PathLike[str], content: dict[str, Any]) -> MeasuredRegion | None:
    """Return the region of the table [measured], None if there is no such table."""
    table = content.get("measured")
    if table is None:
        return None
    if not isinstance(table, dict) or table.keys() != set(_MEASURED):
        raise InvalidFile(path, f"[measured] has to be a table of the rows {' and '.join(_MEASURED)}")
    try:
        return MeasuredRegion(**table)
    except (InvalidInput, TypeError, ValueError) as error:
        raise InvalidFile(path, f"[measured]: {error}") from None


def _try(path: str | PathLike[str], muscle: Muscle) -> None:
    """Refuse parameters with which the law divides by zero, exceeds what any muscle pulls, or pushes."""
    try:
        with np.errstate(all="ignore"):
            force = float(muscle.force(*_USUAL))
        wrong = "" if 0 < force <= _MOST else f"is {force:g} N at 5 bar and rest length"
    except ArithmeticError as error:
        wrong = f"cannot be computed ({error})"
    if wrong:
        given = ", ".join(f"{name} = {value:g}" for name, value in muscle.parameters.items())
        raise InvalidFile(path, f"the force of this {type(muscle).__name__} {wrong}; check {given}")


_ENTRIES = ("model", "parameters", "source", "covariance", "volume", "measured")  # of a file
_VOLUME = ("inner_radius", "rest_volume", "tube_volume")
_MEASURED = ("contraction", "pressure")
_USUAL = 5 * BAR, 0.0  # pressure [Pa] and contraction ratio [-] at which every muscle pulls
_MOST = 1e7  # [N] far above any muscle


def _model(cls: type[M], path: str | PathLike[str], content: dict[str, Any]) -> type[M]:
    from allocator.muscles.models import MODELS

    name = content.get("model")
    if name is None:
        raise InvalidFile(path, 'is not a muscle: the line model = "…" is missing')
    known: dict[str, type[Muscle]] = {**MODELS, cls.__name__: cls}
    if not isinstance(name, str) or name not in known or name == Muscle.__name__:
        raise InvalidFile(path, f"unknown model {name!r}; known: {', '.join(MODELS)}")
    model = known[name]
    if not issubclass(model, cls):
        raise InvalidFile(path, f"holds a {name}, not a {cls.__name__}")
    return model


def _compare(path: str | PathLike[str], model: type[Muscle], given: dict[str, Any]) -> None:
    """Refuse missing and surplus parameters."""
    wanted = model.number_fields()
    if missing := [name for name in wanted if name not in given]:
        raise InvalidFile(path, f"{model.__name__} needs the parameter {', '.join(missing)}, which is missing")
    if surplus := [name for name in given if name not in wanted]:
        raise InvalidFile(path, f"{model.__name__} has no parameter {', '.join(surplus)}; it has {', '.join(wanted)}")


def toml(value: object) -> str:
    """Return a value in TOML."""
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float | np.number):
        return repr(float(value)) if isinstance(value, float | np.floating) else str(int(value))
    raise InvalidInput(f"source: {value!r} is neither text nor a number")


def toml_key(name: str) -> str:
    """Return the name of an entry in TOML, in quotation marks where it needs them."""
    return name if name.replace("_", "").isalnum() and name.isascii() else _text(name)


def _text(value: str) -> str:
    """Return a string in TOML: as in JSON, but U+007F has to be escaped as well."""
    if any("\ud800" <= character <= "\udfff" for character in value):
        raise InvalidInput(f"the text {value!r} has half a character (a lone surrogate), which no UTF-8 file can hold")
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
