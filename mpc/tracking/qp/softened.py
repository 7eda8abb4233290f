"""Softened QP, which always has a solution, found by a different method.

    minimise   ½ zᵀ H z + fᵀ z + ½ Σ_i w_i max(0, breach_i(z))²      over      lower ≤ z ≤ upper

Only the bounds on z, the slew limits, are hard. Every other row costs the square of its violation; slacks are left out.
The method is bounded least squares (SciPy's BVLS), repeated with the rows violated by the last solution: a Newton
method for a convex, piecewise quadratic cost, which has converged when the rows repeat. The result is the best point
found when the time is over. It is feasible and better than z = 0.
"""

from dataclasses import replace
from time import perf_counter

import numpy as np

from allocator.calculus import Array, Mask
from mpc.tracking.qp.condense import SLACKS
from mpc.tracking.qp.programme import QP

COMMAND = 1e6  # w of the supply [cost]/[bar]²; commands are clipped to it before they are sent
ROUNDS = 10


def softened(qp: QP, deadline: float) -> Array | None:
    """Return decisions z (n,) with zero slacks, found by `deadline` [s]; None if z = 0 is the best point found."""
    hard, w = _without_slacks(qp), _charges(qp)
    best, least = None, cost(hard, w, np.zeros_like(hard.f))
    z, charged = np.zeros_like(hard.f), np.zeros(len(w), bool)
    took = 0.0  # duration of the last round [s]
    for _ in range(ROUNDS):
        if (began := perf_counter()) + took > deadline:
            break
        try:
            z = _bounded_least_squares(_charging(hard, w, charged, z))
        except np.linalg.LinAlgError:  # H is not positive definite to rounding: keep the best point
            break
        took = perf_counter() - began
        if (price := cost(hard, w, z)) < least:
            best, least = z, price
        broken = hard.breaches(z) > 0
        if (broken == charged).all():
            break
        charged = broken
    return None if best is None else np.append(best, SLACKS * [0.0])


def cost(qp: QP, w: Array, z: Array) -> float:
    """Return the cost to minimise; `qp` has no slacks."""
    return qp.cost(z) + 0.5 * float(w @ np.maximum(qp.breaches(z), 0.0) ** 2)


def _without_slacks(qp: QP) -> QP:
    n = qp.f.size - SLACKS
    return replace(qp, H=qp.H[:n, :n], f=qp.f[:n], lower=qp.lower[:n], upper=qp.upper[:n], R=qp.R[:, :n])


def _charges(qp: QP) -> Array:
    """Return w (m,), the QP's cost of the square of each row's slack, and COMMAND for the rows of commands."""
    w = np.square(qp.R[:, -SLACKS:]) @ np.diag(qp.H)[-SLACKS:]
    return np.where(w > 0, w, COMMAND)


def _charging(qp: QP, w: Array, charged: Mask, z: Array) -> QP:
    """Return `qp` without rows, with a cost ½ w (R z' - b)² for each `charged` one; `z` violates the bounds b."""
    R, w = qp.R[charged], w[charged]
    b = np.clip(R @ z, qp.rows_lower[charged], qp.rows_upper[charged])
    H, f = qp.H + R.T @ (w[:, None] * R), qp.f - R.T @ (w * b)
    return replace(qp.with_rows(np.zeros(len(qp.R), bool)), H=H, f=f)


def _bounded_least_squares(qp: QP) -> Array:
    """Return the minimum within the bounds, of ½ |Lᵀ z + L⁻¹ f|² with H = L Lᵀ."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    L = np.linalg.cholesky(qp.H)
    found = lsq_linear(L.T, -solve_triangular(L, qp.f, lower=True), (qp.lower, qp.upper), method="bvls")
    return np.asarray(np.clip(found.x, qp.lower, qp.upper))
