"""QP solver of a step as C (`recursions.h`, `recursions.c`), printed from the Python source that runs in Python."""

from allocator.compilation.jit import Function
from allocator.compilation.printer import INT, MIN_AND_MAX, REAL, ArrayKind, Kind, StructKind, c_functions, with_called
from mpc.export import text

_N, _AFTER, _BLOCKS = "ANT_HORIZON", "ANT_HORIZON + 1", "ANT_BLOCKS"
_SIDE = "signed char"
_SINGLE = {"PUSHES": 0.5, "BREAKS": 1e-7, "ROW_BREAKS": 1e-5, "FLAT": 1e-5}  # rounding tolerances of float32
_ITEMS = {True: 24, False: 12}  # by single precision; the following stages have no memory for more


def recursion_files(single: bool) -> dict[str, str]:
    """Return the files of the solver, which are the same for every joint; antagonist_config.h defines the sizes.

    In single precision there is no interior-point method, because it would not be accurate enough.
    """
    from mpc.tracking.compiled import commands
    from mpc.tracking.compiled.structured_qp import certificate, newton, rows, solve

    entries: list[Function] = [commands.limit, commands.excess, commands.slew_bounds, commands.deviations, solve.swept]
    entries += [newton.gradients, newton.adjoint, newton.left_over, newton.factorise, newton.direction]  # softened.c
    entries += [rows.values, rows.sides, certificate.brought_within]
    entries += [] if single else [solve.persistent]
    names = {entry.__name__: f"ant_{entry.__name__}" for entry in entries}
    structs, items = _structs(), items_in(single)
    numbers = {"ITEMS": items, "LAST": items - 1} | (_SINGLE if single else {})
    made = c_functions(with_called(entries), _kinds(structs), single, names, numbers)
    about = "The QP of a step, solved sample by sample; printed from the Python source."
    head = "\n\n".join([*(struct.definition() for struct in structs.values()), made.head])
    body = "\n\n".join([f'/* {about} */\n#include "recursions.h"\n\n#include "real.h"', MIN_AND_MAX, made.body])
    return {
        "src/recursions.h": text.header("ANT_RECURSIONS_H", about, head, ["antagonist.h"]),
        "src/recursions.c": f"{body}\n",
    }


def items_in(single: bool) -> int:
    """Return the maximum number of items in an exchange of active bounds (`structured_qp.responses`)."""
    return _ITEMS[single]


def _array(*sizes: str | int, element: str = REAL, constant: bool = False) -> ArrayKind:
    return ArrayKind(element, tuple(map(str, sizes)), constant)


def _given(*sizes: str | int, element: str = REAL) -> ArrayKind:
    return _array(*sizes, element=element, constant=True)


