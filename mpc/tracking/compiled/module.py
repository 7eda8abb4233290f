"""Compiled functions of a plant: its formulas in the template `step`, and the solution of the QP, which has none."""

from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.kernels import compiled
from allocator.allocation.kernels.choice import JointKernel, coefficients, kernel_of
from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import translated
from mpc.model.experiment import RESOLUTION
from mpc.model.plant import NU, NX, Plant
from mpc.tracking.compiled.variational import layout, variational

_IMPORTS = """import math

from allocator.allocation.kernels.source import affine_exact, tondu_exact
from mpc.codegen.jit import merged


"""
_TEMPLATE = Path(__file__).with_name("step.py")
_SOLVE = Path(__file__).with_name("structured_qp") / "solve.py"


class CompiledPlant(NamedTuple):
    """A compiled plant is what is compiled for a family of plants, and the numbers of the plant."""

    step: ModuleType  # `mpc.tracking.compiled.step` with the formulas
    c: Array
    p: Array  # those of the kernel; empty if there is none
    h: float  # step of the integration [s]
    substeps: int  # a sample


def compiled_plant(plant: Plant, dt: float) -> CompiledPlant:
    """Return the compiled functions for `plant` at the sample time `dt` [s]."""
    substeps = plant.substeps(dt, RESOLUTION)
    functions, c = _functions(plant), np.zeros(0)
    text = layout(functions["variational"])
    for name, function in functions.items():
        source = translated(name, function, c.size)
        text, c = text + f"@merged\n{source.text}\n\n", np.concatenate([c, source.c])
    kernel = _kernel_of(plant)
    compiled.register()
    numbers = ", ".join(f"int(p[{i}])" if isinstance(value, int) else f"p[{i}]" for i, value in enumerate(kernel.p))
    step = imported(with_formulas(_TEMPLATE, _IMPORTS + text + _ALLOCATED[kernel.name].format(numbers=numbers)))
    return CompiledPlant(step, c, np.array(kernel.p, float), dt / substeps, substeps)


def solve_module() -> ModuleType:
    """Return `mpc.tracking.compiled.structured_qp.solve`, which does not depend on the plant."""
    return imported(_SOLVE.read_text(encoding="utf-8"))


_ALLOCATED = {
    "tondu": """
@inlined_flat
def allocated(theta, K, T, p, left, right, min_force, c):
    return tondu_exact(theta, K, T, ({numbers}), min_force)


""",
    "affine": """
@inlined_flat
def allocated(theta, K, T, p, left, right, min_force, c):
    o = coefficients(min(max(theta, left), right), c)
    one, two = (o[0], o[1], o[2], o[3], o[4]), (o[5], o[6], o[7], o[8], o[9])
    return affine_exact(theta, K, T, one, two, ({numbers}), min_force)


""",
    "": """
@inlined_flat
def allocated(theta, K, T, p, left, right, min_force, c):
    return 0.0, 0.0, T, K, 0, 0, False


""",
}


def _functions(plant: Plant) -> dict[str, Any]:
    """Return the CasADi functions that the template lists."""
    import casadi as ca

    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    rate: Any = ca.vertcat(*plant.rate(x, BAR * u, d))
    y: Any = ca.vertcat(plant.stiffness(x), *plant.forces(x))
    return {
        "rate": ca.Function("rate", [x, u, d], ca.cse([rate])),
        "variational": variational(x, u, d, rate),
        "outputs": ca.Function("outputs", [x], ca.cse([y])),
        "output_slopes": ca.Function("output_slopes", [x], ca.cse([y, ca.densify(ca.jacobian(y, x))])),
        "expansion": ca.Function("expansion", [x], ca.cse([ca.densify(ca.SX(ca.vertcat(*plant.expansion(x))))])),
        "pressing": ca.Function("pressing", [x], ca.cse([ca.densify(ca.vertcat(plant.pull(x), plant.isobaric(x)))])),
        **_coefficients(plant),
    }


def _kernel_of(plant: Plant) -> JointKernel:
    """Return the kernel that allocates the plant's stiffness; if that is not isobaric only affine muscles have one."""
    kernel = kernel_of(plant.joint)
    return kernel if plant.shares is None or kernel.name == "affine" else kernel._replace(name="", p=())


def _coefficients(plant: Plant) -> dict[str, Any]:
    """Return what the affine kernel takes of both muscles at an angle, a CasADi function, if it is the joint's."""
    import casadi as ca

    if _kernel_of(plant).name != "affine":
        return {}
    theta = ca.SX.sym("theta")
    sides: list[Any] = [ca.SX(value) for side in coefficients(plant.joint, theta, plant.shares) for value in side]
    both: Any = ca.cse([ca.densify(ca.vertcat(*sides))])
    return {"coefficients": ca.Function("coefficients", [theta], both)}
