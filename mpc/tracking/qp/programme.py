"""A dense quadratic programme has a certificate of its solution.

    minimise ½ zᵀ H z + fᵀ z   subject to   lower ≤ z ≤ upper,   rows_lower ≤ R z ≤ rows_upper                  [QP]

A solver's word is not taken. Multipliers λ (positive at an upper, negative at a lower bound) prove how good a feasible
z is: with the gradient of the Lagrangian r = H z + f + λ_z + Rᵀ λ_R, its cost exceeds the least possible by at most

    gap = ½ rᵀ H⁻¹ r + Σ_i |λ_i (bound_i - z_i)|            (z_i: also the rows' values R z)

the difference of the primal and the dual cost. It vanishes at the solution z* and nowhere else: where no eigenvalue of
H is below c, ½ c |z - z*|² ≤ gap. Of a z that breaks limits all this is true of the QP whose limits are moved to it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask


class Residuals(NamedTuple):
    """The residuals say how far a point is from optimal; NaN for what is not finite."""

    primal: float  # greatest violation of a bound or row [z], [R z]
    gap: float  # [cost] above the least cost, at most

    def within(self, primal: float, gap: float) -> bool:
        """Return whether no limit is broken by more than `primal`, and the gap [cost] is no more than `gap`; no NaN."""
        return self.primal <= primal and self.gap <= gap


@dataclass(frozen=True)
class QP:
    """A QP is the data of [QP]."""

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
        """Return the greatest violation of a bound or row at `z`; 0 inside, NaN for a point that is not finite."""
        return float(np.concatenate([self.lower - z, z - self.upper, self.breaches(z)]).max(initial=0.0))

    def breaches(self, z: Array) -> Array:
        """Return by how much each row is violated at `z`, (m,); negative inside."""
        Rz = self.R @ z
        return np.maximum(self.rows_lower - Rz, Rz - self.rows_upper)

    def certify(self, z: Array, multipliers: Array) -> Residuals:
        """Return the residuals of `z` (n,) with `multipliers` (n + m,)."""
        n = self.f.size
        upper, lower = np.append(self.upper, self.rows_upper), np.append(self.lower, self.rows_lower)
        bounds = np.where(multipliers > 0, upper, lower)
        held = (multipliers != 0) & np.isfinite(bounds)
        multipliers = np.where(held, multipliers, 0.0)  # there is nothing to push against at infinity
        r = self.H @ z + self.f + multipliers[:n] + self.R.T @ multipliers[n:]
        away = (bounds - np.append(z, self.R @ z))[held]
        gap = self._dual(r) + np.abs(multipliers[held] * away).sum()
        return Residuals(self.violation(z), float(gap))

    def _dual(self, r: Array) -> float:
        """Return ½ rᵀ H⁻¹ r; inf if H is not positive definite to rounding, since nothing is proved then."""
        try:
            half = np.linalg.solve(np.linalg.cholesky(self.H), r)
        except np.linalg.LinAlgError:
            return np.inf
        return 0.5 * float(half @ half)
