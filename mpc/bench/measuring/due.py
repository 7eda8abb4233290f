"""Hint that the muscles' strengths need a check, from the rests of a run.

At rest the disturbance torque d of an observer is the error of the model's torques T_1 > 0 > T_2,

    d = (g_1 - 1) T_1 + (g_2 - 1) T_2 + T_f + load ≈ (g_1 - g_2) (|T_1| + |T_2|)/2 + T_f + load

so that the ratio of the strengths shows without any excitation, up to friction, which stops a joint anywhere within its
loop. A common factor of both does not show; only `antagonist measure` can determine it.
"""

from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.felt import Loop
from allocator.units import DEG
from mpc.model.plant import NX, Plant
from mpc.trials.simulation import Run

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
