"""Joints are saved as TOML files, which every command takes by --joint. What one looks like:

[joint]                        # SI units
pressure_limits = [0.0, 500000.0]
min_contraction = 0.025
angle_limits = [-0.8, 0.8]     # or without this line
friction = 0.13
scale_known = true             # false: fitted without a weight, no torque and no stiffness
unseen = ["a force common to both muscles"]  # by the data of its fit; or without this line

[geometry]
kind = "Lever"
rest_length = 0.25
…

[agonist]                      # as in a muscle's file; so is [antagonist]
model = "Sarosi2012"
[agonist.parameters]
…
[agonist.measured]             # if it was fitted to forces
…

[gas]                          # in the muscles; or without this table
kappa = 1.3
atmosphere = 101325.0          # [Pa]

[source]                       # where the numbers come from, for the reader; ignored when loading

[covariance]                   # of the parameters of agonist and antagonist together
rows = [[…], …]

[hysteresis]                   # `PrandtlIshlinskii` of the angle, or without this table
weights = [0.6, 0.2, 0.2]      # w_0, …, w_n [-]
thresholds = [0.02, 0.06]      # r_1, …, r_n [rad]
base = 0.2                     # share of the widths that is left without pressure [-]

[plant]                        # what `mpc.Plant` adds; ignored here
…
[regulators]                   # what the pressures do besides the lag of [plant]; ignored here
dead_time = 0.12               # [s]
dead_band = 0.0                # [Pa], total
lag_up = 0.17                  # [s] while a pressure rises, and
lag_down = 0.28                # [s] while it falls
"""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import AIR, Gas
from allocator.joint.geometry import Geometry, Lever, Pulley, Table
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.muscles import Muscle, storage

_GEOMETRIES: Mapping[str, type[Geometry]] = {"Pulley": Pulley, "Lever": Lever, "Table": Table}
_TABLES = (
    *("joint", "geometry", "agonist", "antagonist", "source", "covariance"),
    *("hysteresis", "plant", "regulators", "gas"),
)


def save_joint(
    joint: AntagonistJoint,
    path: FilePath,
    *,
    scale_known: bool = True,
    source: Mapping[str, str | float] | None = None,
) -> None:
    """Write `joint` to `path`; `source` says where the numbers come from."""
    write_text(path, dumps(joint, scale_known=scale_known, source=source))


def dumps(joint: AntagonistJoint, *, scale_known: bool = True, source: Mapping[str, str | float] | None = None) -> str:
    """Return the TOML text of `joint`."""
    lines = ["[joint]  # SI units: Pa, m, rad, N", f"pressure_limits = {_toml(joint.pressure_limits)}"]
    lines.append(f"min_contraction = {_toml(joint.min_contraction)}")
    if joint.angle_limits is not None:
        lines.append(f"angle_limits = {_toml(joint.angle_limits)}")
    lines += [f"friction = {_toml(joint.friction)}", f"scale_known = {'true' if scale_known else 'false'}"]
    if joint.unseen:
        lines.append(f"unseen = {_toml(joint.unseen)}")
    lines += ["", *_geometry_lines(joint.geometry)]
    for name, muscle in (("agonist", joint.agonist), ("antagonist", joint.antagonist)):
        lines += ["", *muscle_lines(name, muscle)]
    lines += gas_lines(joint.gas)
    if source:
        lines += ["", "[source]", *(f"{storage.toml_key(name)} = {_toml(value)}" for name, value in source.items())]
    if joint.covariance is not None:
        rows = (f"    {_toml(row)}," for row in joint.covariance)
        lines += ["", "[covariance]  # of the agonist's and then the antagonist's parameters", "rows = [", *rows, "]"]
    if joint.hysteresis is not None:
        lines += ["", "[hysteresis]  # Prandtl–Ishlinskii operator of the angle; rad, at P1 + P2 = 5 bar"]
        lines += [f"{f.name} = {_toml(getattr(joint.hysteresis, f.name))}" for f in fields(joint.hysteresis)]
    return "\n".join(lines) + "\n"


def load_joint(path: FilePath, *, scale_needed: bool = True) -> AntagonistJoint:
    """Read a joint. Raises `InvalidFile` if it is none, or has no force scale although that is needed."""
    return joint_from(path, storage.read(path), scale_needed=scale_needed)


