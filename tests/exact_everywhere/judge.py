"""Errors of answers: beaten, refused, false status or interval.

Tolerances are fractions of the scales of an `Image`, the joint's greatest value at the angle plus the width of its
range. FIRST is far above rounding (1e-15) and far below any measurement. A level found to 1e-14 moves the second
quantity by 1e-7 where the first has an extreme in the box, dK/dP = 0, since 1e-14 is reached within √1e-14 of the
pressures: hence SECOND, and the more generous FLAT for targets beyond such an extreme.
"""

from typing import NamedTuple

import numpy as np

from allocator import Status, allocate

from .dense_search import Targets, search

FIRST = 1e-9
SECOND = 1e-6
FLAT = 1e-5
TIE = 1e-14  # first errors with a smaller difference are equal
MET = 1e-9  # the library's tolerance of a met target, of its scales
IN_BOX = 1e-9  # of the supply range
INTERVAL = 1e-7
WEIGHTS = (0.03, 1.0)  # [cost]/[N·m]², [cost]/[N·m/rad]²
PRIORITIES = ("torque", "stiffness", "weighted")


class Verdict(NamedTuple):
    """Flags and figures of n answers; all (n,)."""

    beaten: np.ndarray
    refused: np.ndarray  # reachable, but not answered EXACT
    false_status: np.ndarray
    outside: np.ndarray  # pressures that are not in the box
    unequalled: np.ndarray  # better than the dense search, which was not dense enough
    excess: np.ndarray  # excess of the first error (of a weighted cost its root), or else of the second


def asked(joint, reach, targets, priority):
    """Return the library's answers."""
    weights = WEIGHTS if priority == "weighted" else None
    return allocate(reach.theta[targets.row], targets.K, targets.T, joint=joint, priority=priority, weights=weights)


def judged(joint, reach, targets, priority, answer):
    """Compare answers with the dense search, which is skipped if both targets are met within the box."""
    row, (T, K) = targets.row, _given(joint, reach, targets.row, answer)
    errors = np.abs(T - targets.T), np.abs(K - targets.K)
    scales = reach.T_scale[row], reach.K_scale[row]
    relative = np.stack(errors) / np.stack(scales)  # (2, n)
    outside = ~_in_box(joint, reach, row, answer.P1, answer.P2)
    doubtful = np.flatnonzero(~(relative <= TIE).all(axis=0) | outside)
    found = search(joint, reach, targets.take(doubtful), priority, WEIGHTS)
    best = np.zeros_like(relative)
    best[:, doubtful] = np.stack([found.T_error, found.K_error]) / np.stack(scales)[:, doubtful]
    excess = np.where(np.isfinite(relative).all(axis=0), excess_of(relative, best, priority, scales), np.inf)
    unequalled = ~outside & (excess_of(best, relative, priority, scales) > 0)
    refused = (best < FIRST).all(axis=0) & (answer.status != Status.EXACT)
    status = _false_status(relative, answer.status)
    return Verdict(excess > 0, refused, status, outside, unequalled, np.maximum(excess, 0.0))


def _given(joint, reach, row, answer):
    """Return (T, K) at the answer's pressures, NaN for NaN."""
    there = np.isfinite(answer.P1) & np.isfinite(answer.P2)
    pressures = [np.where(there, P, lo[row]) for P, lo in zip((answer.P1, answer.P2), reach.lo, strict=True)]
    return [np.where(there, f(reach.theta[row], *pressures), np.nan) for f in (joint.torque, joint.stiffness)]


def _in_box(joint, reach, row, P1, P2):
    near = IN_BOX * joint.pressure_span
    inside = [
        (P >= lo[row] - near) & (P <= hi[row] + near) for P, lo, hi in zip((P1, P2), reach.lo, reach.hi, strict=True)
    ]
    return inside[0] & inside[1]


def excess_of(mine, best, priority, scales):
    """Return the advantage of the best answer; not positive unless it exceeds the tolerances."""
    if priority == "weighted":
        w = np.array(WEIGHTS)[:, None] * np.stack(scales) ** 2
        mine, best = (np.sqrt((w * e**2).sum(axis=0) / w.sum(axis=0)) for e in (mine, best))
        return np.where(mine - best > FIRST, mine - best, -1.0)
    order = [0, 1] if priority == "torque" else [1, 0]
    (first, second), (best_first, best_second) = mine[order], best[order]
    tolerance = np.where(best_first < FIRST, SECOND, FLAT)
    tied = (best_first <= first + TIE) & (second - best_second > tolerance)
    return np.where(first - best_first > FIRST, first - best_first, np.where(tied, second - best_second, -1.0))


def _false_status(relative, status):
    """Return whether a missed target is reported as met, or the reverse; near the library's tolerance both may be."""
    missed, met = relative > 100 * MET, relative < MET / 100
    says_missed = np.stack([np.isin(status, (1, 3)), np.isin(status, (2, 3))])  # torque, stiffness
    wrong = ((missed & ~says_missed) | (met & says_missed)).any(axis=0)
    return wrong | ~np.isin(status, (0, 1, 2, 3))


def false_intervals(joint, reach, targets, answer):
    """Return whether the interval of torque, or of stiffness at the answer's torque, differs from the dense search."""
    row, (one, two) = targets.row, reach.curves
    T_ends = np.stack([one.t.min(1) + two.t.min(1), one.t.max(1) + two.t.max(1)])[:, row]
    given = np.clip(np.nan_to_num(_given(joint, reach, row, answer)[0]), *T_ends)
    wrong = _differ(answer.torque_interval, T_ends, reach.T_scale[row])
    far = 10 * reach.K_scale[row]
    ends = []
    for K in (-far, far):
        found = search(joint, reach, Targets(row, given, K), "torque")
        ends.append(joint.stiffness(reach.theta[row], found.P1, found.P2))
    return wrong | _differ(answer.stiffness_interval, ends, reach.K_scale[row])


def _differ(interval, expected, scale):
    """Return whether ends differ, or are NaN or reversed."""
    (low, high), (expected_low, expected_high) = interval, expected
    same = (np.abs(low - expected_low) <= INTERVAL * scale) & (np.abs(high - expected_high) <= INTERVAL * scale)
    return ~(same & (low <= high + 1e-12 * scale))
