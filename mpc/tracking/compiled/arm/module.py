"""The module turns an arm into compiled functions: its formulas as a Python module, written once and found again.

As `mpc.tracking.compiled.module` does it for a joint.
"""

from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import filling
from mpc.model.arm.model import Arm
from mpc.model.experiment import RESOLUTION
from mpc.tracking.compiled.structured_qp.assembled import assembled, without_own_imports

_STEP, _FEED_FORWARD, _SOLVE = (Path(__file__).with_name(f"{name}.py") for name in ("step", "feedforward", "solve"))


class CompiledArm(NamedTuple):
    """A compiled arm is what is compiled for a family of arms, and the numbers of one."""

    step: ModuleType  # `mpc.tracking.compiled.arm.step` with the formulas
    feed_forward: ModuleType  # `mpc.tracking.compiled.arm.feedforward`, likewise
    c: Array
    h: float  # step of the integration [s]
    decay: Array  # (substeps, 3, m) what is left of a pressure's error at beginning, middle and end of each step


def compiled_arm(arm: Arm, dt: float) -> CompiledArm:
    """Return the compiled functions for `arm` at the sample time `dt` [s]."""
    sizes = f"import math\n\nn, m, STIFFNESSES, SIZE = {arm.n}, {arm.m}, {arm.stiffnesses}, {arm.size}\n\n\n"
    texts, c = {_STEP: sizes, _FEED_FORWARD: sizes}, np.zeros(0)
    for name, function in _functions(arm).items():
        source = filling(name, function, c.size)
        texts[_FEED_FORWARD if name == "statics" else _STEP] += f"@inlined\n{source.text}\n\n"
        c = np.concatenate([c, source.c])
    step, feed_forward = (imported(with_formulas(template, text)) for template, text in texts.items())
    substeps = arm.substeps(dt, RESOLUTION)
    h = dt / substeps
    times = h * (np.arange(substeps)[:, None] + [0.0, 0.5, 1.0])
    return CompiledArm(step, feed_forward, c, h, np.exp(-times[..., None] / arm.lags))


def solve_module(arm: Arm) -> ModuleType:
    """Return the solution of the structured QP, which depends on the sizes of the arm alone."""
    return imported(assembled(arm.n, arm.m, arm.stiffnesses) + "\n\n" + without_own_imports(_SOLVE))


def _functions(arm: Arm) -> dict[str, Any]:
    """Return the CasADi functions that the template lists."""
    import casadi as ca

    s, bodies, y = arm.statics, arm.bodies, arm.outputs
    omega, alpha, d = (ca.SX.sym(name, arm.n) for name in ("omega", "alpha", "d"))
    M, pushing = bodies.mass_matrix(s.q), s.torque - bodies.bias(s.q, omega)
    held = [s.q, omega, s.P]
    left = ca.jacobian(pushing - M @ alpha, ca.vertcat(*held))
    slope = ca.jacobian(y, ca.vertcat(s.q, s.P))
    stacked = ca.vertcat(s.torque, arm.joint_svec)
    empty = ca.substitute([stacked, s.forces], [s.P], [ca.SX.zeros(arm.m)])
    gains = [ca.jacobian(stacked, s.P), ca.diag(ca.jacobian(s.forces, s.P))]
    made = {
        "dynamics": ([*held, d], [M, pushing + d]),
        "dynamics_slopes": ([*held, alpha], [left]),
        "output_slopes": ([s.q, s.P], [y, slope]),
        "statics": (
            [s.q, omega, alpha],
            [bodies.torque_for(s.q, omega, alpha), empty[0], gains[0], empty[1], gains[1]],
        ),
    }
    return {
        name: ca.Function(name, given, ca.cse([ca.densify(ca.SX(value)) for value in values]))
        for name, (given, values) in made.items()
    }
