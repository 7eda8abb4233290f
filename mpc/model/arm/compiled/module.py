"""Compiled motion of an arm: its formulas as a cached Python module."""

from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.lazy import Function
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.text import IMPORTS, filling
from mpc.model.arm.model import Arm
from mpc.model.experiment import RESOLUTION

_TEMPLATE = Path(__file__).with_name("motion.py")


class CompiledMotion(NamedTuple):
    """Compiled motion for a family of arms, and the numbers of one arm."""

    module: ModuleType  # `mpc.model.arm.compiled.motion` with the formulas
    c: Array
    h: float  # step of the integration [s]
    decay: Array  # (substeps, 3, m) remainder of a pressure's error at beginning, middle and end of each step


def compiled_motion(arm: Arm, dt: float, external: bool = False) -> CompiledMotion:
    """Return the compiled motion of `arm` over `dt` [s]; with `external` its Jacobian includes the slopes by the
    external torques. Raises `Untranslatable`.
    """
    sizes = f"n, m, EXTERNAL = {arm.n}, {arm.m}, {arm.n * external}\nCOLUMNS = 2 * n + 2 * m + EXTERNAL"
    text, c = f"{IMPORTS}{sizes}\n\n\n", np.zeros(0)
    for name, function in _functions(arm).items():
        source = filling(name, function, c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    substeps = arm.substeps(dt, RESOLUTION)
    h = dt / substeps
    times = h * (np.arange(substeps)[:, None] + [0.0, 0.5, 1.0])
    return CompiledMotion(imported(with_formulas(_TEMPLATE, text)), c, h, np.exp(-times[..., None] / arm.lags))


def _functions(arm: Arm) -> dict[str, "Function"]:
    """Return the CasADi functions that the template lists."""
    import casadi as ca

    s, bodies = arm.statics, arm.bodies
    omega, alpha, d = (ca.SX.sym(name, arm.n) for name in ("omega", "alpha", "d"))
    M, pushing = bodies.mass_matrix(s.q), s.torque - bodies.bias(s.q, omega)
    held = [s.q, omega, s.P]
    left = ca.jacobian(pushing - M @ alpha, ca.vertcat(*held))
    made = {"dynamics": ([*held, d], [M, pushing + d]), "dynamics_slopes": ([*held, alpha], [left])}
    return {
        name: ca.Function(name, given, ca.cse([ca.densify(ca.SX(value)) for value in values]))
        for name, (given, values) in made.items()
    }
