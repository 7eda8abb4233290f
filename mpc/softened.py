"""A step of the MPC that always has an answer, found in another way than the QP's.

    minimise   ½ zᵀ H z + fᵀ z + ½ Σ_i w_i max(0, breach_i(z))²      over      lower ≤ z ≤ upper

Of the limits only the bounds on z are hard, the slew; every other row is charged for the square of its breach, the
slacks are left out. It is solved by bounded least squares (SciPy's BVLS), each charging the rows that the one before
broke: a Newton method for a convex cost that is quadratic piece by piece, which has arrived when the rows repeat.
"""

from dataclasses import replace

import numpy as np

from allocator.calculus import Array, Mask
from mpc.condense import SLACKS
from mpc.qp import QP

_COMMAND = 1e6  # w of the supply [cost]/[bar]²; commands are clipped to it before they are sent
_ROUNDS = 10
_ROUNDING = 1e-9  # [bar]
_GAP_TOLERANCE = 1e-3  # [-] of the cost that the step gains


def softened(qp: QP) -> Array | None:
    """The decisions z (n,) of that problem, the slacks zero; None if its optimality cannot be proved."""
    hard, w = _without_slacks(qp), _charges(qp)
    z, charged = np.zeros_like(hard.f), np.zeros(len(w), bool)
    for _ in range(_ROUNDS):
        bounded = _charging(hard, w, charged, z)
        z, multipliers = _bounded_least_squares(bounded)
        if not bounded.certify(z, multipliers).within(_ROUNDING, _GAP_TOLERANCE):
            return None
        broken = hard.breaches(z) > 0
        if (broken == charged).all():
            return np.append(z, SLACKS * [0.0])
        charged = broken
    return None


def _without_slacks(qp: QP) -> QP:
    n = qp.f.size - SLACKS
    return replace(qp, H=qp.H[:n, :n], f=qp.f[:n], lower=qp.lower[:n], upper=qp.upper[:n], R=qp.R[:, :n])


def _charges(qp: QP) -> Array:
    """w (m,): what the QP charges for the square of the row's slack; the commands have none."""
    w = np.square(qp.R[:, -SLACKS:]) @ np.diag(qp.H)[-SLACKS:]
    return np.where(w > 0, w, _COMMAND)


def _charging(qp: QP, w: Array, charged: Mask, z: Array) -> QP:
    """`qp` without rows, ½ w (R z' - b)² in its cost for each of those `charged`; b is the bound that `z` breaks."""
    R, w = qp.R[charged], w[charged]
    b = np.clip(R @ z, qp.rows_lower[charged], qp.rows_upper[charged])
    H, f = qp.H + R.T @ (w[:, None] * R), qp.f - R.T @ (w * b)
    return replace(qp.with_rows(np.zeros(len(qp.R), bool)), H=H, f=f)


def _bounded_least_squares(qp: QP) -> tuple[Array, Array]:
    """The minimum within the bounds, of ½ |Lᵀ z + L⁻¹ f|² with H = L Lᵀ, and the bounds' multipliers."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    L = np.linalg.cholesky(qp.H)
    b = -solve_triangular(L, qp.f, lower=True)
    found = lsq_linear(L.T, b, (qp.lower, qp.upper), method="bvls")
    side = found.active_mask  # -1 at a lower, 1 at an upper bound
    z = np.select([side < 0, side > 0], [qp.lower, qp.upper], found.x)
    pushes = -(qp.H @ z + qp.f)
    return z, np.where(pushes * side > 0, pushes, 0.0)


__all__ = ["softened"]
