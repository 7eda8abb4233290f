"""TOML files of muscles. An example:

model = "Hogan1984"

[parameters]            # SI units: Pa, m, rad, N
F_max = 1500.0
…

[volume]                # of the gas, as far as it is known, see `allocator.muscles.volume`
inner_radius = 0.01     # [m], for laws that have no radius
rest_volume = 1.257e-4  # [m³] at rest length
tube_volume = 2e-5      # [m³] between muscle and valve

[cable]                 # by which the muscle pulls, see `allocator.muscles.cabled`; or without this table
cable_stiffness = 4e4   # [N/m]
rest_length = 0.4       # of the muscle [m]

[measured]              # corners of the convex hull of the samples of its fit, see `allocator.muscles.measured`
contraction = [0.0, …]  # [-]
pressure = [35000.0, …] # [Pa]

[source]                # where the numbers come from, for the reader; ignored when loading

[covariance]            # of a fitted muscle
rows = [[…], …]
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any, TypeVar

import numpy as np

from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.files.toml import Table, section, written
from allocator.muscles.base import Muscle
from allocator.muscles.cabled import Cabled
from allocator.muscles.measured import MeasuredRegion
from allocator.units import BAR

M = TypeVar("M", bound=Muscle)


def save(muscle: Muscle, path: str | PathLike[str], source: Mapping[str, str | float]) -> None:
    """Write `muscle` to `path`."""
    lines = muscle_lines(muscle)
    if source:
        lines += section("source", source)
    write_text(path, "\n".join(lines) + "\n")


def muscle_lines(muscle: Muscle, above: str = "") -> list[str]:
    """Return the lines of `muscle`; its tables lie in the one called `above`."""
    if isinstance(muscle, Cabled):
        return _cabled_lines(muscle, above)
    fields, inside = type(muscle).number_fields(), f"{above}." if above else ""
    if not fields:
        raise InvalidInput(
            f"a {type(muscle).__name__} is made of Python functions and cannot be written to a file; "
            "sample them into a TableMuscle"
        )
    numbers = {name: getattr(muscle, name) for name in fields}
    lines = [f"model = {written(type(muscle).__name__)}"]
    lines += section(f"{inside}parameters", numbers, "SI units: Pa, m, rad, N")
    if volume := {name: getattr(muscle, name) for name in _VOLUME if getattr(muscle, name)}:
        lines += section(f"{inside}volume", volume, "of the gas: m, m³")
    if (region := muscle.measured) is not None:
        corners = {name: getattr(region, name) for name in _MEASURED}
        lines += section(f"{inside}measured", corners, "convex hull of the samples: ratio, Pa")
    if muscle.covariance is not None:
        note = f"of {', '.join(muscle.parameters)}"
        lines += section(f"{inside}covariance", {"rows": muscle.covariance}, note)
    return lines


def _cabled_lines(cabled: Cabled, above: str) -> list[str]:
    own = {name: getattr(cabled, name) for name in ("covariance", *_VOLUME)}
    cable = {name: getattr(cabled, name) for name in _CABLE}
    lines = muscle_lines(replace(cabled.muscle, **own), above)
    return lines + section(f"{above}.cable" if above else "cable", cable, "N/m, m")


def load(cls: type[M], path: str | PathLike[str]) -> M:
    """Read the muscle in `path`, which has to be a `cls`."""
    return muscle_from(cls, Table.read(path))


def muscle_from(cls: type[M], table: Table, *further: str) -> M:
    """Return the muscle in `table`, which may have `further` entries."""
    model, parameters = _model(cls, table), table.table("parameters")
    if parameters is None:
        raise table.fault("has no table [parameters]")
    _compare(table, model, parameters.entries)
    table.only((*_ENTRIES, *further), "a muscle")
    volume, measured, cable = table.table("volume"), table.table("measured"), table.table("cable")
    if volume is not None:
        volume.only(_VOLUME)
    given = {**parameters.entries, **({} if volume is None else volume.entries)}
    region = None if measured is None else measured.made(MeasuredRegion)
    try:
        muscle = model(**given, covariance=covariance_rows(table), measured=region)
    except (InvalidInput, TypeError, ValueError) as error:
        raise table.fault(error) from None
    _try(table, muscle)
    if cable is None:
        return muscle
    if not issubclass(Cabled, cls):
        raise table.fault(f"holds a {model.__name__} with a cable, not a {cls.__name__}")
    cable.only(_CABLE, "a cable")
    return cable.made(partial(Cabled, muscle), "a cable")  # type: ignore[return-value]  # a subclass of M, see above


def covariance_rows(table: Table) -> Any:
    """Return the entry `rows` of the table [covariance]; None if there is no such table."""
    found = table.table("covariance")
    return None if found is None else found.made(_rows)


def _rows(rows: object) -> object:
    return rows


def _try(table: Table, muscle: Muscle) -> None:
    """Refuse parameters for which the law divides by zero, exceeds any muscle's force, only pushes, or is in percent.

    It may push at rest length, where the muscles of a joint were never measured.
    """
    P, contractions = _USUAL
    if 1 < (most := muscle.max_contraction) < np.inf:
        raise table.fault(
            f"this {type(muscle).__name__} contracts up to the ratio {most:g}; if percent was meant, divide by 100"
        )
    try:
        with np.errstate(all="ignore"):
            forces = [float(muscle.force(P, eps)) for eps in contractions]
        pulls = np.isfinite(forces).all() and 0 < max(forces) <= _MOST
        wrong = "" if pulls else f"is {forces[0]:g} N at 5 bar and rest length"
    except ArithmeticError as error:
        wrong = f"cannot be computed ({error})"
    if wrong:
        given = ", ".join(f"{name} = {value:g}" for name, value in muscle.parameters.items())
        raise table.fault(f"the force of this {type(muscle).__name__} {wrong}; check {given}")


_ENTRIES = ("model", "parameters", "source", "covariance", "volume", "measured", "cable")  # of a file
_VOLUME = ("inner_radius", "rest_volume", "tube_volume")
_MEASURED = ("contraction", "pressure")
_CABLE = ("cable_stiffness", "rest_length")
_USUAL = 5 * BAR, (0.0, 0.05, 0.1)  # pressure [Pa], and contraction ratios [-] at one of which every muscle pulls
_MOST = 1e7  # [N] far above any muscle


def _model(cls: type[M], table: Table) -> type[M]:
    from allocator.muscles.models import MODELS

    name = table.entries.get("model")
    if name is None:
        raise table.fault('is not a muscle: the line model = "…" is missing')
    known: dict[str, type[Muscle]] = {**MODELS, cls.__name__: cls}
    if not isinstance(name, str) or name not in known or name == Muscle.__name__:
        raise table.fault(f"unknown model {name!r}; known: {', '.join(MODELS)}")
    model = known[name]
    if not issubclass(model, cls):
        raise table.fault(f"holds a {name}, not a {cls.__name__}")
    return model


def _compare(table: Table, model: type[Muscle], given: Mapping[str, object]) -> None:
    """Refuse missing and surplus parameters."""
    wanted = model.number_fields()
    if missing := [name for name in wanted if name not in given]:
        those = "parameter {}, which is" if len(missing) == 1 else "parameters {}, which are"
        raise table.fault(f"{model.__name__} needs the {those.format(', '.join(missing))} missing")
    if surplus := [name for name in given if name not in wanted]:
        raise table.fault(f"{model.__name__} has no parameter {', '.join(surplus)}; it has {', '.join(wanted)}")
