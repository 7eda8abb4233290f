"""TOML files of machines, a joint or an arm alike, which commands take by --machine. An example:

[machine]                      # SI units
pressure_limits = [0.0, 500000.0]
min_contraction = 0.025
joints = ["shoulder", "elbow"] # their names; or without this line
angle_limits = [               # one row a joint; or without these lines
    [-1.0, 1.0],
    [-1.0, 1.0],
]

[routes]                       # how the angles move the muscles
kind = "Pulleys"               # or Sites, Tables; of one joint with two muscles Pulley, Lever, Table
rest_length = [0.4, …]         # and further keys of this kind
…

[[muscle]]                     # in the order of the routes
name = "shoulder flexor"
model = "Sarosi2012"           # as in a muscle's file, with its tables below [muscle]
[muscle.parameters]
…
[[muscle]]
name = "shoulder extensor"
like = "shoulder flexor"       # a law that stands above
…

[gas]                          # in the muscles; or without this table
kappa = 1.3
atmosphere = 101325.0          # [Pa]
corner = 0.04                  # [Hz] below which slow motions are isothermal; or without this line

[source]                       # where the numbers come from, for the reader; not read by `load`
encoder_zero_deg = 0.3         # reading at 0 of the joint; loops on a device and fits subtract it
encoder_zero_std_deg = 0.0     # of its fit; 0: it was given, and fits hold it

[plant], [bodies], [regulators]  # motion, see `mpc.model.storage` and `allocator.mechanism.bodies`; not read by `load`
[intervals], [tuning]            # see `mpc.identification.plant` and `mpc.trials.tuned`; not read by `load`
[[measured]]                     # history of its strengths, see `mpc.bench.measuring.update`; not read by `load`

One joint with two muscles, an `AntagonistJoint`, calls them "agonist" and "antagonist" and may have more:

[machine]
friction = 0.13
scale_known = true             # false: fitted without a weight, no torque and no stiffness; true by default
unseen = ["a force common to both muscles"]  # by the data of its fit; or without this line

[covariance]                   # of the parameters of agonist and antagonist together
rows = [[…], …]

[hysteresis]                   # `PrandtlIshlinskii` of the angle
weights = [0.6, 0.2, 0.2]      # w_0, …, w_n [-]
thresholds = [0.02, 0.06]      # r_1, …, r_n [rad]
base = 0.2                     # share of the widths that is left without pressure [-]
stiffness = 5.0                # of the weights, if springs keep theirs [N·m/rad]; or without this line
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from inspect import signature
from math import pi
from typing import Any, TypeAlias

import numpy as np

from allocator import checks, rough_tables
from allocator.errors import InvalidInput, MissingBackend, notice_once
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import Table, entries, section
from allocator.joint import geometry
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import AIR, Gas
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.mechanism.machines import MACHINES
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import FILED, Link, Sites
from allocator.muscles import Muscle
from allocator.muscles.storage import covariance_rows, muscle_from, muscle_lines
from allocator.units import DEG

Machine: TypeAlias = AntagonistJoint | Mechanism

_GEOMETRIES: Mapping[str, type[geometry.Geometry]] = {
    kind.__name__: kind for kind in (geometry.Pulley, geometry.Lever, geometry.Table)
}
_PAIR = ("agonist", "antagonist")
_TABLES = ("machine", "routes", "muscle", "gas", "source", "plant", "regulators", "sensors", "intervals", "tuning")
_OF_A_JOINT = "covariance", "hysteresis", "measured"
_OF_MORE = "bodies", "friction"
FRICTION = "mu", "coulomb", "presliding"  # of the table [friction]: [-], [N·m], [rad]
_LIMITS = ("pressure_limits", "min_contraction", "angle_limits")
_UNITS = "SI units: Pa, m, rad, N"


def named_machine(name: str) -> Machine:
    """Return the ready-made machine of this name, or that in the TOML file of this name.

    Raises `MissingBackend` for an unknown name, `InvalidInput` for a MuJoCo model, and as `load_machine`.
    """
    if name in MACHINES:
        return MACHINES[name]()
    if name.endswith(".xml"):
        raise InvalidInput(f"{name} is a MuJoCo model: Mechanism.from_mjcf reads it with its muscles")
    if not name.endswith(".toml"):
        raise MissingBackend("machine", name, [*MACHINES, "a file ending in .toml or .xml"])
    return load_machine(name)


# --- writing --------------------------------------------------------------------------------------------------------


def save_machine(
    machine: Machine, path: FilePath, *, scale_known: bool = True, source: Mapping[str, str | float] | None = None
) -> None:
    """Write a joint or a mechanism to `path`; `source` says where the numbers come from.

    Raises `InvalidInput` for routes or muscles that are Python functions, `CannotWrite`.
    """
    write_text(path, dumps(machine, scale_known=scale_known, source=source))


def dumps(machine: Machine, *, scale_known: bool = True, source: Mapping[str, str | float] | None = None) -> str:
    """Return the TOML text of a joint or a mechanism. Raises `InvalidInput` for anything else."""
    checks.instance("machine", machine, AntagonistJoint | Mechanism, "an AntagonistJoint or a Mechanism")
    joint = machine if isinstance(machine, AntagonistJoint) else None
    own = _of_a_joint(joint, scale_known) if joint else {}
    lines = section("machine", _limits(machine) | own, _UNITS)[1:]
    lines += _route_lines(machine)
    lines += _muscle_lines(dict(_named_muscles(machine)))
    if machine.gas != AIR:
        lines += section("gas", _given(machine.gas), "-, Pa, Hz")
    lines += section("source", source) if source else []
    lines += _covariance_lines(joint) if joint else []
    if joint and (operator := joint.hysteresis) is not None:
        note = "Prandtl–Ishlinskii operator of the angle; rad, at P1 + P2 = 5 bar; N·m/rad"
        lines += section("hysteresis", _given(operator), note)
    return "\n".join(lines) + "\n"


def _given(value: "Gas | PrandtlIshlinskii") -> dict[str, object]:
    """Return the fields by name, without those that are None."""
    return {f.name: v for f in fields(value) if (v := getattr(value, f.name)) is not None}


def muscle_text(joint: AntagonistJoint) -> str:
    """Return the tables of a joint's muscles and of their covariance alone."""
    lines = _muscle_lines(dict(_named_muscles(joint))) + _covariance_lines(joint)
    return "\n".join(lines).lstrip("\n") + "\n\n"


