"""What the pressures do to a real joint, and the figures that sum it up.

Everything is computed from the pressures by the muscle laws alone, at the angle where the joint stands: a cable whose
model force is negative is slack, so that it adds neither torque nor stiffness. Pressures are taken as they are: those
of the raw inverse that no valve can give are believed here, which flatters its errors; its clipped form shows them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.allocators.contenders import Answer
from benchmarks.allocators.targets import Array, Flags, TargetSet

ROUNDING = 1e-9  # of the supply range, and of the greatest force: beyond a limit by less is on it


class Effect(NamedTuple):
    """What pressures do; each (n,)."""

    T: Array  # [N·m]
    K: Array  # [N·m/rad]
    taut: Flags  # both cables
    within: Flags  # all limits


def effect(targets: TargetSet, answer: Answer) -> Effect:
    """Torque, stiffness and limits at the pressures; NaN gives NaN, not taut, not within."""
    joint, T, K = targets.joint, np.zeros(targets.K.shape), np.zeros(targets.K.shape)
    taut, within = np.ones(T.shape, bool), np.ones(T.shape, bool)
    (low, high), tolerance = joint.pressure_limits, ROUNDING * joint.pressure_span
    for side, P in zip(joint.sides(targets.reached), (answer.P1, answer.P2), strict=True):
        force = side.force(P)
        slack = force < -ROUNDING * np.abs(side.force(high)).max()
        T += np.where(slack, 0.0, side.torque(P))
        K += np.where(slack, 0.0, side.stiffness(P))
        taut &= ~slack & ~np.isnan(force)
        within &= (low - tolerance <= P) & (min(high, side.muscle.max_pressure) + tolerance >= P)
    return Effect(T, K, taut, within & taut)


@dataclass(frozen=True)
class Score:
    """One contender on one set. Shares are of all targets; errors of those whose angle can be had; NaN is left out."""

    set: str
    joint: str
    priority: str
    contender: str
    targets: int
    in_range: int  # targets whose angle can be had
    torque_reachable: int  # of them, those whose torque can be had within all limits
    within_limits: float  # share
    taut: float  # share
    nan: float  # share
    solver_failed: float  # share
    T_rms: float  # torque error [N·m]
    T_worst: float
    K_rms: float  # stiffness error [N·m/rad]
    K_worst: float
    T_rms_reachable: float  # the same where the torque can be had
    T_worst_reachable: float
    T_lost_reachable: float  # share of those targets at which more than 1 % of the joint's greatest torque is lost
    K_rms_reachable: float
    K_worst_reachable: float
    distance_to_exact: float  # greatest, in fractions of the supply range, where the back-end did not fail


def score(targets: TargetSet, priority: str, contender: str, answer: Answer, exact: Answer) -> Score:
    """Sum up one contender's answers to a set."""
    found = effect(targets, answer)
    e_T, e_K, reachable = np.abs(found.T - targets.T), np.abs(found.K - targets.K), targets.torque_reachable
    return Score(
        set=targets.name,
        joint=targets.joint_name,
        priority=priority,
        contender=contender,
        targets=targets.theta.size,
        in_range=int(targets.in_range.sum()),
        torque_reachable=int(reachable.sum()),
        within_limits=float(found.within.mean()),
        taut=float(found.taut.mean()),
        nan=float(np.isnan(answer.P1).mean()),
        solver_failed=float(answer.failed.mean()),
        T_rms=rms(e_T[targets.in_range]),
        T_worst=worst(e_T[targets.in_range]),
        K_rms=rms(e_K[targets.in_range]),
        K_worst=worst(e_K[targets.in_range]),
        T_rms_reachable=rms(e_T[reachable]),
        T_worst_reachable=worst(e_T[reachable]),
        T_lost_reachable=float((e_T[reachable] > 0.01 * torque_scale(targets)).mean()),
        K_rms_reachable=rms(e_K[reachable]),
        K_worst_reachable=worst(e_K[reachable]),
        distance_to_exact=worst(distance(targets, answer, exact)),
    )


def distance(targets: TargetSet, answer: Answer, exact: Answer) -> Array:
    """Greater of the two pressure differences, in fractions of the supply range; of answers that count."""
    apart = np.maximum(np.abs(answer.P1 - exact.P1), np.abs(answer.P2 - exact.P2)) / targets.joint.pressure_span
    counts = ~answer.failed & ~(np.zeros(apart.shape, bool) if exact.local is None else exact.local)
    return np.asarray(apart[counts])


def torque_scale(targets: TargetSet) -> float:
    """The joint's greatest torque [N·m] within its limits and range."""
    joint, theta = targets.joint, np.linspace(*targets.joint.angle_range, 101)
    agonist, antagonist = joint.pressure_box(theta)
    return float(np.max(joint.torque(theta, agonist.hi, antagonist.lo)))


def rms(errors: Array) -> float:
    return float(np.sqrt(np.nanmean(errors**2)))


def worst(errors: Array) -> float:
    return float(np.nanmax(errors))
