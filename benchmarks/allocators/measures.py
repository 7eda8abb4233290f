"""Figures of one contender's answers to one set."""

from dataclasses import dataclass

import numpy as np

from benchmarks.allocators.contenders import Answer
from benchmarks.allocators.cost import beats, unproved
from benchmarks.allocators.effect import effect
from benchmarks.allocators.targets import Array, TargetSet

SAME = 1e-4  # of the supply range: tolerance of equal optima


@dataclass(frozen=True)
class Score:
    """One contender on one set. Shares are of all targets; errors of those with a feasible angle, without NaN."""

    set: str
    joint: str
    priority: str
    contender: str
    targets: int
    in_range: int  # targets with a feasible angle
    torque_reachable: int  # of them, those with a feasible torque within all limits
    within_limits: float  # share
    taut: float  # share
    nan: float  # share
    solver_failed: float  # share
    T_rms: float  # torque error [N·m]
    T_worst: float
    K_rms: float  # stiffness error [N·m/rad]
    K_worst: float
    T_rms_reachable: float  # the same with a feasible torque
    T_worst_reachable: float
    T_lost_reachable: float  # share of those targets that lose more than 1 % of the joint's greatest torque
    K_rms_reachable: float
    K_worst_reachable: float
    worse_than_exact: float  # share: with a higher cost and other pressures, a local optimum
    distance_to_exact: float  # greatest of the other answers that did not fail, in fractions of the supply range


def score(targets: TargetSet, priority: str, contender: str, answer: Answer, exact: Answer) -> Score:
    """Return the score of one contender's answers to a set."""
    found, apart, proved = effect(targets, answer), distance(targets, answer, exact), ~unproved(exact)
    worse = beats(targets, priority, exact, answer) & (apart > SAME) & proved
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
        worse_than_exact=float(worse.mean()),
        distance_to_exact=worst(apart[~worse & ~answer.failed & proved]),
    )


def distance(targets: TargetSet, answer: Answer, exact: Answer) -> Array:
    """Return the greater of the two pressure differences, in fractions of the supply range."""
    apart = np.maximum(np.abs(answer.P1 - exact.P1), np.abs(answer.P2 - exact.P2))
    return np.asarray(apart / targets.joint.pressure_span)


def torque_scale(targets: TargetSet) -> float:
    """Return the joint's greatest torque [N·m] within its limits and range."""
    joint, theta = targets.joint, np.linspace(*targets.joint.angle_range, 101)
    agonist, antagonist = joint.pressure_box(theta)
    return float(np.max(joint.torque(theta, agonist.hi, antagonist.lo)))


def rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(known(errors) ** 2)))


def worst(errors: Array) -> float:
    return float(np.max(known(errors)))


def known(errors: Array) -> Array:
    """Return the errors that are numbers; a single NaN if there are none."""
    numbers = errors[~np.isnan(errors)]
    return numbers if numbers.size else np.array([np.nan])
