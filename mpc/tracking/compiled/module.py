"""From a plant to compiled functions: its law as a Python module of its own, written once and found again.

numba keeps compiled code next to the file that it came from, and looks at no other when it decides whether that code is
up to date. So all that is kept comes from modules in the user's cache directory whose names are the hash of everything
that they are made from: one with the law, which joints share that differ in their numbers only, and one without. The
files are written for numba, and for whoever wants to read them; what runs is the text that they should contain.
"""

import os
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from allocator import AntagonistJoint, units
from allocator.allocation.kernels import compiled
from allocator.allocation.kernels import source as kernels
from allocator.allocation.kernels.choice import coefficients, kernel_of
from allocator.calculus import Array
from allocator.compilation import jit
from allocator.compilation.cache import check_own
from allocator.files.atomic import write_text
from allocator.units import BAR
from mpc.codegen.python_text import translated
from mpc.model.experiment import RESOLUTION
from mpc.model.plant import NU, NX, Plant
from mpc.tracking.compiled.jit import KEPT

_IMPORTS = """import math

from allocator.allocation.kernels.source import affine_exact, tondu_exact


"""
_TEMPLATE = Path(__file__).with_name("step.py")
_ANSWERS = Path(__file__).with_name("solve.py")


class Law(NamedTuple):
    """What is compiled for a family of plants, and the numbers of the plant."""

    module: ModuleType  # `mpc.tracking.compiled.step` with the law
    answers: ModuleType  # `mpc.tracking.compiled.solve`
    c: Array
    p: tuple[Any, ...]  # of the kernel; empty if there is none
    h: float  # step of the integration [s]
    substeps: int  # a sample


def law(plant: Plant, dt: float) -> Law:
    """The compiled functions for `plant` at the sample time `dt` [s]."""
    substeps = plant.substeps(dt, RESOLUTION)
    text, c = "", np.zeros(0)
    for name, function in _functions(plant).items():
        source = translated(name, function, c.size)
        text, c = text + f"@merged\n{source.text}\n\n", np.concatenate([c, source.c])
    kernel = kernel_of(plant.joint)
    compiled.register()
    step = _imported(_with_law(text + _ALLOCATED[kernel.name]))
    return Law(step, _imported(_ANSWERS.read_text(encoding="utf-8")), c, kernel.p, dt / substeps, substeps)


_ALLOCATED = {
    "tondu": """
@inlined
def allocated(theta, K, T, p, left, right, min_force, c):
    return tondu_exact(theta, K, T, p, min_force)


""",
    "affine": """
@inlined
def allocated(theta, K, T, p, left, right, min_force, c):
    o = coefficients(min(max(theta, left), right), c)
    return affine_exact(theta, K, T, (o[0], o[1], o[2], o[3], o[4]), (o[5], o[6], o[7], o[8], o[9]), p, min_force)


""",
    "": "\n\n",
}


def _functions(plant: Plant) -> dict[str, Any]:
    """CasADi functions of the rate of change x' and of the outputs (K, F1, F2), with and without derivatives."""
    import casadi as ca

    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    rate: Any = ca.vertcat(*plant.rate(x, BAR * u, d))
    y: Any = ca.vertcat(plant.stiffness(x), *plant.forces(x))
    slopes = [ca.densify(ca.jacobian(rate, v)) for v in (x, u)]
    return {
        "rate": ca.Function("rate", [x, u, d], ca.cse([rate])),
        "slopes": ca.Function("slopes", [x, u, d], ca.cse([rate, *slopes])),
        "look": ca.Function("look", [x], ca.cse([y])),
        "outputs": ca.Function("outputs", [x], ca.cse([y, ca.densify(ca.jacobian(y, x))])),
        **_coefficients(plant.joint),
    }


def _coefficients(joint: AntagonistJoint) -> dict[str, Any]:
    """What the affine kernel wants to know of both muscles at an angle."""
    import casadi as ca

    if kernel_of(joint).name != "affine":
        return {}
    theta = ca.SX.sym("theta")
    sides: list[Any] = [ca.SX(value) for side in coefficients(joint, theta) for value in side]
    both: Any = ca.cse([ca.densify(ca.vertcat(*sides))])
    return {"coefficients": ca.Function("coefficients", [theta], both)}


def _with_law(law: str) -> str:
    """The template with the law in its place."""
    lines = _TEMPLATE.read_text(encoding="utf-8").splitlines(keepends=True)
    start = next(i for i, line in enumerate(lines) if line.startswith("LAW"))
    return "".join([*lines[:start], _IMPORTS, law, *lines[start + 2 :]])


@cache
def _imported(text: str) -> ModuleType:
    """The module of this text, from the cache directory if it is there."""
    name = f"{KEPT}{sha256((text + _surroundings()).encode()).hexdigest()[:24]}"
    directory = _directory()
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    check_own(directory)
    file = directory / f"{name}.py"
    if not _holds(file, text):
        write_text(file, text)
    module = ModuleType(name)
    module.__file__ = str(file)
    sys.modules[name] = module  # numba looks for it there when it loads what it kept
    try:
        exec(compile(text, str(file), "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _holds(file: Path, text: str) -> bool:
    """Whether `file` is there and whole."""
    try:
        return file.read_bytes() == text.encode()
    except OSError:
        return False


@cache
def _surroundings() -> str:
    """All the project's code that may be compiled into a module."""
    files = [
        *sorted(Path(__file__).parent.glob("*.py")),
        *(Path(str(m.__file__)) for m in (kernels, compiled, jit, units)),
    ]
    return "".join(file.read_text(encoding="utf-8") for file in files)


def _directory() -> Path:
    """Where the user's programs keep what they can make again; an `OSError` if there is no such place.

    A relative XDG_CACHE_HOME counts as none, as the XDG Base Directory Specification asks.
    """
    given = {"win32": "LOCALAPPDATA", "darwin": ""}.get(sys.platform, "XDG_CACHE_HOME")
    below_home = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
    try:
        root = Path(os.environ.get(given, ""))
        return (root if root.is_absolute() else Path.home() / below_home) / "antagonist"
    except RuntimeError as error:
        raise FileNotFoundError(f"no directory to keep compiled code in: {error}") from None


__all__ = ["Law", "law"]
