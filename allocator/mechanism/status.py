"""A `MechanismStatus` says what became of an allocation for a mechanism; `decide` computes it from the pressures."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.tolerances import CLOSED_FORM
from allocator.calculus import Array, Mask
from allocator.joint.limits import Limit
from allocator.mechanism.problem import MechanismProblem

_TRUSTED = 1e-7  # an answer with a greater optimality residual is a failure


class MechanismStatus(IntEnum):
    """A `MechanismStatus` is the outcome for a posture, of several that hold the last; `.advice` is a sentence on it.

    Names and numbers are those of `allocator.Status` where both have the meaning.
    """

    EXACT = 0
    TORQUE_LIMITED = 1
    STIFFNESS_LIMITED = 2
    BOTH_LIMITED = 3
    UNSTABLE = 4
    CONFLICT = 5
    SLACK = 6
    OUTSIDE_JOINT_RANGE = 7
    SOLVER_FAILED = 8
    OUTSIDE_LIMITS = 9

    @property
    def advice(self) -> str:
        """Return a sentence on what it means and what to do."""
        return _ADVICE[self]


_ADVICE = {
    MechanismStatus.EXACT: "torques and stiffness are met",
    MechanismStatus.TORQUE_LIMITED: "the torques cannot be met, these are the nearest; ask for less or relieve a limit",
    MechanismStatus.STIFFNESS_LIMITED: "the stiffness cannot be met, this is the nearest; ask for another one",
    MechanismStatus.BOTH_LIMITED: "neither torques nor stiffness can be met, this is the best trade for the priority",
    MechanismStatus.UNSTABLE: "the stiffness is not positive definite: the posture does not hold itself",
    MechanismStatus.CONFLICT: "the limits of a muscle contradict each other here; the supply was kept first",
    MechanismStatus.SLACK: "a muscle has no allowed pressure that pulls with the force that it needs to stay taut",
    MechanismStatus.OUTSIDE_JOINT_RANGE: "the posture is beyond the joints' range, or stretches a muscle too far",
    MechanismStatus.SOLVER_FAILED: "the answer is not proved to be optimal; try the other method or a greater gap",
    MechanismStatus.OUTSIDE_LIMITS: "the slew limit leaves a muscle no pressure inside the other limits",
}


class Verdict(NamedTuple):
    """A `Verdict` is what is found out about n answers, each (n,)."""

    status: NDArray[np.int8]
    torque_met: Mask
    stiffness_met: Mask
    holds: Mask  # whether K is positive definite


def decide(problem: MechanismProblem, y: Array, K: Array, residual: Array) -> Verdict:
    """Decide the status of answers that give `y` (N, d) and `K` (N, n, n), with their optimality residuals (N,)."""
    n = problem.mechanism.n
    met = np.abs(y - problem.y) <= CLOSED_FORM.met * problem.y_scale
    torque_met = (met[:, :n] | (problem.weights[:n] == 0)).all(axis=1)
    stiffness_met = (met[:, n:] | (problem.weights[n:] == 0)).all(axis=1)
    holds = positive_definite(K)
    status = ~torque_met * MechanismStatus.TORQUE_LIMITED + ~stiffness_met * MechanismStatus.STIFFNESS_LIMITED
    slack = np.any([side.broken & Limit.AGONIST_SLACK != 0 for side in problem.box], axis=0)
    for where, which in (
        (~holds, MechanismStatus.UNSTABLE),
        (np.any([side.empty for side in problem.box], axis=0), MechanismStatus.CONFLICT),
        (slack, MechanismStatus.SLACK),
        (problem.outside.any(axis=1) | problem.stretched.any(axis=1), MechanismStatus.OUTSIDE_JOINT_RANGE),
        (~(residual <= _TRUSTED), MechanismStatus.SOLVER_FAILED),
        (np.any([side.unreachable for side in problem.box], axis=0), MechanismStatus.OUTSIDE_LIMITS),
    ):
        status = np.where(where, which, status)
    return Verdict(status.astype(np.int8), torque_met, stiffness_met, holds)


def positive_definite(K: Array) -> Mask:
    """Return whether the symmetric matrices (N, n, n) are positive definite, by the pivots of their elimination."""
    left = np.array(K)
    floor = CLOSED_FORM.met * np.abs(K).max(axis=(1, 2))
    good = np.ones(len(K), bool)
    for i in range(K.shape[-1]):
        pivot = left[:, i, i]
        good &= pivot > floor
        column = left[:, i + 1 :, i] / np.where(good, pivot, 1.0)[:, None]
        left[:, i + 1 :, i + 1 :] -= column[:, :, None] * left[:, i, None, i + 1 :]
    return good
