"""Measured strengths, written into the file of a joint: everything else in it is kept, and its history grows.

The muscles pull g_i times as hard afterwards. The covariance of the joint's parameters x, of which those that scale the
force go with g^n (`allocator.muscles.strength`), becomes

    C' = D C D + G C_g Gᵀ,      D = diag(g^n),   G = ∂x/∂g

with C of the file (zero without one) and C_g of the measurement. C may already include the error of the scale, so that
C' tends to be too large. Every measurement adds a table to the file:

[[measured]]                   # ignored when loading
date = "2026-11-24T12:00:00"
theta = 0.1                    # [rad]
pressures = [310000.0, …]      # [Pa]
inertia = 0.05                 # [kg·m²], as given
strengths = [1.06, 0.93]       # relative to the file before
strengths_std = [0.01, 0.01]
stiffness_before = 5.9         # backbone K about theta, by the file before and after [N·m/rad]
stiffness_after = 6.1
stiffness_measured = 6.2       # the same, as measured; strengths do not change the shape of a force law
stiffness_std = 0.3
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.linalg import block_diag

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import section
from allocator.joint.antagonist import AntagonistJoint
from allocator.machine_file import load_joint, muscle_text
from allocator.muscles.strength import scaled, strength_powers
from mpc.bench.measuring.result import MeasuredStiffness

_HEADER = re.compile(r"\s*\[\[?\s*([A-Za-z_][A-Za-z_0-9-]*)")
_REPLACED = ("muscle", "covariance")


def combined(found: Sequence[MeasuredStiffness], inertia_error: float = 0.0) -> tuple[Array, Array]:
    """Return the strengths (2,) and their covariance (2, 2) of measurements about several rests.

    The inertia's relative error is common to all of them. If they scatter by more than their errors, the covariance
    grows. Raises `InvalidInput` if none was successful.
    """
    there = [m for m in found if m.success]
    if not there:
        raise InvalidInput("nothing was measured; the joint's file stays as it is")
    g = np.array([m.strengths for m in there])
    common = inertia_error**2 * np.outer(g.mean(0), g.mean(0))
    weights = [np.linalg.inv(m.covariance - 0.999 * common) for m in there]
    C = np.linalg.inv(np.sum(weights, axis=0))
    mean = C @ np.sum([W @ row for W, row in zip(weights, g, strict=True)], axis=0)
    chi = sum(float((row - mean) @ W @ (row - mean)) for W, row in zip(weights, g, strict=True))
    return mean, C * max(1.0, chi / max(2 * (len(there) - 1), 1)) + common


def strengthened(joint: AntagonistJoint, strengths: Array, covariance: Array) -> AntagonistJoint:
    """Return the joint with the forces of its muscles times `strengths`, and its covariance with theirs.

    Raises `InvalidInput` for a model without a scale of force, and for strengths that are not positive.
    """
    muscles = [scaled(m, float(g)) for m, g in zip((joint.agonist, joint.antagonist), strengths, strict=True)]
    D, G = [], np.zeros((sum(len(m.parameters) for m in muscles), 2))
    start = 0
    for i, (muscle, g) in enumerate(zip(muscles, strengths, strict=True)):
        powers, x = strength_powers(muscle), np.array(list(muscle.parameters.values()))
        D.append(g**powers)
        G[start : start + x.size, i] = powers * x / g
        start += x.size
    before, scale = _covariance(joint), np.concatenate(D)
    C = scale[:, None] * before * scale + G @ covariance @ G.T
    agonist, antagonist = muscles
    rows = tuple(tuple(row) for row in ((C + C.T) / 2).tolist())
    return replace(joint, agonist=agonist, antagonist=antagonist, covariance=rows)


def _covariance(joint: AntagonistJoint) -> Array:
    """Return the covariance of all parameters; zero for those without one."""
    if joint.covariance is not None:
        return np.array(joint.covariance)
    if joint.agonist == joint.antagonist and joint.agonist.covariance is not None:  # one law, whose errors are common
        return np.asarray(np.kron(np.ones((2, 2)), joint.agonist.covariance), float)
    each = [
        np.zeros((len(m.parameters),) * 2) if m.covariance is None else np.array(m.covariance)
        for m in (joint.agonist, joint.antagonist)
    ]
    return np.asarray(block_diag(*each))


def update(
    path: FilePath, found: Sequence[MeasuredStiffness], inertia: float, inertia_error: float = 0.0, now: str = ""
) -> AntagonistJoint:
    """Write the measured strengths into the file of a joint, and return the updated joint.

    Raises `InvalidInput` if nothing was measured, `InvalidFile` if the file has no joint, and `CannotWrite`.
    """
    before = load_joint(path)
    strengths, covariance = combined(found, inertia_error)
    after = strengthened(before, strengths, covariance)
    text = Path(path).read_text(encoding="utf-8-sig")
    changed = _exchanged(text, after) + "".join(
        "\n".join(section("[measured]", _entry(m, before, after, inertia, now))) + "\n" for m in found if m.success
    )
    with TemporaryDirectory() as directory:  # a file that could not be read again is not written
        draft = Path(directory) / "joint.toml"
        draft.write_text(changed, encoding="utf-8")
        loaded = load_joint(draft)
    write_text(path, changed)
    return loaded


def _entry(
    m: MeasuredStiffness, before: AntagonistJoint, after: AntagonistJoint, inertia: float, now: str
) -> dict[str, object]:
    at = m.theta, *m.pressures
    return {
        "date": now or datetime.now().replace(microsecond=0).isoformat(),
        "theta": m.theta,
        "pressures": tuple(m.pressures),
        "inertia": inertia,
        "strengths": tuple(m.strengths),
        "strengths_std": tuple(m.strengths_std),
        "stiffness_before": float(before.stiffness(*at)),
        "stiffness_after": float(after.stiffness(*at)),
        "stiffness_measured": m.K,
        "stiffness_std": m.K_std,
    }


def _exchanged(text: str, joint: AntagonistJoint) -> str:
    """Return the text of a joint's file with the muscles and the covariance of `joint`; the rest stays."""
    kept: list[str] = []
    name, written = "", False
    for line in text.splitlines(keepends=True):
        if header := _HEADER.match(line):
            name = header.group(1)
        if name not in _REPLACED:
            kept.append(line)
        elif not written:
            kept.append(muscle_text(joint))
            written = True
    body = "".join(kept)
    return body if body.endswith("\n") else body + "\n"
