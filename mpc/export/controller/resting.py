"""Rest mode as C (`resting.h`, `resting.c`), printed from the Python source that runs in Python."""

from functools import cache

from allocator.compilation.printer import (
    MIN_AND_MAX,
    REAL,
    ArrayKind,
    Kind,
    StructKind,
    c_functions,
    number,
    with_called,
)
from mpc.export import text
from mpc.tracking import resting
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.rest_memory import QUARTERS, Memory, Rules

_N, _M, _SAMPLES = "ANT_JOINTS", "ANT_MUSCLES", "(ANT_HORIZON + 1)"
_ENTRIES = (
    resting.clear, resting.begin, resting.constant, resting.decided, resting.turn,
    resting.holds, resting.rings, resting.side, resting.pressure, resting.angle,
)  # fmt: skip


@cache
def resting_files(single: bool) -> dict[str, str]:
    """Return the files of the rest mode, which are the same for every machine; antagonist_config.h has the sizes."""
    memory = StructKind("ant_rest", dict(zip(Memory._fields, _memory(), strict=True)), True)
    rules = StructKind("ant_rest_rules", dict.fromkeys(Rules._fields, REAL), False)
    names = {entry.__name__: f"ant_rest_{entry.__name__}" for entry in _ENTRIES}
    made = c_functions(with_called([*_ENTRIES]), _kinds(memory, rules), single, names, {})
    about = "Rest mode: commands that rest at a constant reference; printed from the Python source."
    head = "\n\n".join([memory.definition(), rules.definition(), made.head])
    return {
        "src/resting.h": text.header("ANT_RESTING_H", about, head),
        "src/resting.c": f'/* {about} */\n#include "antagonist.h"\n#include "real.h"\n\n{MIN_AND_MAX}\n\n{made.body}\n',
    }


def rest_rules(controller: TrackingMPC, single: bool) -> str:
    """Return the definition of `ANT_REST_RULES`."""
    listed = ",\n".join(
        f"    {number(float(value), single)} /* {name} */"
        for name, value in controller.rest_mode.rules._asdict().items()
    )
    return f"const ant_rest_rules ANT_REST_RULES = {{\n{listed}}};"


def _memory() -> list[ArrayKind]:
    """Return the arrays of a `Memory`, in their order."""
    quarters = str(QUARTERS)
    sizes = ("9",), (_N, "9"), (_M, "4"), (quarters, _N, "3"), (quarters, _M), (f"{_N} * {_N}",)
    return [ArrayKind(REAL, each) for each in sizes]


def _kinds(memory: StructKind, rules: StructKind) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    preview, matrices = f"{_N} * {_SAMPLES}", f"{_N} * {_N} * {_SAMPLES}"
    given = {"theta": preview, "stiffness": matrices, "seen": "ANT_STATES", "expected": _N, "slopes": f"{_N} * {_M}"}
    arrays = {name: ArrayKind(REAL, (size,), True) for name, size in given.items()}
    return {"m": memory, "k": rules, **arrays}
