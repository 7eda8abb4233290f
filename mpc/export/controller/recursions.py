"""QP solver of a step as C (`recursions.h`, `recursions.c`), printed from the Python source that runs in Python."""

from collections.abc import Mapping
from functools import cache

from allocator.compilation.jit import Function
from allocator.compilation.printer import INT, MIN_AND_MAX, REAL, ArrayKind, Kind, StructKind, c_functions, with_called
from mpc.export import text
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine

_N, _AFTER, _BLOCKS = "ANT_HORIZON", "ANT_HORIZON + 1", "ANT_BLOCKS"
_M, _X, _XI, _Y = "ANT_MUSCLES", "ANT_STATES", "ANT_XI", "ANT_OUTPUTS"
_SIDE = "signed char"
_SINGLE = {"PUSHES": 0.5, "BREAKS": 1e-6, "ROW_BREAKS": 1e-5, "FLAT": 1e-5}  # rounding tolerances of float32
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
    body = "\n\n".join([f'/* {about} */\n#include "recursions.h"\n\n#include "real.h"', MIN_AND_MAX, made.body])
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
    line, few, per_xi = _array(_AFTER, _M), "ANT_ITEMS", _array(_AFTER, _XI)
    sides, numbers, counts = _array(_AFTER, _M, element=_SIDE), _array(few), _array(few, element=INT)
    per_x, per_y, per_u = _array(_AFTER, _X), _array(_AFTER, _Y), _array(_N, _M)
    squares, end = _array(_N, *((_M, _M) if arm else ("3",))), _given("ANT_JOINTS") if arm else REAL
    by_state, by_command = (
        (_given(_N, "2 * ANT_JOINTS", _XI), _given(_M)) if arm else (_given(_N, _X, _X), _given(_N, _X, _M))
    )
    made: dict[str, dict[str, Kind]] = {
        "cost": {"x": _given(_X), "y": _given(_Y), "e": _given(_M), "change": _given(_M), "end": _given(_XI, _XI)},
        "bounds": {"low": REAL, "high": REAL, "step": REAL, "left": end, "right": end, "min_force": REAL},
        "path": {
            "x": _given(_AFTER, _X),
            "y": _given(_AFTER, _Y),
            "A": by_state,
            "B": by_command,
            "slope": _given(_AFTER, _Y, _X),
        },
        "reference": {"x": _given(_AFTER, _X), "y": _given(_AFTER, _Y), "u": _given(_N, _M)},
        "errors": {"x": per_x, "y": per_y, "e": per_u, "change": per_u, "end": _array(_XI)},
        "point": {"xi": per_xi, "v": per_u, "sigma": _array(2)},
        "bounded": {**dict.fromkeys(("lower", "upper", "low", "high"), line), "there": _array(_N, element=_SIDE)},
        "sweep": {
            "R": _array(_N, _M, _XI),
            "D": squares,
            "g": per_u,
            "feedback": _array(_N, _M, f"{_XI} + 1"),
            "held": sides,
            "gx": per_xi,
            "gv": per_u,
            "inverse": squares,
            "xi": per_xi,
            "v": per_u,
            "e": per_u,
            "change": per_u,
            "rows": _array(_AFTER, f"ANT_JOINTS + {_M}"),
        },
    }
    made["items"] = {
        "z": _array(few, _AFTER, _M),
        "r": _array(few, _AFTER, _M),
        "K": _array(few, few),
        **dict.fromkeys(("kind", "sample", "muscle", "side"), counts),
        "multiplier": numbers,
        "step": numbers,
        "L": _array(few, few),
        "order": counts,
        "known": _array(1, element=INT),
        "p": _array(_XI),
    }
    structs = {name: StructKind(f"ant_qp_{name}", fields, False) for name, fields in made.items()}
    setting: dict[str, Kind] = {"cost": structs["cost"], "bounds": structs["bounds"]}
    setting |= dict.fromkeys(("curvature", "exchanges", "accuracy"), REAL)
    setting |= {"slack": _given(4), "starts": _given(_BLOCKS, element=INT)}
    active: dict[str, Kind] = {"held": sides, "guess": sides}
    active |= dict.fromkeys(("z", "r", "dz", "dr"), line) | {"xi": per_xi, "items": structs["items"]}
    return structs | {
        "active": StructKind("ant_qp_active", active, False),
        "setting": StructKind("ant_qp_setting", setting, False),
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
