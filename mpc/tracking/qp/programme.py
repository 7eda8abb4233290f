"""Dense quadratic programme and the certificate of its solution.

    minimise ½ zᵀ H z + fᵀ z   subject to   lower ≤ z ≤ upper,   rows_lower ≤ R z ≤ rows_upper                  [QP]

Solutions of solvers are checked. Multipliers λ (positive at an upper, negative at a lower bound) bound the error of a
feasible z: with the gradient of the Lagrangian r = H z + f + λ_z + Rᵀ λ_R, the excess of its cost is at most

    gap = ½ rᵀ H⁻¹ r + Σ_i |λ_i (bound_i - z_i)|            (z_i: also the rows' values R z)

the difference of the primal and the dual cost. It vanishes only at the solution z*: if no eigenvalue of H is below c,
½ c |z - z*|² ≤ gap. If z violates limits, this holds for the QP with the limits moved to z.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask


class Residuals(NamedTuple):
    """Distance of a point from optimality; NaN for values that are not finite."""

    primal: float  # greatest violation of a bound or row [z], [R z]
    gap: float  # [cost] above the least cost, at most

    def within(self, primal: float, gap: float) -> bool:
        """Return whether violations are at most `primal` and the gap [cost] at most `gap`; False for NaN."""
        return self.primal <= primal and self.gap <= gap


@dataclass(frozen=True)
class QP:
    """Data of [QP]."""

    H: Array  # (n, n), positive definite
    f: Array  # (n,)
    lower: Array  # (n,)
    upper: Array  # (n,)
    R: Array  # (m, n)
    rows_lower: Array  # (m,)
    rows_upper: Array  # (m,)

    def with_rows(self, chosen: Mask) -> "QP":
        """Return the QP with only the rows `chosen` (m,), and all of its simple bounds."""
        return QP(
            self.H, self.f, self.lower, self.upper, self.R[chosen], self.rows_lower[chosen], self.rows_upper[chosen]
        )

    def cost(self, z: Array) -> float:
        """Return ½ zᵀ H z + fᵀ z."""
        return float(0.5 * z @ self.H @ z + self.f @ z)

    def violation(self, z: Array) -> float:
        """Return the greatest violation of a bound or row at `z`; 0 inside, NaN if `z` is not finite."""
        return float(np.concatenate([self.lower - z, z - self.upper, self.breaches(z)]).max(initial=0.0))

    def breaches(self, z: Array) -> Array:
        """Return the violation (m,) of each row at `z`; negative inside."""
        Rz = self.R @ z
        return np.maximum(self.rows_lower - Rz, Rz - self.rows_upper)

    def certify(self, z: Array, multipliers: Array) -> Residuals:
        """Return the residuals of `z` (n,) with `multipliers` (n + m,)."""
        n = self.f.size
        upper, lower = np.append(self.upper, self.rows_upper), np.append(self.lower, self.rows_lower)
        bounds = np.where(multipliers > 0, upper, lower)
        held = (multipliers != 0) & np.isfinite(bounds)
        multipliers = np.where(held, multipliers, 0.0)  # a bound at infinity cannot push
        r = self.H @ z + self.f + multipliers[:n] + self.R.T @ multipliers[n:]
        away = (bounds - np.append(z, self.R @ z))[held]
        gap = self._dual(r) + np.abs(multipliers[held] * away).sum()
        return Residuals(self.violation(z), float(gap))

    def _dual(self, r: Array) -> float:
        """Return ½ rᵀ H⁻¹ r; inf if H is not positive definite to rounding, because there is no proof then."""
        try:
            half = np.linalg.solve(np.linalg.cholesky(self.H), r)
        except np.linalg.LinAlgError:
            return np.inf
        return 0.5 * float(half @ half)