def _covariance_lines(joint: AntagonistJoint) -> list[str]:
    note = "of the agonist's and then the antagonist's parameters"
    return [] if joint.covariance is None else section("covariance", {"rows": joint.covariance}, note)


def _limits(machine: Machine) -> dict[str, object]:
    rows = machine.angle_limits
    if isinstance(machine, AntagonistJoint):
        rows = None if machine.angle_limits is None else (machine.angle_limits,)
    values: dict[str, object] = {"pressure_limits": machine.pressure_limits, "min_contraction": machine.min_contraction}
    values |= {"joints": machine.joint_names} if isinstance(machine, Mechanism) else {}
    return values | ({} if rows is None else {"angle_limits": rows})


def _of_a_joint(joint: AntagonistJoint, scale_known: bool) -> dict[str, object]:
    values = {"friction": joint.friction, "scale_known": scale_known}
    return values | ({"unseen": joint.unseen} if joint.unseen else {})


def _named_muscles(machine: Machine) -> Iterable[tuple[str, Muscle]]:
    if isinstance(machine, AntagonistJoint):
        return zip(_PAIR, (machine.agonist, machine.antagonist), strict=True)
    return zip(machine.muscle_names, machine.muscles, strict=True)


def _route_lines(machine: Machine) -> list[str]:
    routes: Any = machine.geometry if isinstance(machine, AntagonistJoint) else machine.routes
    kind = type(routes).__name__
    if kind not in _kinds():
        sampled = "it into a Table" if isinstance(machine, AntagonistJoint) else "the lengths into Tables"
        raise InvalidInput(f"{kind} cannot be written to a file; sample {sampled}")
    values = {name: getattr(routes, name) for name in signature(type(routes)).parameters}
    if not isinstance(routes, Sites):
        return section("routes", {"kind": kind} | values)
    links = values.pop("links")
    values["paths"] = tuple(tuple((site.link, *site.position) for site in path) for path in routes.paths)
    lines = section("routes", {"kind": kind} | values)
    for link in links:
        lines += section("[routes.links]", {f.name: getattr(link, f.name) for f in fields(link)})
    return lines