def _structs() -> dict[str, StructKind]:
    """Return the C structs of the named tuples, each after the structs that it contains."""
    per_x, per_y, per_u = _array(_AFTER, 4), _array(_AFTER, 3), _array(_N, 2)
    row, lines = _array(_AFTER, 12), ("b", "t", "multiplier", "W", "residual", "push", "dt", "change")
    made: dict[str, dict[str, Kind]] = {
        "cost": {"x": _given(4), "y": _given(3), "e": _given(2), "change": _given(2), "end": _given(6, 6)},
        "bounds": dict.fromkeys(("low", "high", "step", "left", "right", "min_force"), REAL),
        "path": {
            "x": _given(_AFTER, 4),
            "y": _given(_AFTER, 3),
            "A": _given(_N, 4, 4),
            "B": _given(_N, 4, 2),
            "slope": _given(_AFTER, 3, 4),
        },
        "reference": {"x": _given(_AFTER, 4), "y": _given(_AFTER, 3), "u": _given(_N, 2)},
        "errors": {"x": per_x, "y": per_y, "e": per_u, "change": per_u, "end": _array(6)},
        "point": {"xi": _array(_AFTER, 6), "v": per_u, "sigma": _array(2)},
        "bounded": {"lower": per_u, "upper": per_u, "there": _array(_N, element=_SIDE)},
        "sweep": {
            "R": _array(_N, 2, 6),
            "D": _array(_N, 3),
            "g": per_u,
            "feedback": _array(_N, 2, 7),
            "held": _array(_N, 2, element=_SIDE),
            "gx": _array(_AFTER, 6),
            "gv": per_u,
            "r": per_u,
            "inverse": _array(_N, 3),
        },
        "factors": {
            "R": _array(_N, 2, 6),
            "feedback": _array(_N, 2, 7),
            "border": _array(_N, 2, 2),
            "inverse": _array(_N, 3),
            "sigma": _array(3),
        },
        "rows": {"span": _array(_AFTER, 2, element=INT), **dict.fromkeys(lines, row)},
    }
    line, few = _array(_AFTER, 2), "ANT_ITEMS"
    sides, numbers, counts = _array(_AFTER, 2, element=_SIDE), _array(few), _array(few, element=INT)
    made["items"] = {
        "z": _array(few, _AFTER, 2),
        "r": _array(few, _AFTER, 2),
        "K": _array(few, few),
        **dict.fromkeys(("kind", "sample", "muscle", "side"), counts),
        "multiplier": numbers,
        "step": numbers,
        "L": _array(few, few),
        "order": counts,
        "known": _array(1, element=INT),
        "p": _array(6),
    }
    structs = {name: StructKind(f"ant_qp_{name}", fields, False) for name, fields in made.items()}
    setting: dict[str, Kind] = {"cost": structs["cost"], "bounds": structs["bounds"]}
    setting |= dict.fromkeys(("curvature", "tolerance", "accuracy"), REAL)
    setting |= {"slack": _given(4), "starts": _given(_BLOCKS, element=INT)}
    work: dict[str, Kind] = {"rows": structs["rows"], "factors": structs["factors"], "by": structs["point"]}
    work |= {"sweep": structs["sweep"], "gx": _array(_AFTER, 6), "gv": per_u, "r": per_u, "first": per_u}
    work |= {"origin_x": _array(_AFTER, 6), "origin_v": per_u, "trial": structs["point"]}
    active: dict[str, Kind] = {"base": sides, "held": sides}
    active |= dict.fromkeys(("lower", "upper", "z", "r", "dz", "dr"), line)
    active |= {"b": row, "value": row, "xi": _array(_AFTER, 6), "first": per_u}
    active |= {"other": structs["point"], "items": structs["items"]}
    return structs | {
        "active": StructKind("ant_qp_active", active, False),
        "setting": StructKind("ant_qp_setting", setting, False),
        "work": StructKind("ant_qp_work", work, False),
    }


def _kinds(structs: dict[str, StructKind]) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    sweep, rows, factors = structs["sweep"].fields, structs["rows"].fields, structs["factors"].fields
    items, per_u = structs["items"].fields, sweep["gv"]
    reals: tuple[str, ...] = (
        "w",
        "total",
        "worst",
        "product",
        "share",
        "mean",
        "tolerance",
        "c0",
        "c1",
        "entering",
        "limit",
    )
    reals += ("low", "high", "step", "unit", "left", "right", "least")
    return {
        **structs,
        **{name: structs["path"].fields[name] for name in ("A", "B", "slope")},
        **{name: sweep[name] for name in ("R", "D", "g", "feedback", "held", "gx", "gv", "r")},
        **{name: factors[name] for name in ("sigma", "inverse", "border")},
        **dict.fromkeys(("W", "b", "value", "push"), rows["b"]),
        **dict.fromkeys(("gradient", "v", "lower", "upper"), per_u),
        **{
            "at": structs["point"],
            "by": structs["point"],
            "trial": structs["point"],
            "a": structs["active"],
            "base": structs["active"].fields["base"],
            "f": structs["factors"],
            "xi": _array(_AFTER, 6),
        },
        **{"S": _array(6, 6), "SA": _array(6, 6), "P": _array(6, 2), "G": _array(2, 2), "F": sweep["feedback"]},
        **{"s": _array(6), "p": _array(6), "slack": _given(4), "last": _given(2, 2)},
        **dict.fromkeys(("e", "charge", "before"), _given(2)),
        **{"u": _given(_N, 2), "guess": _array(f"2 * {_BLOCKS}", element=_SIDE)},
        **{"z": items["z"], "pushes": items["r"], "there": structs["bounded"].fields["there"]},
        **{"commands": per_u, "states": _given(_AFTER, 4), "forces": _given(_AFTER, 2), "beyond": _array(2)},
        "starts": _given(_BLOCKS, element=INT),
        **dict.fromkeys(reals, REAL),
    }
