"""The exported files: those of this package as they are, and those that are written for the joint."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from allocator.allocation.tolerances import CLOSED_FORM
from allocator.joint.antagonist import AntagonistJoint
from mpc.codegen import c_text
from mpc.export import text
from mpc.export.joint import Law, Numbers, sides_function

Files = dict[str, str]  # path within the exported directory: content

_C = Path(__file__).parent / "c"


def copied(directory: str, to: str) -> Iterator[tuple[str, str]]:
    """The C files of `directory` of this package, to be put into `to`."""
    for path in sorted((_C / directory).iterdir()):
        if path.is_file() and not path.name.startswith("."):
            yield f"{to}{path.name}", path.read_text(encoding="utf-8")


def allocation_files(joint: AntagonistJoint, law: Law, single: bool) -> Files:
    """All that the allocation takes, without the demonstration."""
    files = dict(copied("allocate", "src/")) | dict(copied(law.directory, "src/"))
    numbers = text.defines({**law.numbers, **_tolerances(single)}, single)
    files["src/joint.h"] = text.header("ANT_JOINT_H", "The joint's numbers, in SI units.", numbers)
    return files


def _tolerances(single: bool) -> Numbers:
    """What rounding leaves of "equal"."""
    met, near = (4e-6, 1e-6) if single else CLOSED_FORM
    return {
        "MET": (met, "of the torque or stiffness scale: a target missed by less is met [-]"),
        "NEAR": (near, "of the supply: a pressure this near to a bound lies on it [-]"),
    }


def law_functions(joint: AntagonistJoint, law: Law) -> list[tuple[Any, str]]:
    """The CasADi functions that the law takes, and what each computes."""
    if law.directory == "tondu":
        return []
    return [(sides_function(joint), "theta [rad] to what the muscles are there, see law_state.h")]


def model_files(functions: list[tuple[Any, str]], single: bool) -> Files:
    """model.h and model.c with these CasADi functions, if there are any."""
    if not functions:
        return {}
    heads = "\n".join(f"{c_text.prototype(f)}; /* {about} */" for f, about in functions)
    bodies = "\n\n".join(c_text.function(f, about, single) for f, about in functions)
    about = "The joint's formulas, written by CasADi for this joint."
    return {
        "src/model.h": text.header("ANT_MODEL_H", about, heads, ["antagonist.h"]),
        "src/model.c": f'/* {about} */\n#include "model.h"\n\n#include "real.h"\n\n{bodies}\n',
    }


__all__ = ["Files", "allocation_files", "copied", "law_functions", "model_files"]
