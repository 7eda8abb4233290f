"""QP solver of a step as C (`recursions.h`, `recursions.c`), printed from the Python source that runs in Python."""

from collections.abc import Mapping
from functools import cache

from allocator.compilation.jit import Function
from allocator.compilation.printer import INT, REAL, ArrayKind, Kind, StructKind, c_functions, with_called
from mpc.export import text
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine

_N, _AFTER, _BLOCKS = "ANT_HORIZON", "ANT_HORIZON + 1", "ANT_BLOCKS"
_M, _X, _XI, _Y = "ANT_MUSCLES", "ANT_STATES", "ANT_XI", "ANT_OUTPUTS"
_SIDE = "signed char"
_SINGLE = {"PUSHES": 0.5, "BREAKS": 1e-6, "ROW_BREAKS": 1e-5, "FLAT": 1e-5, "FINE": 1e-4}  # rounding of float32
_ITEMS = {True: 28, False: 16}  # by single precision; more would not fit into a microcontroller


def recursion_files(plant: Machine, single: bool) -> dict[str, str]:
    """Return the files of the solver, which are the same for every joint; sizes stand in antagonist_config.h."""
    return _printed(tuple(solver_of(plant)), isinstance(plant, Arm), single)


@cache
def _printed(entries: tuple[Function, ...], arm: bool, single: bool) -> dict[str, str]:
    structs = _structs(arm)
    names = {entry.__name__: f"ant_{entry.__name__}" for entry in entries} | {"solve": "ant_settle"}
    made = c_functions(with_called(entries), _kinds(structs), single, names, _SINGLE if single else {})
    about = "The QP of a step, solved sample by sample; printed from the Python source."
    head = "\n\n".join([*(struct.definition() for struct in structs.values()), made.head])
    body = "\n\n".join([f'/* {about} */\n#include "recursions.h"\n\n#include "real.h"', made.body])
    return {
        "src/recursions.h": text.header("ANT_RECURSIONS_H", about, head, ["antagonist.h"]),
        "src/recursions.c": f"{body}\n",
    }


def solver_of(plant: Machine) -> list[Function]:
    """Return the exported functions of the solver, for the sizes of an arm."""
    if isinstance(plant, Arm):
        from mpc.tracking.compiled.arm.module import solve_module

        module = solve_module(plant)
        return [getattr(module, name) for name in ("limit", "excess", "change_bounds", "deviations", "solve")]
    from mpc.tracking.compiled import commands
    from mpc.tracking.compiled.structured_qp import solve

    return [commands.limit, commands.excess, commands.change_bounds, commands.deviations, solve.solve]


def kinds_of(plant: Machine) -> Mapping[str, Kind]:
    """Return the kinds of the solver's arguments, by their names in all functions."""
    return _kinds(_structs(isinstance(plant, Arm)))


def items_in(n: int, m: int, blocks: int, single: bool) -> int:
    """Return the maximum number of items in an exchange of active bounds (`structured_qp.responses`)."""
    from mpc.tracking.compiled.structured_qp.sizes import spare

    return min(m * blocks + spare(n, m), _ITEMS[single])


def exchanges_in(changes: int) -> int:
    """Return the maximum number of exchanges in a QP."""
    from mpc.tracking.compiled.structured_qp.solve import MOST

    return MOST * changes


def _array(*sizes: str | int, element: str = REAL, constant: bool = False) -> ArrayKind:
    return ArrayKind(element, tuple(map(str, sizes)), constant)


def _given(*sizes: str | int, element: str = REAL) -> ArrayKind:
    return _array(*sizes, element=element, constant=True)


def _structs(arm: bool) -> dict[str, StructKind]:
    """Return the C structs of the named tuples, each after the structs that it contains."""
    made: dict[str, StructKind] = {}
    parts: dict[type, Kind] = {}
    for name, (record, constant) in _records().items():
        struct = StructKind.of(record, f"ant_qp_{name}", _SIZES, constant=constant, parts=parts)
        own = _OF_ARMS.get(name, {}) if arm else {}
        made[name] = parts[record] = struct._replace(fields={**struct.fields, **own})
    fields = {**made["setting"].fields, "starts": _given(_BLOCKS, element=INT)}
    return made | {"setting": made["setting"]._replace(fields=fields)}


def _records() -> dict[str, tuple[type, bool]]:
    """Return the named tuples by name, and whether their arrays are only read."""
    from mpc.tracking.compiled.records import Bounded, Bounds, Cost, Errors, Path, Point, Reference, Setting
    from mpc.tracking.compiled.structured_qp.active import Active
    from mpc.tracking.compiled.structured_qp.responses import Items
    from mpc.tracking.compiled.structured_qp.riccati import Sweep

    read = {"cost": Cost, "bounds": Bounds, "path": Path, "reference": Reference}
    filled = {"errors": Errors, "point": Point, "bounded": Bounded, "sweep": Sweep, "items": Items, "active": Active}
    groups = ((read, True), (filled, False), ({"setting": Setting}, True))
    return {name: (record, constant) for records, constant in groups for name, record in records.items()}


_SIZES = {"N": _N, "M": "ANT_ITEMS", "n": "ANT_JOINTS", "m": _M, "x": _X, "xi": _XI, "y": _Y}
_OF_ARMS: dict[str, dict[str, Kind]] = {
    "bounds": dict.fromkeys(("left", "right"), _given("ANT_JOINTS")),
    "path": {"A": _given(_N, "ANT_MOVING", _XI), "B": _given(_M)},
    "sweep": dict.fromkeys(("D", "inverse"), _array(_N, _M, _M)),
}


def _kinds(structs: dict[str, StructKind]) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    sweep, items = structs["sweep"].fields, structs["items"].fields
    return {
        **structs,
        **{name: structs["path"].fields[name] for name in ("A", "B", "slope")},
        **{name: sweep[name] for name in ("R", "D", "g", "feedback", "held", "gx", "gv", "inverse")},
        **{"at": structs["point"], "a": structs["active"], "base": sweep["held"], "v": sweep["gv"]},
        **{"xi": sweep["xi"], **dict.fromkeys(("r", "first"), structs["active"].fields["r"])},
        **{"S": _array(_XI, _XI), "SA": _array(_XI, _XI), "F": sweep["feedback"]},
        **{"s": _array(_XI), "p": _array(_XI), "slack": _given(4), "last": _given(2, _M)},
        **dict.fromkeys(("e", "charge", "charges"), sweep["e"]),
        "before": _given(_M),
        **{"u": _given(_N, _M), "guess": _array(f"{_M} * {_BLOCKS}", element=_SIDE)},
        **{"z": items["z"], "pushes": items["r"]},
        **{"commands": sweep["gv"], "states": _given(_AFTER, _X), "forces": _given(_AFTER, _M), "beyond": _array(2)},
        "starts": _given(_BLOCKS, element=INT),
        "free": _array(_M, element=_SIDE),
        **dict.fromkeys(("left", "right", "limits"), structs["bounds"].fields["left"]),
    }
