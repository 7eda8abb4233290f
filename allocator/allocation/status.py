"""A `Status` says what became of an allocation; `assess` decides it, from the pressures alone, with what they achieve.

The kernels decide in the same way (`verdict` in `allocator.allocation.kernels.source`). What only the method knows,
that a back-end failed or a risk is too great, `allocator.allocation.entry` puts in its place.
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.problem import Problem
from allocator.calculus import Array, Mask
from allocator.joint.limits import BINDS


class Status(IntEnum):
    """Outcome of an allocation. If several apply, the last one is given. `.advice` explains it in a sentence.

    UNSTABLE is said of mechanisms; NO_INVERSE, TOO_RISKY and HEDGED of one joint and two muscles.
    """

    EXACT = 0
    TORQUE_LIMITED = 1
    STIFFNESS_LIMITED = 2
    BOTH_LIMITED = 3
    PULLED = 4
    UNSTABLE = 5
    CONFLICT = 6
    SLACK = 7
    OUTSIDE_JOINT_RANGE = 8
    SOLVER_FAILED = 9
    OUTSIDE_LIMITS = 10
    NO_INVERSE = 11
    TOO_RISKY = 12
    HEDGED = 13

    @property
    def advice(self) -> str:
        """Return a sentence on what it means and what to do."""
        return _ADVICE[self]


_ADVICE = {
    Status.EXACT: "torque and stiffness are met",
    Status.TORQUE_LIMITED: "the torque cannot be met, this is the nearest; ask for less or relieve a limit",
    Status.STIFFNESS_LIMITED: "the stiffness cannot be met, this is the nearest; choose one inside its interval",
    Status.BOTH_LIMITED: "neither torque nor stiffness can be met, this is the best trade for the priority",
    Status.PULLED: "the pull towards the reference pressures keeps the answer off the targets",
    Status.UNSTABLE: "the stiffness is not positive definite: the posture does not hold itself",
    Status.CONFLICT: "the limits contradict each other here; the supply was kept first, then ceilings, then floors",
    Status.SLACK: "no allowed pressures pull all cables with the force that they need to stay taut",
    Status.OUTSIDE_JOINT_RANGE: (
        "the posture is beyond the joint range, answered at the nearest one inside, or stretches a muscle too far"
    ),
    Status.SOLVER_FAILED: "no answer was proved to be optimal; this is the best of them, or the exact one",
    Status.OUTSIDE_LIMITS: "a limit is broken: the slew limit leaves nothing inside, or only the inverse was asked for",
    Status.NO_INVERSE: "no pressures give this torque and stiffness",
    Status.TOO_RISKY: "no pressures keep the force limits with that probability; answered as if nothing were uncertain",
    Status.HEDGED: "the limits' probabilities and the spread of the error keep the mean off the targets",
}


def status_names(codes: NDArray[np.int8]) -> NDArray[np.str_]:
    """Return the names (…) of statuses that are given as integers (…)."""
    return np.array([status.name for status in Status])[codes]


def decided(T_missed: Mask, K_missed: Mask, pulled: bool, others: Mapping[Status, Mask]) -> NDArray[np.int8]:
    """Return the statuses (n,) of targets that are missed or met; of `others` that hold as well, the last."""
    status = T_missed * Status.TORQUE_LIMITED + K_missed * Status.STIFFNESS_LIMITED
    if pulled:
        status = np.where(status > 0, Status.PULLED, status)
    for other, holds in others.items():
        status = np.maximum(status, np.where(holds, other, Status.EXACT))
    return status.astype(np.int8)


class Tolerance(NamedTuple):
    """A `Tolerance` is what counts as met and as binding."""

    met: float  # of the torque or stiffness scale: a target missed by less is met
    binds: float  # of the supply range: a pressure nearer to a bound lies on it


CLOSED_FORM = Tolerance(met=1e-9, binds=BINDS)
OPTIMISER = Tolerance(met=1e-6, binds=1e-7)
UNCERTAIN = Tolerance(met=1e-6, binds=1e-6)  # of cone programmes


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
    others = {
        Status.CONFLICT: problem.box.empty,
        Status.SLACK: problem.box.slack,
        Status.OUTSIDE_JOINT_RANGE: outside != 0,
        Status.OUTSIDE_LIMITS: problem.box.unreachable,
    }
    limits = problem.box.binding(P1, P2, tolerance.binds * problem.joint.pressure_span) | outside
    return Assessment(T, K, decided(T_missed, K_missed, problem.pull > 0, others), limits)


def assess_inverse(problem: Problem, P1: Array, P2: Array, outside: NDArray[np.int32]) -> Assessment:
    """Assess the bare inverse, which knows no limits: `limits` are the ones that it breaks or lies on."""
    found = assess(problem, P1, P2, outside)
    near = CLOSED_FORM.binds * problem.joint.pressure_span
    allowed = problem.box.contains(P1, P2, near) & ~problem.box.empty & (outside == 0)
    status = np.where(allowed, Status.EXACT, Status.OUTSIDE_LIMITS)
    status = np.where(np.isnan(P1), Status.NO_INVERSE, status)
    return found._replace(status=status.astype(np.int8))
