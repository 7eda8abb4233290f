"""Compiled functions of an arm: its formulas as a cached Python module, as in `mpc.tracking.compiled.module`, and its
structured QP, solved sample by sample like a joint's.
"""

import ast
from collections.abc import Iterable
from functools import cache
from math import nan
from pathlib import Path
from types import ModuleType

import numpy as np

from allocator.lazy import Function
from allocator.units import BAR
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.text import IMPORTS, filling
from mpc.codegen.views import flat, in_python, length_of
from mpc.model.arm.compiled.module import compiled_motion, moving
from mpc.model.arm.formulas import falls, joint_svec
from mpc.model.arm.model import Arm
from mpc.model.friction.contact import loads_function
from mpc.tracking.compiled.arm.records import ArmAlong
from mpc.tracking.compiled.factory import setting
from mpc.tracking.compiled.module import STEP, CompiledPlant, register_rest
from mpc.tracking.compiled.records import Given
from mpc.tracking.compiled.sample.calls import address_of
from mpc.tracking.compiled.structured_qp.structured import SolvedQP, StructuredQP
from mpc.tracking.linearise import Linearisation
from mpc.tracking.qp.condense import TrackingProblem

_HERE = Path(__file__).parent
_PARTS, _FEED_FORWARD = _HERE / "step.py", _HERE / "feedforward.py"
_TRACKING = "mpc.tracking.compiled"
_OWN = tuple(
    f"{_TRACKING}.{name}" for name in ("structured_qp", "commands", "sample.views", "sample.stages", "arm.views")
)
_QP = _HERE.parent / "structured_qp"
_AROUND = "sizes", "stage_of_many", "../commands"
_SAMPLE = *_AROUND, "../sample/views", "../sample/stages", "../arm/views"
_BARRIER = "barrier_limits", "barrier"
_PROOF = "riccati", "responses", "certificate", "active", *_BARRIER, "exchange", "solve"
_SOLUTION = *_AROUND, *_PROOF, "../arm/views", "../arm/solve"


def compiled_arm(arm: Arm, dt: float) -> CompiledPlant:
    """Return the compiled functions for `arm` at the sample time `dt` [s]."""
    motion, feeds = compiled_motion(arm, dt), feeds_forward(arm)
    formulas, c = f"{IMPORTS}from {motion.module.__name__} import advance as move\n\n\n", motion.c
    for name, function in _functions(arm, feeds).items():
        source = filling(name, function, c.size)
        formulas, c = formulas + f"@inlined_flat\n{source.text}\n\n", np.concatenate([c, source.c])
    register_rest()
    parts = with_formulas(_PARTS, formulas) + (with_formulas(_FEED_FORWARD, "") if feeds else _NONE)
    step = imported(f"{_assembled(_SAMPLE, arm)}\n\n{_without_own_imports(with_formulas(STEP, parts))}")
    empty = np.zeros(0)
    return CompiledPlant(step, c, empty, motion.h, len(motion.decay), motion.decay.ravel())


def feeds_forward(arm: Arm) -> bool:
    """Return whether the feed-forward of `arm` is compiled: torques and stiffness are linear in the pressures."""
    return arm.mechanism.affine and arm.tracked == arm.n


def solve_module(arm: Arm) -> ModuleType:
    """Return the compiled solution of the structured QP, which depends only on the sizes of the arm."""
    return imported(_assembled(_SOLUTION, arm))


_NONE = """

@inlined_flat
def feed_forward(i, asked, K, d, found, moved):
    return False
"""


def _assembled(names: Iterable[str], arm: Arm) -> str:
    """Return the text of these files, by their way from `structured_qp`, for the sizes of the arm; the first file has
    the sizes.
    """
    first, sizes = "JOINTS, NU, STIFFNESSES, MOVING = ", f"{arm.n}, {arm.m}, {arm.stiffnesses}, {moving(arm)}"
    parts = [_without_own_imports((_QP / f"{name}.py").read_text(encoding="utf-8")) for name in names]
    lines = [f"{first}{sizes}\n" if line.startswith(first) else line for line in parts[0].splitlines(keepends=True)]
    return "\n\n".join(["".join(lines), *parts[1:]]).replace("@merged", "@inlined_flat")


