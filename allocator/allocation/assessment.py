"""`assess` says what pressures achieve and which limits they meet, computed from the pressures alone."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.problem import Problem
from allocator.allocation.status import Status
from allocator.allocation.tolerances import CLOSED_FORM, Tolerance
from allocator.calculus import Array


class Assessment(NamedTuple):
    """An `Assessment` is the facts about n answers, each (n,)."""

    T: Array  # torque given [N·m]
    K: Array  # stiffness given [N·m/rad]
    status: NDArray[np.int8]
    limits: NDArray[np.int32]  # Limit flags


def assess(
    problem: Problem, P1: Array, P2: Array, outside: NDArray[np.int32], tolerance: Tolerance = CLOSED_FORM
) -> Assessment:
    """Assess feasible pressures; `outside` holds the Limit flag of angles that had to be moved into the joint range."""
    T, K = problem.given(P1, P2)
    T_scale, K_scale = problem.scales
    T_missed = np.abs(T - problem.T) > tolerance.met * T_scale
    K_missed = np.abs(K - problem.K) > problem.stiffness_tolerance + tolerance.met * K_scale
    status = T_missed * Status.TORQUE_LIMITED + K_missed * Status.STIFFNESS_LIMITED
    if problem.pull:
        status = np.where(T_missed | K_missed, Status.PULLED, status)
    status = np.where(problem.box.empty, Status.CONFLICT, status)
    status = np.where(problem.box.slack, Status.SLACK, status)
    status = np.where(outside != 0, Status.OUTSIDE_JOINT_RANGE, status)
    status = np.where(problem.box.unreachable, Status.OUTSIDE_LIMITS, status)
    limits = problem.box.binding(P1, P2, tolerance.binds * problem.joint.pressure_span) | outside
    return Assessment(T, K, status.astype(np.int8), limits)


def assess_inverse(problem: Problem, P1: Array, P2: Array, outside: NDArray[np.int32]) -> Assessment:
    """Assess the bare inverse, which knows no limits: `limits` are the ones that it breaks or lies on."""
    found = assess(problem, P1, P2, outside)
    near = CLOSED_FORM.binds * problem.joint.pressure_span
    allowed = problem.box.contains(P1, P2, near) & ~problem.box.empty & (outside == 0)
    status = np.where(allowed, Status.EXACT, Status.OUTSIDE_LIMITS)
    status = np.where(np.isnan(P1), Status.NO_INVERSE, status)
    return found._replace(status=status.astype(np.int8))


__all__ = ["Assessment", "assess", "assess_inverse"]