def _muscle_lines(muscles: Mapping[str, Muscle]) -> list[str]:
    lines: list[str] = []
    above: dict[str, str] = {}  # text of a law: its first muscle
    for name, muscle in muscles.items():
        law = "\n".join(muscle_lines(muscle, "muscle"))
        same = entries({"like": above[law]}) if law in above else [law]
        lines += [*section("[muscle]", {"name": name}), *same]
        above.setdefault(law, name)
    return lines


# --- reading --------------------------------------------------------------------------------------------------------


def load_machine(path: FilePath, *, scale_needed: bool = True) -> Machine:
    """Read a joint or a mechanism.

    Raises `InvalidFile` if it is none, or is a joint without a force scale although that is needed.
    """
    return machine_from(Table.read(path), scale_needed=scale_needed)


def load_joint(path: FilePath, *, scale_needed: bool = True) -> AntagonistJoint:
    """Read one joint with two muscles. Raises `InvalidFile`, also for another machine; see `load_machine`."""
    return joint_from(Table.read(path), scale_needed=scale_needed)


def joint_from(file: Table, *, scale_needed: bool = True) -> AntagonistJoint:
    """Return the joint in a parsed file."""
    machine = machine_from(file, scale_needed=scale_needed)
    if isinstance(machine, Mechanism):
        raise file.fault(f"holds {described(machine)}; expected one joint with routes {', '.join(_GEOMETRIES)}")
    return machine


def described(machine: Machine) -> str:
    """Return a description of a machine, in some words."""
    if isinstance(machine, AntagonistJoint):
        return "a joint with two muscles"
    return f"a machine with n = {machine.n} joint{'s' * (machine.n > 1)} and m = {machine.m} muscles"


def machine_from(file: Table, *, scale_needed: bool = True) -> Machine:
    """Return the joint or the mechanism in a parsed file."""
    limits, routes = (file.needed(name, "a machine") for name in ("machine", "routes"))
    kind = routes.entries.get("kind")
    if kind not in list(_kinds()):  # it may be anything, even a list
        raise routes.fault(f"the unknown kind {kind!r}; known: {', '.join(_kinds())}")
    one = kind in _GEOMETRIES
    whose = f"the file of {'a joint' if one else 'a machine'} with the routes {kind}"
    file.only((*_TABLES, *(_OF_A_JOINT if one else _OF_MORE)), whose)
    limits.only((*_LIMITS, *(("friction", "scale_known", "unseen") if one else ("joints",))), whose)
    if one and scale_needed and not scale_known_in(file):
        raise file.fault(
            "holds a joint whose force scale is unknown, since it was fitted without a weight: it has no stiffness to "
            "command; fit again with a torque column"
        )
    led, muscles = _routes(routes, str(kind)), _muscles(file)
    gas = file.table("gas")
    more = {"gas": AIR if gas is None else gas.made(Gas)}
    machine = _joint(file, limits, led, muscles, more) if one else _mechanism(file, limits, led, muscles, more)
    try:
        if doubtful := rough_tables.check(machine):
            notice_once(f"{file.path}: {doubtful}", rough_tables.RoughTable)
    except InvalidInput as error:
        raise routes.fault(error) from None
    return machine


def scale_known_in(file: Table) -> bool:
    """Return whether the forces of the joint in a parsed file are in newtons: it was not fitted without a weight."""
    table = file.table("machine")
    known = True if table is None else table.entries.get("scale_known", True)
    if table is not None and not isinstance(known, bool):
        raise table.fault(f"scale_known = {known!r} has to be true or false")
    return bool(known)


def encoder_zero_in(file: Table) -> float:
    """Return the encoder reading [rad] at 0 of the joint in a parsed file; 0 unless its table [source] has one."""
    table = file.table("source")
    if table is None:
        return 0.0
    try:
        zero = checks.number("encoder_zero_deg", table.entries.get("encoder_zero_deg", 0.0), "deg") * DEG
    except InvalidInput as error:
        raise table.fault(error) from None
    if abs(zero) > 2 * pi:
        raise table.fault(f"encoder_zero_deg = {zero / DEG:g} is over a turn")
    return zero


def encoder_zero_known_in(file: Table) -> bool:
    """Return whether that zero was given rather than fitted: its standard deviation in [source] is 0."""
    table = file.table("source")
    return table is not None and table.entries.get("encoder_zero_std_deg") == 0


