"""Status and certificate of an answer, from its pressures: optimality residual, or a separating direction.

**Optimal.** At level k, with multipliers μ of the rows of the earlier levels, G = A_kᵀ(A_k x - b_k) + Σ A_iᵀμ_i must
vanish where x is inside its bounds, and -G must not point inside where x is at a bound, unless an earlier level holds
it there. This proves the level, whichever solver found the μ. The violation, in fractions of its scale, is the residual
(`allocator.allocation.box.kernel.batch`).

**Beyond reach.** If d·y(P) < d·y* for all P of the box, no pressures give y*. For affine muscles the greatest d·y(P) is
d·y0 + Σ_j max(d·M_j lo_j, d·M_j hi_j), which anyone can check. The first level that is missed gives d = -W(residual,
with its multipliers). For other muscles d·y(P) is a sum of functions of single pressures, bounded by polygons around
their curves (`relaxation.furthest`). Such muscles may miss a target that no d separates: the lower bound of the cost is
then the proof. For an endpoint d is transformed to (τ, K); with more joints than coordinates many K give the requested
stiffness, and all of them have d·y ≥ asked.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation import relaxation
from allocator.allocation.box.problem import BoxProblem, positive_definite
from allocator.allocation.status import CLOSED_FORM, Status, decided
from allocator.calculus import Array, Mask, Value

_TRUSTED = 1e-7  # an answer with a greater optimality residual is a failure


class Separation(NamedTuple):
    """Proof that targets are out of reach: d·y(P) ≤ reach < asked = d·y* for all P of the box.

    Its components are NaN for targets that are met.
    """

    direction: Array  # d (…, d), in the order of a `TargetsMap`, its greatest component 1
    reach: Value  # (…) the greatest d·y(P)
    asked: Value  # (…) d·y*


def separation(problem: BoxProblem, mu: Array) -> Separation:
    """Return the direction (N, d), `reach` (N,) and `asked` (N,) of each target."""
    (_, ends), (lo, hi) = problem.rows, problem.bounds
    d = np.zeros(problem.y.shape)
    begin, found = 0, np.zeros(problem.size, bool)
    for k, end in enumerate(ends.tolist()):
        first = ~found & (mu[:, k, begin:end] != 0).any(axis=1)
        d[first] = problem.direction(mu[first, k, :end])
        begin, found = end, found | first
    d /= np.abs(d).max(axis=1, where=found[:, None], initial=0.0)[:, None] + ~found[:, None]
    if problem.mechanism.affine:
        dM = problem.by_posture(problem.map.M, d)  # (N, m)
        reach = (d * problem.map.y0).sum(axis=1) + np.maximum(dM * lo, dM * hi).sum(axis=1)
    else:
        reach = relaxation.furthest(problem, d)
    asked = (d * problem.y).sum(axis=1)
    proved = found & (reach < asked)
    if problem.endpoint is not None:
        proved &= problem.endpoint.bounds_true(d)
        d, shift = problem.endpoint.on_joints(d)
        size = np.abs(d).max(axis=1) + ~found
        d, reach, asked = d / size[:, None], (reach - shift) / size, (asked - shift) / size
    return Separation(*(np.where(proved.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in (d, reach, asked)))


class Verdict(NamedTuple):
    """Status and residual of n answers, each (n,)."""

    status: NDArray[np.int8]
    torque_met: Mask
    stiffness_met: Mask
    holds: Mask  # whether K without hysteresis is positive definite


def decide(problem: BoxProblem, y: Array, K: Array, residual: Array) -> Verdict:
    """Decide the status of answers that give `y` (N, d) and `K` (N, n, n), with their optimality residuals (N,)."""
    n = problem.mechanism.n
    met = np.abs(y - problem.y) <= CLOSED_FORM.met * problem.y_scale
    torque_met = (met[:, :n] | (problem.weights[:n] == 0)).all(axis=1)
    stiffness_met = (met[:, n:] | (problem.weights[n:] == 0)).all(axis=1)
    holds = positive_definite(problem.backbone(K))
    others = {
        Status.UNSTABLE: ~holds,
        Status.SOLVER_FAILED: ~(residual <= _TRUSTED),
    }
    outside = np.asarray(problem.outside.any(axis=1) | problem.stretched.any(axis=1))
    status = decided(~torque_met, ~stiffness_met, problem.pull > 0, problem.box, outside, others)
    return Verdict(status, torque_met, stiffness_met, holds)