@cache  # every copy of a controller asks for it
def _without_own_imports(text: str) -> str:
    """Return the text of a file without its docstring and its imports from files with sizes."""
    lines, body = text.splitlines(keepends=True), ast.parse(text).body
    left_out = body[:1] + [n for n in body if isinstance(n, ast.ImportFrom) and (n.module or "").startswith(_OWN)]
    for node in left_out:
        for line in range(node.lineno - 1, node.end_lineno or node.lineno):
            lines[line] = ""
    return "".join(lines).strip("\n") + "\n"


def _functions(arm: Arm, feeds: bool) -> dict[str, "Function"]:
    """Return the CasADi functions that the templates list."""
    import casadi as ca

    s, bodies, y, x = arm.statics, arm.bodies, arm.outputs, ca.SX.sym("x", arm.size)
    omega, alpha = (ca.SX.sym(name, arm.n) for name in ("omega", "alpha"))
    held = [s.q, s.P]
    made = {
        "outputs": (held, [y]),
        "output_slopes": (held, [y, ca.jacobian(y, ca.vertcat(*held))]),
        "pressing": ([x], [loads_function(arm)(x)]),
        "rigidity": (held, [s.stiffness, ca.jacobian(s.torque, s.P).T]),
    }
    if feeds:
        stacked = ca.vertcat(s.torque, joint_svec(s))
        empty = ca.substitute([stacked, s.forces], [s.P], [ca.SX.zeros(arm.m)])
        gains = [ca.jacobian(stacked, s.P), ca.diag(ca.jacobian(s.forces, s.P))]
        given = [bodies.torque_for(s.q, omega, alpha), empty[0], gains[0], empty[1], gains[1]]
        made["statics"] = [s.q, omega, alpha], given
        made["expansion"] = [s.q, omega, s.P], [falls(arm, omega)]
    return {
        name: ca.Function(name, given, ca.cse([ca.densify(ca.SX(value)) for value in values]))
        for name, (given, values) in made.items()
    }


class SizedQP(StructuredQP):
    """Structured QP of one controller of an arm; two threads must not use its arrays at the same time."""

    def __init__(self, arm: Arm, dt: float, problem: TrackingProblem) -> None:
        SolvedQP.__init__(self, problem, arm.m)
        module, N = solve_module(arm), sum(problem.blocks)
        self.problem, self._settle, self._stiffnesses = problem, module.settle_path, arm.stiffnesses
        given, buffer = (np.zeros(length_of(record, N, known=module.ARM)) for record in (Given, ArmAlong))
        self.given = in_python(module.given_in)(given)
        along: ArmAlong = in_python(module.path_in)(buffer)
        self._arm_path, self.u = along
        self._arm_path.kept[:] = np.exp(-dt / arm.lags)
        made = setting(problem, in_bar=True)
        self.arrays = flat(made), made.starts, given, buffer
        self.counted = np.zeros(1, np.int64)
        self._limit = np.isnan(flat(made._replace(exchanges=nan)))
        address_of(self._settle)  # compiles it

    @property
    def model(self) -> Linearisation:
        """Path as a linearisation of the readable step; copies."""
        (x, S, y, slope, kept), k = self._arm_path, self._stiffnesses
        (N, last, _), m, size = S.shape, kept.size, x.shape[1]
        A, B = np.zeros((N, size, size)), np.zeros((N, size, m))
        A[:, size - m :, size - m :], B[:, size - m :] = np.diag(kept), np.diag(1 - kept)
        A[:, :last], B[:, :last] = S[:, :, :size], S[:, :, size:]
        gradient = np.zeros((N + 1, y.shape[1], size))
        n = (size - m) // 2
        gradient[:, :, :n], gradient[:, :, 2 * n :] = slope[:, :n].swapaxes(1, 2), slope[:, n:].swapaxes(1, 2)
        outputs = y[:, :k].copy(), y[:, k:].copy(), A, B, gradient[:, :k], gradient[:, k:]
        return Linearisation(BAR * self.u, x.copy(), *outputs)