def _joint(file: Table, limits: Table, led: Any, muscles: dict[str, Muscle], more: dict[str, Any]) -> AntagonistJoint:
    if sorted(muscles) != sorted(_PAIR):
        raise file.fault(f"a joint has the [[muscle]]s agonist and antagonist, not {', '.join(muscles) or 'none'}")
    values: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in limits.entries.items()}
    values.pop("scale_known", None)
    rows = values.get("angle_limits")
    if rows is not None:
        if len(rows) != 1 or not isinstance(rows[0], list):
            raise limits.fault("angle_limits has one row of a joint, [[lower, upper]] [rad]")
        values["angle_limits"] = tuple(rows[0])
    if isinstance(file.entries.get("measured"), dict):
        raise file.fault("[measured] of a fitted muscle has to stand below its [[muscle]], as [muscle.measured]")
    operator = file.table("hysteresis")
    more |= {"hysteresis": None if operator is None else operator.made(PrandtlIshlinskii)}
    more["covariance"] = covariance_rows(file)
    try:
        return AntagonistJoint(led, muscles["agonist"], muscles["antagonist"], **more, **values)
    except (InvalidInput, TypeError, ValueError, OverflowError) as error:
        raise file.fault(error) from None


def _mechanism(file: Table, limits: Table, led: Any, muscles: dict[str, Muscle], more: dict[str, Any]) -> Mechanism:
    values = dict(limits.entries)
    if not isinstance(joints := values.pop("joints", []), list):
        raise limits.fault(f"joints = {joints!r} has to be a list of names")
    names: dict[str, Any] = {"muscle_names": tuple(muscles), "joint_names": tuple(joints)}
    try:
        return Mechanism(led, tuple(muscles.values()), **names, **more, **values)
    except (InvalidInput, TypeError, ValueError, OverflowError) as error:
        raise file.fault(error) from None


def _routes(table: Table, kind: str) -> Any:
    given = {name: value for name, value in table.entries.items() if name != "kind"}
    if kind == "Sites":
        links = [link.made(Link) for link in table.each("links")]
        try:
            paths = [[(site[0], site[1:]) for site in line] for line in given.get("paths", ())]
        except (TypeError, IndexError):
            raise table.fault("paths have to be rows of sites [link, x, y, z]") from None
        given |= {"links": links, "paths": paths}
    return Table(table.path, given, table.name).made(_kinds()[kind], f"a {kind}")


def _muscles(file: Table) -> dict[str, Muscle]:
    """Return the muscles by their names, each as it stands there or like one above."""
    found: dict[str, Muscle] = {}
    any_kind: type[Any] = Muscle
    for table in file.each("muscle"):
        name, like = (table.entries.get(entry) for entry in ("name", "like"))
        if name is None:
            raise table.fault("name is missing: each [[muscle]] of a mechanism has its own")
        if not isinstance(name, str) or name in found:
            raise table.fault(f"name = {name!r} has to be a name, and no other muscle's")
        if like is None:
            found[name] = muscle_from(any_kind, table, "name")
            continue
        table.only(("name", "like"), "a muscle like another")
        if like not in list(found):
            raise table.fault(f"like = {like!r} has to be the name of a muscle above: {', '.join(found) or 'none'}")
        found[name] = found[like]
    return found


def _kinds() -> dict[str, Any]:
    return {**_GEOMETRIES, **FILED}


def frictions_in(file: Table) -> list[dict[str, float]]:
    """Return the numbers of the table [friction] for each joint, by name; none without it. Raises `InvalidFile`."""
    if (table := file.table("friction")) is None:
        return []
    table.only(FRICTION)
    machine = machine_from(file)
    joints = machine.n if isinstance(machine, Mechanism) else 1
    try:
        columns = {name: checks.real(name, value, "SI unit") for name, value in table.entries.items()}
        for name, column in columns.items():
            if column.shape not in ((), (joints,)):
                raise InvalidInput(f"{name} = {table.entries[name]} has to be one number, or one per joint ({joints})")
    except InvalidInput as error:
        raise table.fault(error) from None
    return [{name: float(np.broadcast_to(x, joints)[i]) for name, x in columns.items()} for i in range(joints)]
