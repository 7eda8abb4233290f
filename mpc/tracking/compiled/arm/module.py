"""Compiled functions of an arm: its formulas as a cached Python module, as in `mpc.tracking.compiled.module`."""

import ast
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.lazy import Function
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import IMPORTS, filling
from mpc.model.arm.compiled.module import compiled_motion
from mpc.model.arm.formulas import joint_svec
from mpc.model.arm.model import Arm

_STEP, _FEED_FORWARD = (Path(__file__).with_name(f"{name}.py") for name in ("step", "feedforward"))
_QP = Path(__file__).parents[1] / "structured_qp"
_OWN = "mpc.tracking.compiled.structured_qp", "mpc.tracking.compiled.commands"
_LIMITS = "sizes", "../commands"
_SOLUTION = (
    "sizes", "stage_of_many", "../commands", "riccati", "responses", "certificate", "active",
    "barrier_limits", "barrier_slacks", "barrier", "exchange",
    "solve", "../arm/solve",
)  # fmt: skip


class CompiledArm(NamedTuple):
    """Compiled functions for a family of arms, and the numbers of one arm."""

    step: ModuleType  # `mpc.tracking.compiled.arm.step` with the formulas
    feed_forward: ModuleType  # `mpc.tracking.compiled.arm.feedforward`, likewise
    c: Array
    h: float  # step of the integration [s]
    decay: Array  # (substeps, 3, m) remainder of a pressure's error at beginning, middle and end of each step


def compiled_arm(arm: Arm, dt: float) -> CompiledArm:
    """Return the compiled functions for `arm` at the sample time `dt` [s]."""
    motion = compiled_motion(arm, dt)
    sizes = f"n, m, STIFFNESSES = {arm.n}, {arm.m}, {arm.stiffnesses}"
    own = {_STEP: f"from {motion.module.__name__} import advance\n\n{_assembled(_LIMITS, arm)}", _FEED_FORWARD: sizes}
    texts, c = {file: f"{IMPORTS}{text}\n\n\n" for file, text in own.items()}, motion.c
    for name, function in _functions(arm).items():
        source = filling(name, function, c.size)
        texts[_FEED_FORWARD if name == "statics" else _STEP] += f"@inlined\n{source.text}\n\n"
        c = np.concatenate([c, source.c])
    step, feed_forward = (imported(with_formulas(template, text)) for template, text in texts.items())
    return CompiledArm(step, feed_forward, c, motion.h, motion.decay)


def solve_module(arm: Arm) -> ModuleType:
    """Return the compiled solution of the structured QP, which depends only on the sizes of the arm."""
    return imported(_assembled(_SOLUTION, arm))


def _assembled(names: Sequence[str], arm: Arm) -> str:
    """Return the text of these files of `structured_qp` for the sizes of the arm, which the first file contains."""
    first, sizes = "JOINTS, NU, STIFFNESSES = ", f"{arm.n}, {arm.m}, {arm.stiffnesses}"
    parts = [_without_own_imports(_QP / f"{name}.py") for name in names]
    lines = [f"{first}{sizes}\n" if line.startswith(first) else line for line in parts[0].splitlines(keepends=True)]
    return "\n\n".join(["".join(lines), *parts[1:]]).replace("@merged", "@inlined_flat")


def _without_own_imports(file: Path) -> str:
    """Return the text of a file without its docstring and its imports from the other files."""
    text = file.read_text(encoding="utf-8")
    lines, body = text.splitlines(keepends=True), ast.parse(text).body
    left_out = body[:1] + [n for n in body if isinstance(n, ast.ImportFrom) and (n.module or "").startswith(_OWN)]
    for node in left_out:
        for line in range(node.lineno - 1, node.end_lineno or node.lineno):
            lines[line] = ""
    return "".join(lines).strip("\n") + "\n"


def _functions(arm: Arm) -> dict[str, "Function"]:
    """Return the CasADi functions that the template lists."""
    import casadi as ca

    s, bodies, y = arm.statics, arm.bodies, arm.outputs
    omega, alpha = (ca.SX.sym(name, arm.n) for name in ("omega", "alpha"))
    held = [s.q, s.P]
    made = {"outputs": (held, [y]), "output_slopes": (held, [y, ca.jacobian(y, ca.vertcat(*held))])}
    if arm.mechanism.affine:  # else the feed-forward is not compiled
        stacked = ca.vertcat(s.torque, joint_svec(s))
        empty = ca.substitute([stacked, s.forces], [s.P], [ca.SX.zeros(arm.m)])
        gains = [ca.jacobian(stacked, s.P), ca.diag(ca.jacobian(s.forces, s.P))]
        given = [bodies.torque_for(s.q, omega, alpha), empty[0], gains[0], empty[1], gains[1]]
        made["statics"] = [s.q, omega, alpha], given
    return {
        name: ca.Function(name, given, ca.cse([ca.densify(ca.SX(value)) for value in values]))
        for name, (given, values) in made.items()
    }
