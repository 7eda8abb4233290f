"""Allocation kernel as C (`kernel.h`, `kernel.c`), printed from the source that Python, numba and NumPy run."""

from collections.abc import Iterable
from typing import NamedTuple

from allocator.allocation.status import Status
from allocator.allocation.two_muscles.kernels import source
from allocator.allocation.two_muscles.kernels.choice import AffineNumbers, TonduNumbers
from allocator.compilation.printer import INT, REAL, Outside, Printed, Source, c_form
from allocator.joint.limits import Limit
from mpc.export import text

Defined = dict[str, str]  # the name of an element of `p`: its name in joint.h

_LIMITS: Defined = {
    "lo": "SUPPLY_LO",
    "left": "LEFT",
    "right": "RIGHT",
    "near": "NEAR",
    "hi_limit1": "HI1_LIMIT",
    "hi_limit2": "HI2_LIMIT",
    "below": "LEFT_LIMIT",
    "above": "RIGHT_LIMIT",
}
_TONDU: Defined = {
    "S": "AREA",
    "R": "RADIUS",
    "l0": "REST_LENGTH",
    "eps0": "EPS0",
    "q": "Q",
    "c": "C",
    "d": "D",
    "e": "E",
    "g": "G",
    "hi": "HI1",
    "least": "-INFINITY",
    "most": "MOST",
}
_AFFINE: Defined = {"most1": "HI1", "most2": "HI2"}


class Form(NamedTuple):
    """Kernel of a kind of joints, and the C expressions of its numbers `p`."""

    numbers: type[tuple[object, ...]]  # NamedTuple
    defined: Defined


_FORMS = {"tondu": Form(TonduNumbers, _LIMITS | _TONDU), "affine": Form(AffineNumbers, _LIMITS | _AFFINE)}
_ABSENT = {
    "min_force": "min_force <= -ANT_INFINITY",
    "max_force": "max_force >= ANT_INFINITY",
    "max_step": "max_step >= ANT_INFINITY",
    "stiffness_first": "!stiffness_first",
}
_RESULT = ("P1", "P2", "T_given", "K_given", "status", "limits", "sure")


def printed(name: str) -> Printed:
    """Return the kernel `name`, "tondu" or "affine", as C, the same for every joint of the kind."""
    form = _FORMS[name]
    kinds = {field: INT if kind is int else REAL for field, kind in form.numbers.__annotations__.items()}
    outside = Outside(
        names={"clip": "ant_clip", "MET": "ANT_MET"} | {name: f"ANT_{name}" for name in _statuses()} | _flags(),
        functions={f"{name}_exact": f"ant_{name}_exact"},
        structs={("P1", "P2"): "ant_pair", _RESULT: "ant_answer"},
        numbers={"p": {field: (kind, _text(form.defined[field])) for field, kind in kinds.items()}},
        arrays=frozenset(("one", "two")),
        flags=frozenset(("stiffness_first",)),
        absent=_ABSENT,
        inner="ANT_ONCE",
    )
    return c_form(Source.of(source), f"{name}_exact", outside)


def _text(defined: str) -> str:
    return f"-ANT_{defined[1:]}" if defined.startswith("-") else f"ANT_{defined}"


def _statuses() -> list[str]:
    """Return the names of statuses in the kernels, which are those of C."""
    return [status.name for status in Status if getattr(source, status.name, None) == status]


def _flags() -> dict[str, str]:
    return {name: _listed(getattr(source, name)) for name in ("AGONIST", "ANTAGONIST")}


def _listed(flags: Iterable[int]) -> str:
    return f"{{{', '.join(f'ANT_{Limit(flag).name}' for flag in flags)}}}"


def kernel_files(name: str) -> dict[str, str]:
    """Return the files of the kernel `name`."""
    made = printed(name)
    about = "The exact allocation of one target, printed from the Python source."
    return {
        "src/kernel.h": text.header("ANT_KERNEL_H", about, made.head, ["antagonist.h"]),
        "src/kernel.c": f'/* {about} */\n#include "kernel.h"\n\n#include "joint.h"\n#include "real.h"\n\n{made.body}\n',
    }
