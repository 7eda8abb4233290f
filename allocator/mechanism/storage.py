"""Mechanisms are saved as TOML files. What one looks like:

[mechanism]                    # SI units
pressure_limits = [0.0, 500000.0]
min_contraction = 0.025
joints = ["shoulder", "elbow"]
angle_limits = [[-1.0, 1.0], [-1.0, 1.0]]     # or without this line

[routes]
kind = "Pulleys"               # or Sites, Tables
rest_length = [0.4, …]
arms = [[0.02, 0.0], …]
initial_contraction = [0.1375, …]

[muscles]
names = ["shoulder flexor", …]
kinds = ["A", …]               # of the tables below

[kinds.A]                      # as a muscle's file
model = "Sarosi2012"
[kinds.A.parameters]
…

[gas]                          # in the muscles; or without this table
kappa = 1.3
atmosphere = 101325.0
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.joint.storage import gas_from, gas_lines, muscle_lines
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import Link, Pulleys, Routes, Sites, Tables
from allocator.muscles import Muscle, storage

_ROUTES: Mapping[str, type[Routes]] = {"Pulleys": Pulleys, "Sites": Sites, "Tables": Tables}
_TABLES = ("mechanism", "routes", "muscles", "kinds", "gas", "source")
_ENTRIES = ("pressure_limits", "min_contraction", "joints", "angle_limits")


def save_mechanism(mechanism: Mechanism, path: FilePath, *, source: Mapping[str, str | float] | None = None) -> None:
    """Write `mechanism` to `path`; `source` says where the numbers come from.

    Raises `InvalidInput` for routes or muscles that are Python functions, `CannotWrite`.
    """
    write_text(path, dumps(mechanism, source=source))


def dumps(mechanism: Mechanism, *, source: Mapping[str, str | float] | None = None) -> str:
    """Return the TOML text of `mechanism`."""
    m = mechanism
    lines = ["[mechanism]  # SI units: Pa, m, rad, N", _line("pressure_limits", m.pressure_limits)]
    lines += [_line("min_contraction", m.min_contraction), _line("joints", m.joint_names)]
    lines += [] if m.angle_limits is None else [_line("angle_limits", m.angle_limits)]
    lines += ["", *_route_lines(m.routes)]
    kinds = list(dict.fromkeys(m.muscles))
    labels = [chr(ord("A") + i) if len(kinds) <= 26 else f"kind-{i + 1}" for i in range(len(kinds))]
    lines += ["", "[muscles]", _line("names", m.muscle_names)]
    lines += [_line("kinds", tuple(labels[kinds.index(muscle)] for muscle in m.muscles))]
    for label, muscle in zip(labels, kinds, strict=True):
        lines += ["", *muscle_lines(f"kinds.{label}", muscle)]
    lines += gas_lines(m.gas)
    if source:
        lines += ["", "[source]", *(_line(name, value) for name, value in source.items())]
    return "\n".join(lines) + "\n"


def load_mechanism(path: FilePath) -> Mechanism:
    """Read a mechanism. Raises `InvalidFile` if it is none."""
    content = storage.read(path)
    tables = {name: _table(path, content, name) for name in ("mechanism", "routes", "muscles", "kinds")}
    _known(path, "a mechanism's file", content, _TABLES)
    given, named = tables["mechanism"], tables["muscles"]
    _known(path, "[mechanism]", given, _ENTRIES)
    _known(path, "[muscles]", named, ("names", "kinds"))
    any_kind: type[Any] = Muscle
    kinds = {
        name: storage.muscle_from(any_kind, f"{path} [kinds.{name}]", _table(path, tables["kinds"], name, "kinds."))
        for name in tables["kinds"]
    }
    asked = named.get("kinds", [])
    if not isinstance(asked, list) or not all(isinstance(kind, str) and kind in kinds for kind in asked):
        raise InvalidFile(path, f"[muscles]: kinds = {asked!r} have to be a row of {', '.join(kinds)}")
    limits = {name: given[name] for name in ("pressure_limits", "min_contraction", "angle_limits") if name in given}
    routes = _routes(path, dict(tables["routes"]))
    try:
        return Mechanism(
            routes,
            tuple(kinds[kind] for kind in asked),
            muscle_names=tuple(named.get("names", ())),
            joint_names=tuple(given.get("joints", ())),
            gas=gas_from(path, content),
            **limits,
        )
    except (InvalidInput, TypeError, ValueError, OverflowError) as error:
        raise InvalidFile(path, str(error)) from None


def _line(name: str, value: Any) -> str:
    return f"{storage.toml_key(name)} = {storage.toml(value)}"


def _route_lines(routes: Routes) -> list[str]:
    kind = type(routes).__name__
    if kind not in _ROUTES:
        raise InvalidInput(f"{kind} cannot be written to a file; sample the lengths into Tables")
    lines = ["[routes]", _line("kind", kind), _line("rest_length", routes.rest_length)]
    if isinstance(routes, Sites):
        paths = tuple(tuple((site.link, *site.position) for site in path) for path in routes.paths)
        lines += [_line("cable", routes.cable), _line("paths", paths)]
        for link in routes.links:
            lines += ["", "[[routes.links]]", *(_line(f.name, getattr(link, f.name)) for f in fields(link))]
        return lines
    own = [f.name for f in fields(routes) if f.init and f.name != "rest_length"]
    return lines + [_line(name, getattr(routes, name)) for name in own]


def _routes(path: FilePath, table: dict[str, Any]) -> Routes:
    kind = table.pop("kind", None)
    if kind not in _ROUTES:
        raise InvalidFile(path, f"[routes] has the unknown kind {kind!r}; known: {', '.join(_ROUTES)}")
    try:
        if kind == "Sites":
            table["links"] = [Link(**link) for link in table.get("links", ())]
            table["paths"] = [[(site[0], site[1:]) for site in line] for line in table.get("paths", ())]
        return _ROUTES[kind](**table)
    except (InvalidInput, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InvalidFile(path, f"[routes] does not describe {kind} ({error})") from None


def _table(path: FilePath, content: dict[str, Any], name: str, above: str = "") -> dict[str, Any]:
    table = content.get(name)
    if not isinstance(table, dict):
        raise InvalidFile(path, f"is not a mechanism: the table [{above}{name}] is missing")
    return table


def _known(path: FilePath, what: str, table: dict[str, Any], names: tuple[str, ...]) -> None:
    if surplus := table.keys() - set(names):
        raise InvalidFile(path, f"{what} has no {', '.join(sorted(surplus))}; it has {', '.join(names)}")
