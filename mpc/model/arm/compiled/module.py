"""Compiled motion of an arm: its formulas as a cached Python module."""

from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.lazy import Function
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.text import IMPORTS, filling
from mpc.model.arm.formulas import pressure_functions
from mpc.model.arm.model import Arm
from mpc.model.experiment import RESOLUTION

_TEMPLATE = Path(__file__).with_name("motion.py")


class CompiledMotion(NamedTuple):
    """Compiled motion for a family of arms, and the numbers of one arm."""

    module: ModuleType  # `mpc.model.arm.compiled.motion` with the formulas
    c: Array
    h: float  # step of the integration [s]
    decay: Array  # (substeps, 3, m) remainder of a pressure's error at beginning, middle and end of each step


def moving(arm: Arm) -> int:
    """Return the number of states that are integrated: all with gas, (q, ω) without it."""
    return 2 * arm.n if arm.gas is None else arm.size


def compiled_motion(arm: Arm, dt: float, external: bool = False) -> CompiledMotion:
    """Return the compiled motion of `arm` over `dt` [s]; with `external` its Jacobian includes the slopes by the
    external torques. Raises `Untranslatable`.
    """
    sizes = f"n, m, MOVING, EXTERNAL = {arm.n}, {arm.m}, {moving(arm)}, {arm.n * external}"
    text, c = f"{IMPORTS}{sizes}\nCOLUMNS = 2 * n + 2 * m + EXTERNAL\n\n\n{_NO_GAS * (arm.gas is None)}", np.zeros(0)
    for name, function in _functions(arm).items():
        source = filling(name, function, c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    substeps = arm.substeps(dt, RESOLUTION)
    h = dt / substeps
    times = h * (np.arange(substeps)[:, None] + [0.0, 0.5, 1.0])
    return CompiledMotion(imported(with_formulas(_TEMPLATE, text)), c, h, np.exp(-times[..., None] / arm.lags))


_NO_GAS = """@inlined
def pressures(q, omega, P, u, c, rate):
    pass


@inlined
def pressure_slopes(q, omega, P, c, by_state, by_command):
    pass


"""


def _functions(arm: Arm) -> dict[str, "Function"]:
    """Return the CasADi functions that the template lists."""
    import casadi as ca

    s, bodies = arm.statics, arm.bodies
    omega, alpha, d = (ca.SX.sym(name, arm.n) for name in ("omega", "alpha", "d"))
    M, pushing = bodies.mass_matrix(s.q), s.torque - bodies.bias(s.q, omega)
    held = [s.q, omega, s.P]
    left = ca.jacobian(pushing - M @ alpha, ca.vertcat(*held))
    made = {"dynamics": ([*held, d], [M, pushing + d]), "dynamics_slopes": ([*held, alpha], [left])}
    for name, (given, found) in pressure_functions(arm).items():
        made[name] = list(given.values()), list(found.values())
    return {
        name: ca.Function(name, given, ca.cse([ca.densify(ca.SX(value)) for value in values]))
        for name, (given, values) in made.items()
    }
