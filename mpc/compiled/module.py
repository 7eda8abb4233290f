"""From a plant to compiled functions: its law as a Python module of its own, written once and found again.

numba keeps compiled code next to the file that it came from, so the module is written into the user's cache directory
under a name that is the hash of everything it is made from. Joints that differ in their numbers only share it.
"""

import os
import sys
import tempfile
from functools import cache
from hashlib import sha256
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from allocator import AntagonistJoint
from allocator.allocation import kernels
from allocator.allocation.compiled import register
from allocator.allocation.laws import coefficients, law_of
from allocator.calculus import Array
from allocator.units import BAR
from mpc.compiled.translate import translated
from mpc.integration import integrated
from mpc.plant import NU, NX, Plant

_IMPORTS = """import math

from allocator.allocation.kernels import affine_exact, tondu_exact


"""
_TEMPLATE = Path(__file__).with_name("step.py")


class Law(NamedTuple):
    """What is compiled for a family of plants, and the numbers of the plant."""

    module: ModuleType  # its functions `prepare` and `finish`
    c: Array
    p: tuple[Any, ...]  # of the kernel; empty if there is none
    substeps: int


def law(plant: Plant, dt: float) -> Law:
    """The compiled functions for `plant` at the sample time `dt` [s]."""
    substeps = plant.substeps(dt, RESOLUTION)
    text, c = "", np.zeros(0)
    for name, function in _functions(plant, dt / substeps).items():
        source = translated(name, function, c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    kernel = law_of(plant.joint)
    register()
    return Law(_imported(_with_law(text + _ALLOCATED[kernel.name])), c, kernel.p, substeps)


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


RESOLUTION = 0.5  # of the integration, as in `Plant.discrete`


def _functions(plant: Plant, h: float) -> dict[str, Any]:
    """CasADi functions of one step of `h` [s] and of the outputs (K, F1, F2), with and without derivatives."""
    import casadi as ca

    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    after: Any = integrated(lambda x: ca.vertcat(*plant.rate(x, BAR * u, d)), x, h, 1)
    y: Any = ca.vertcat(plant.stiffness(x), *plant.forces(x))
    slopes = [ca.densify(ca.jacobian(after, v)) for v in (x, u)]
    return {
        "stage": ca.Function("stage", [x, u, d], ca.cse([after, *slopes])),
        "outputs": ca.Function("outputs", [x], ca.cse([y, ca.densify(ca.jacobian(y, x))])),
        "advance": ca.Function("advance", [x, u, d], ca.cse([after])),
        "look": ca.Function("look", [x], ca.cse([y])),
        **_coefficients(plant.joint),
    }


def _coefficients(joint: AntagonistJoint) -> dict[str, Any]:
    """What the affine kernel wants to know of both muscles at an angle."""
    import casadi as ca

    if law_of(joint).name != "affine":
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
    name = f"antagonist_{sha256((text + _surroundings()).encode()).hexdigest()[:24]}"
    file = _directory() / f"{name}.py"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, suffix=".tmp", delete=False, encoding="utf-8") as new:
            new.write(text)
        os.replace(new.name, file)  # at once: another process may be about to read it
    spec = spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} cannot be imported")
    module = module_from_spec(spec)
    sys.modules[name] = module  # numba looks for it there when it loads what it kept
    spec.loader.exec_module(module)
    return module


@cache
def _surroundings() -> str:
    """The compiled functions that the module calls: numba does not see for itself when these change."""
    files = [*sorted(Path(__file__).parent.glob("*.py")), Path(kernels.__file__)]
    return "".join(file.read_text(encoding="utf-8") for file in files)


def _directory() -> Path:
    """Where the user's programs keep what they can make again."""
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "antagonist"


__all__ = ["Law", "law"]
