"""`decide` computes the status of an allocation for a mechanism from the pressures."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import CLOSED_FORM, Status, decided
from allocator.calculus import Array, Mask
from allocator.joint.limits import Limit
from allocator.mechanism.problem import BoxProblem

_TRUSTED = 1e-7  # an answer with a greater optimality residual is a failure


class Verdict(NamedTuple):
    """A `Verdict` is what is found out about n answers, each (n,)."""

    status: NDArray[np.int8]
    torque_met: Mask
    stiffness_met: Mask
    holds: Mask  # whether K is positive definite


def decide(problem: BoxProblem, y: Array, K: Array, residual: Array) -> Verdict:
    """Decide the status of answers that give `y` (N, d) and `K` (N, n, n), with their optimality residuals (N,)."""
    n = problem.mechanism.n
    met = np.abs(y - problem.y) <= CLOSED_FORM.met * problem.y_scale
    torque_met = (met[:, :n] | (problem.weights[:n] == 0)).all(axis=1)
    stiffness_met = (met[:, n:] | (problem.weights[n:] == 0)).all(axis=1)
    holds = positive_definite(K)
    others = {
        Status.UNSTABLE: ~holds,
        Status.CONFLICT: np.any([side.empty for side in problem.box], axis=0),
        Status.SLACK: np.any([side.broken & Limit.AGONIST_SLACK != 0 for side in problem.box], axis=0),
        Status.OUTSIDE_JOINT_RANGE: problem.outside.any(axis=1) | problem.stretched.any(axis=1),
        Status.SOLVER_FAILED: ~(residual <= _TRUSTED),
        Status.OUTSIDE_LIMITS: np.any([side.unreachable for side in problem.box], axis=0),
    }
    status = decided(~torque_met, ~stiffness_met, problem.pull > 0, others)
    return Verdict(status, torque_met, stiffness_met, holds)


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
