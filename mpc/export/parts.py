"""Parts of an export: unchanged C files of this package, and files generated for the joint."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from allocator.allocation.status import CLOSED_FORM
from allocator.calculus import Value
from allocator.errors import MissingBackend
from allocator.joint.antagonist import AntagonistJoint
from allocator.lazy import Function
from allocator.mechanism import Mechanism
from mpc.codegen.text import c_function, c_prototype
from mpc.export import text
from mpc.export.joint import Kernel, Numbers, kernel_files, sides_function, stiffness_function
from mpc.model.machine import Machine
from mpc.model.plant import Plant

Files = dict[str, str]  # path within the exported directory: content
Functions: TypeAlias = list[tuple["Function", str]]
"""CasADi functions with a description of each."""

PRECISIONS = ("double", "single")
_C = Path(__file__).parent / "c"


def filled(readme: str, **words: object) -> str:
    """Return a README with these words in its gaps."""
    return (_C / "readme" / f"{readme}.md").read_text(encoding="utf-8").format(**words)


def build_words(single: bool, printed: Iterable[str]) -> dict[str, str]:
    """Return the words of a README about the precision, and about building and the demonstration's expected output."""
    rounded = " (single precision differs in the last digits)" if single else ""
    build = filled("build", rounded=rounded, printed="\n".join(printed))
    return {"precision": "single" if single else "double", "build": build}


def machine_words(mechanism: Mechanism) -> dict[str, object]:
    """Return the README section about a mechanism."""
    joints, muscles = ", ".join(mechanism.joint_names), ", ".join(mechanism.muscle_names)
    return {"n": mechanism.n, "m": mechanism.m, "joints": joints, "muscles": muscles}


def names_of(machine: Machine) -> tuple[Sequence[str], Sequence[str]]:
    """Return the names of the joints and of the muscles, in their order in rows."""
    if isinstance(machine, Plant):
        return ["the joint"], ["the agonist", "the antagonist"]
    return machine.mechanism.joint_names, machine.mechanism.muscle_names


def is_single(precision: str) -> bool:
    """Return whether `precision` is "single". Raises `MissingBackend` for an unknown one."""
    if precision not in PRECISIONS:
        raise MissingBackend("precision", precision, PRECISIONS)
    return precision == "single"


def copied(directory: str, to: str) -> Iterator[tuple[str, str]]:
    """Yield the C files in `directory` of this package, with their paths below `to`."""
    for path in sorted((_C / directory).iterdir()):
        if path.is_file() and not path.name.startswith("."):
            yield f"{to}{path.name}", path.read_text(encoding="utf-8")


def allocation_files(joint: AntagonistJoint, kernel: Kernel, single: bool) -> Files:
    """Return the files of the allocation, without the demonstration."""
    files = dict(copied("allocate", "src/")) | dict(copied(kernel.name, "src/")) | kernel_files(kernel.name, single)
    numbers = text.defines({**kernel.numbers, **_tolerances(joint, single)}, single)
    files["src/joint.h"] = text.header("ANT_JOINT_H", "The joint's numbers, in SI units.", numbers)
    about = "theta [rad], P1, P2 [Pa] and amplitude [rad] to the terms of ant_stiffness"
    return files | model_files([(stiffness_function(joint), about)], single, name="stiffness_model")


def _tolerances(joint: AntagonistJoint, single: bool) -> Numbers:
    """Return the tolerances of equality under rounding."""
    met, near = (4e-6, 1e-6) if single else CLOSED_FORM
    return {
        "MET": (met, "greatest miss of a met target, over the torque or stiffness scale [-]"),
        "NEAR": (near * joint.pressure_span, "distance to a bound at which a pressure lies on it [Pa]"),
    }


def dense(name: str, inputs: Mapping[str, Value], outputs: Mapping[str, Value]) -> "Function":
    """Return a CasADi function with dense outputs and common subexpressions eliminated."""
    import casadi as ca

    made = ca.cse([ca.densify(value) for value in outputs.values()])
    return ca.Function(name, [*inputs.values()], made, [*inputs], [*outputs])


def kernel_functions(joint: AntagonistJoint, kernel: Kernel) -> Functions:
    """Return the CasADi functions of the kernel, with descriptions."""
    if kernel.name == "tondu":
        return []
    return [(sides_function(joint), "theta [rad] to the muscles at theta, see kernel.c")]


def model_files(functions: Functions, single: bool, includes: Sequence[str] = (), name: str = "model") -> Files:
    """Return model.h, which includes other headers, and model.c with these CasADi functions, or files of a `name`."""
    if not functions:
        return {}
    heads = "\n".join(f"{c_prototype(f)}; /* {about} */" for f, about in functions)
    bodies = "\n\n".join(c_function(f, about, single) for f, about in functions)
    about = "The machine's formulas, derived by CasADi."
    return {
        f"src/{name}.h": text.header(f"ANT_{name.upper()}_H", about, heads, ["antagonist.h", *includes]),
        f"src/{name}.c": f'/* {about} */\n#include "{name}.h"\n\n#include "real.h"\n\n{bodies}\n',
    }
