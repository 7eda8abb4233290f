"""Proved solution of a QP with many rows of which few bind.

Rows are left out until a solution violates them. This is faster than passing all rows to a solver and leads to the same
point: a solution of the problem with fewer rows that violates none of the others solves the whole problem. A solution
is accepted by the certificate of `mpc.tracking.qp.programme` for the whole problem: gap ≤ ½ c ACCURACY², c the
curvature that every change of a command has by itself. The changes are then within ACCURACY [bar] of the solution.
"""

from time import perf_counter
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Solver

PRIMAL_TOLERANCE = 1e-4  # [bar], [rad], [N] by which an answer may violate a limit; commands are clipped
ACCURACY = 5e-3  # [bar] from an answer to the solution, at most; DAQP reaches 4e-4, Clarabel 5e-3
LAZY_TOLERANCE = 1e-6  # [bar], [rad], [N] below which an omitted row counts as satisfied


class Answer(NamedTuple):
    """Point and its residuals; it is a solution only if the status is OPTIMAL."""

    z: Array  # (n,)
    multipliers: Array  # (n + m,)
    status: PlanStatus


def certified(solve: Solver, qp: QP, deadline: float, curvature: float) -> Answer:
    """Return the proved solution of `qp`, or the reason for its absence by `deadline` [s] (clock: `perf_counter`).

    `curvature` [cost]/[bar]² is a lower bound of the eigenvalues of H without slacks
    (`mpc.tracking.qp.condense.TrackingProblem.curvature`).
    """
    z, multipliers = np.zeros_like(qp.f), np.zeros(qp.f.size + len(qp.R))
    if not (np.isfinite(qp.H).all() and np.isfinite(qp.f).all()):
        return Answer(z, multipliers, PlanStatus.NOT_FINITE)
    within = np.zeros(len(qp.R), bool)
    while True:
        left = deadline - perf_counter()
        found = solve(qp.with_rows(within), left) if left > 0 else None
        if perf_counter() > deadline:
            return Answer(z, multipliers, PlanStatus.LATE)
        if found is None:
            return Answer(z, multipliers, PlanStatus.UNSOLVED)
        z = found[0]
        broken = (qp.breaches(z) > LAZY_TOLERANCE) & ~within
        if not broken.any():
            break
        within = within | broken
    multipliers[np.append(np.full(z.size, True), within)] = found[1]
    right = qp.certify(z, multipliers).within(PRIMAL_TOLERANCE, 0.5 * curvature * ACCURACY**2)
    return Answer(z, multipliers, PlanStatus.OPTIMAL if right else PlanStatus.REFUSED)
