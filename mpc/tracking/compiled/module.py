"""Compiled functions of a plant: the template `step` with its parts, and the solution of the QP without formulas."""

from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from allocator.allocation.two_muscles import kernels as compiled
from allocator.allocation.two_muscles.kernels.choice import JointKernel, coefficients, kernel_of
from allocator.calculus import Array
from allocator.compilation.linked import INNER
from allocator.lazy import Function
from allocator.units import BAR
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.text import IMPORTS, translated
from mpc.model.experiment import RESOLUTION, variational
from mpc.model.plant import NU, NX, Plant
from mpc.tracking import resting

_KERNELS = """from allocator.allocation.two_muscles.kernels.source import affine_exact, tondu_exact
from mpc.codegen.jit import merged
from mpc.tracking.compiled.records import given_in, path_in, setting_in
from mpc.tracking.compiled.sample.views import SIZES


"""
STEP, _JOINT = (Path(__file__).with_name(f"{name}.py") for name in ("step", "joint"))
_SETTLE = Path(__file__).with_name("structured_qp") / "settle.py"


class CompiledPlant(NamedTuple):
    """Compiled functions for a family of plants or arms, and the numbers of one of them."""

    step: ModuleType  # `mpc.tracking.compiled.step` with the formulas
    c: Array
    p: Array  # numbers of the kernel; empty if there is none, and for an arm
    h: float  # step of the integration [s]
    substeps: int  # per sample
    decay: Array  # of an arm, see `mpc.model.arm.compiled.module`; empty for a joint

    def stiffness(self, K: Array) -> Array:
        """Return svec `K` (N + 1, …) in the form of a `Motion`: (N + 1,) for a joint."""
        return K if self.decay.size else K[:, 0]


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
    register_rest()
    numbers = ", ".join(f"int(p[{i}])" if isinstance(value, int) else f"p[{i}]" for i, value in enumerate(kernel.p))
    text += _ALLOCATED[kernel.name].format(numbers=numbers)
    step = imported(with_formulas(STEP, with_formulas(_JOINT, IMPORTS + _KERNELS + text)))
    return CompiledPlant(step, c, np.array(kernel.p, float), dt / substeps, substeps, np.zeros(0))


@cache
def register_rest() -> None:
    """Register the functions of the rest mode with numba; Python runs them unchanged."""
    for function in vars(resting).values():
        if isinstance(function, FunctionType) and function.__module__ == resting.__name__:
            register_jitable(error_model="numpy", _nrt=False, **INNER)(function)


def solve_module() -> ModuleType:
    """Return `mpc.tracking.compiled.structured_qp.settle`, which does not depend on the plant."""
    return imported(_SETTLE.read_text(encoding="utf-8"))


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


def _functions(plant: Plant) -> dict[str, "Function"]:
    """Return the CasADi functions that the template lists."""
    import casadi as ca

    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    rate = ca.SX(ca.vertcat(*plant.rate(x, BAR * u, d)))
    y = ca.vertcat(plant.stiffness(x), *plant.forces(x))
    gains = [side.torque_gain(x[2 + i]) for i, side in enumerate(plant.joint.sides(x[0]))]
    pressing = ca.vertcat(plant.pull(x), plant.isobaric(x), *gains)
    return {
        "rate": ca.Function("rate", [x, u, d], ca.cse([rate])),
        "variational": variational(x, [u, d], u, rate),
        "outputs": ca.Function("outputs", [x], ca.cse([y])),
        "output_slopes": ca.Function("output_slopes", [x], ca.cse([y, ca.densify(ca.jacobian(y, x))])),
        "expansion": ca.Function("expansion", [x], ca.cse([ca.densify(ca.SX(ca.vertcat(*plant.expansion(x))))])),
        "pressing": ca.Function("pressing", [x], ca.cse([ca.densify(pressing)])),
        **_coefficients(plant),
    }


def _kernel_of(plant: Plant) -> JointKernel:
    """Return the kernel for the plant's stiffness; if that is not isobaric, only affine muscles have one."""
    kernel = kernel_of(plant.joint)
    return kernel if plant.shares is None or kernel.name == "affine" else kernel._replace(name="", p=())


def _coefficients(plant: Plant) -> dict[str, "Function"]:
    """Return the CasADi function of the angle for the affine kernel's coefficients of both muscles, if it is used."""
    import casadi as ca

    if _kernel_of(plant).name != "affine":
        return {}
    theta = ca.SX.sym("theta")
    sides = [ca.SX(value) for side in coefficients(plant.joint, theta, plant.shares) for value in side]
    both = ca.cse([ca.densify(ca.vertcat(*sides))])
    return {"coefficients": ca.Function("coefficients", [theta], both)}


# --- derivatives along the motion, as scalars of one tuple y = (x, entries of S), which stays in registers -----------


def layout(variational: "Function") -> str:
    """Return the text of functions that begin y at a state, advance it along a slope, and end it."""
    places = list(zip(*variational.sparsity_in(1).get_triplet(), strict=True))
    states, M = [f"x[{i}]" for i in range(NX)], NX + len(places)
    slots = {(i, j): f"A[{i}, {j}]" if j < NX else f"B[{i}, {j - NX}]" for i in range(NX) for j in range(NX + NU)}
    values = dict.fromkeys(slots, "0.0") | {place: f"y[{NX + n}]" for n, place in enumerate(places)}
    ended = [f"{state} = y[{i}]" for i, state in enumerate(states)] + [f"{slots[at]} = {values[at]}" for at in slots]
    return _FUNCTIONS.format(
        begun=", ".join(states + ["1.0" if i == j else "0.0" for i, j in places]),
        advanced=", ".join(f"y[{i}] + a * slope[{i}]" for i in range(M)),
        ended="\n    ".join(ended),
    )


_FUNCTIONS = """@merged
def begun(x):
    return ({begun},)


@merged
def advanced(y, a, slope):
    return ({advanced},)


@merged
def ended(y, x, A, B):
    {ended}


"""