def joint_from(path: FilePath, content: dict[str, Any], *, scale_needed: bool = True) -> AntagonistJoint:
    """Return the joint in the parsed `content`; `path` is for the messages."""
    joint = _table(path, content, "joint")
    if surplus := content.keys() - _TABLES:
        what = f"is not a joint: it has no {', '.join(sorted(surplus))}; its tables are {', '.join(_TABLES)}"
        raise InvalidFile(path, what)
    if scale_needed and not scale_known_in(content):
        raise InvalidFile(
            path,
            "holds a joint whose force scale is unknown, since it was fitted without a weight: it has no stiffness to "
            "command; fit again with a torque column, or complete the fit by with_scale",
        )
    known = {"pressure_limits", "min_contraction", "angle_limits", "friction", "unseen"}
    if surplus := joint.keys() - known - {"scale_known"}:
        raise InvalidFile(path, f"[joint] has no {', '.join(sorted(surplus))}; it has {', '.join(sorted(known))}")
    limits: dict[str, Any] = {
        name: tuple(v) if isinstance(v, list) else v for name, v in joint.items() if name in known
    }
    agonist, antagonist = (_muscle(path, content, name) for name in ("agonist", "antagonist"))
    rows = storage.covariance_rows(path, content)
    geometry, hysteresis, gas = _geometry(path, content), _hysteresis(path, content), gas_from(path, content)
    try:
        more: dict[str, Any] = {"covariance": rows, "hysteresis": hysteresis, "gas": gas}
        return AntagonistJoint(geometry, agonist, antagonist, **more, **limits)
    except (InvalidInput, TypeError, ValueError, OverflowError) as error:
        raise InvalidFile(path, str(error)) from None


def scale_known_in(content: dict[str, Any]) -> bool:
    """Return whether the joint in the parsed `content` was fitted with a weight, so that its forces are right."""
    table = content.get("joint")
    return isinstance(table, dict) and table.get("scale_known") is True


def _geometry_lines(geometry: Geometry) -> list[str]:
    kind = type(geometry).__name__
    if kind not in _GEOMETRIES:
        raise InvalidInput(f"a {kind} cannot be written to a file; sample it into a Table")
    values = {f.name: getattr(geometry, f.name) for f in fields(geometry) if f.init}
    return ["[geometry]", f'kind = "{kind}"', *(f"{name} = {_toml(value)}" for name, value in values.items())]


def muscle_lines(name: str, muscle: Muscle) -> list[str]:
    """Return the text of a muscle's file without its covariance, its tables moved below `name`."""
    text = storage.dumps(muscle, {}).partition("\n[covariance]")[0].rstrip("\n")
    for table in ("parameters", "volume", "measured"):
        text = text.replace(f"[{table}]", f"[{name}.{table}]")
    return [f"[{name}]", *text.splitlines()]


def _toml(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return storage.toml(tuple(value.tolist()))
    return storage.toml(value)


def _table(path: FilePath, content: dict[str, Any], name: str) -> dict[str, Any]:
    table = content.get(name)
    if not isinstance(table, dict):
        raise InvalidFile(path, f"is not a joint: the table [{name}] is missing")
    return table


def _geometry(path: FilePath, content: dict[str, Any]) -> Geometry:
    table = dict(_table(path, content, "geometry"))
    kind = table.pop("kind", None)
    if kind not in _GEOMETRIES:
        raise InvalidFile(path, f"[geometry] has the unknown kind {kind!r}; known: {', '.join(_GEOMETRIES)}")
    numbers = [f for f in fields(_GEOMETRIES[kind]) if f.init]
    names = [f.name for f in numbers]
    if surplus := table.keys() - set(names):
        raise InvalidFile(path, f"[geometry]: a {kind} has no {', '.join(sorted(surplus))}; it has {', '.join(names)}")
    if missing := [f.name for f in numbers if f.default is MISSING and f.name not in table]:
        raise InvalidFile(path, f"[geometry]: a {kind} needs {', '.join(missing)}")
    try:
        return _GEOMETRIES[kind](**table)
    except (InvalidInput, TypeError, ValueError, OverflowError) as error:
        raise InvalidFile(path, f"[geometry] does not describe a {kind} ({error})") from None


def _hysteresis(path: FilePath, content: dict[str, Any]) -> PrandtlIshlinskii | None:
    if "hysteresis" not in content:
        return None
    table, names = _table(path, content, "hysteresis"), [f.name for f in fields(PrandtlIshlinskii)]
    if surplus := table.keys() - set(names):
        raise InvalidFile(path, f"[hysteresis] has no {', '.join(sorted(surplus))}; it has {', '.join(names)}")
    try:
        return PrandtlIshlinskii(**table)
    except (InvalidInput, TypeError, OverflowError) as error:
        raise InvalidFile(path, f"[hysteresis]: {error}") from None


def gas_lines(gas: Gas) -> list[str]:
    """Return the lines of the table [gas]; none for the usual one."""
    if gas == AIR:
        return []
    return ["", "[gas]", f"kappa = {_toml(gas.kappa)}", f"atmosphere = {_toml(gas.atmosphere)}  # [Pa]"]


def gas_from(path: FilePath, content: dict[str, Any]) -> Gas:
    """Read the table [gas], if there is one. Raises `InvalidFile`."""
    table = content.get("gas", {})
    names = [f.name for f in fields(Gas)]
    if not isinstance(table, dict) or table.keys() - set(names):
        raise InvalidFile(path, f"[gas] has to be a table of {', '.join(names)}")
    try:
        return Gas(**table)
    except InvalidInput as error:
        raise InvalidFile(path, f"[gas]: {error}") from None


def _muscle(path: FilePath, content: dict[str, Any], name: str) -> Muscle:
    any_kind: type[Any] = Muscle
    muscle: Muscle = storage.muscle_from(any_kind, f"{path} [{name}]", _table(path, content, name))
    return muscle
