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

`check_due` gives a hint that the strengths need a check, from the rests of a run. At rest the disturbance torque d of
an observer is the error of the model's torques T_1 > 0 > T_2,

    d = (g_1 - 1) T_1 + (g_2 - 1) T_2 + T_f + load ≈ (g_1 - g_2) (|T_1| + |T_2|)/2 + T_f + load

so that the ratio of the strengths shows without any excitation, up to friction, which stops a joint anywhere within its
loop. A common factor of both does not show; only `antagonist measure` can determine it.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import section
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.felt import Loop
from allocator.machine_file import load_joint, muscle_text
from allocator.muscles.strength import scaled, strength_powers
from allocator.units import DEG
from mpc.bench.measuring.result import MeasuredStiffness
from mpc.model.plant import NX, Plant
from mpc.trials.simulation import Run

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


_LEAST_REST = 0.8  # [s] of a constant reference
_STILL = 0.3 * DEG  # range of the angle during the half of a rest that counts
_WIDE = 20 * DEG  # amplitude at which nearly all of a loop slips
_LEAST = 0.04  # of a muscle's torque, below which nothing is due
_SURE = 2.0  # standard deviations
_ROUNDING = 1e-9  # of a reference that rests
_SENSORS = 0.01  # of a muscle's torque: offsets of pressure sensors


class Imbalance(NamedTuple):
    """Difference of the strengths that rests show, if no load acts."""

    ratio: float  # g_1 - g_2 [-]
    std: float
    torque: float  # mean d [N·m]
    rests: int


def imbalance(run: Run, loop: Loop | None = None) -> Imbalance | None:
    """Return the imbalance at the rests of a joint's run; None without a rest or an estimated torque.

    `loop` is the hysteresis of the joint, by default that of the model.
    """
    if not isinstance(run.plant, Plant) or run.estimate.shape[1] <= NX:
        return None
    rows = [row for part in _rests(run) if (row := _row(run, part)) is not None]
    if not rows:
        return None
    d, size, K, pull, filled = np.array(rows).T
    ratio = float(d @ size / (size @ size))
    secant = (run.plant.joint.loop if loop is None else loop).secant(_WIDE)
    friction = float(np.mean(secant.work(K, pull, filled))) / (4 * _WIDE)
    scatter = float(np.std(d - ratio * size))
    std = sqrt((friction**2 / 3 + scatter**2) / len(rows)) / float(size.mean())
    return Imbalance(ratio, sqrt(std**2 + _SENSORS**2), float(d.mean()), len(rows))


def check_due(run: Run, loop: Loop | None = None) -> str:
    """Return a sentence that a check of the strengths is due, or ""; arguments as of `imbalance`."""
    found = imbalance(run, loop)
    if found is None or abs(found.ratio) < max(_LEAST, _SURE * found.std):
        return ""
    stronger = "agonist" if found.ratio > 0 else "antagonist"
    return (
        f"a check is due: at rest the torques of both muscles disagree by {100 * abs(found.ratio):.0f} ± "
        f"{100 * found.std:.0f} %, so that the {stronger} pulls harder than its model by comparison, or a load of "
        f"{found.torque:+.2g} N·m acts; `antagonist measure` tells"
    )


def _rests(run: Run) -> list[slice]:
    """Return the second halves of the times at which the reference rests."""
    moves = np.any([np.abs(np.diff(a)) > _ROUNDING * np.abs(a).max() for a in (run.theta_ref, run.K_ref)], axis=0)
    ends = np.flatnonzero(np.r_[True, moves, True])
    least = _LEAST_REST / run.dt
    return [slice((a + b) // 2, b) for a, b in pairwise(ends.tolist()) if b - a >= least]


def _row(run: Run, part: slice) -> tuple[float, ...] | None:
    """Return (d, size of a muscle's torque, K, pull, P1 + P2) of a rest; None if the joint moves."""
    estimate: Array = run.estimate[part]
    if not np.isfinite(estimate).all() or np.ptp(estimate[:, 0]) > _STILL:
        return None
    x = estimate[:, :NX].mean(axis=0)
    pull = float(run.plant.pull(x))
    return float(estimate[:, NX].mean()), pull / 2, float(run.plant.isobaric(x)), pull, float(x[2] + x[3])
