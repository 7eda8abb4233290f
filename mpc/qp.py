"""A dense quadratic programme and the certificate of a solution.

    minimise ½ zᵀ H z + fᵀ z   subject to   lower ≤ z ≤ upper,   rows_lower ≤ R z ≤ rows_upper                  [QP]

With multipliers λ (positive at an upper, negative at a lower bound) z is optimal if and only if it is feasible,
H z + f + λ_z + Rᵀ λ_R = 0, and each λ_i (z_i - bound_i) = 0. A solver's word is not taken: `certify` computes these.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array


class Residuals(NamedTuple):
    """How far a point is from optimal: all zero at the solution, NaN for what is not finite."""

    primal: float  # greatest violation of a bound or row [z], [R z]
    stationarity: float  # greatest |H z + f + λ_z + Rᵀ λ_R|, relative to the greatest |term| in it
    complementarity: float  # |Σ λ (z - bound)|, relative to the terms of the cost

    def within(self, primal: float, dual: float) -> bool:
        """Whether all of them are at most these tolerances; NaN is not."""
        return self.primal <= primal and self.stationarity <= dual and self.complementarity <= dual


@dataclass(frozen=True)
class QP:
    """The data of [QP]."""

    H: Array  # (n, n), positive definite
    f: Array  # (n,)
    lower: Array  # (n,)
    upper: Array  # (n,)
    R: Array  # (m, n)
    rows_lower: Array  # (m,)
    rows_upper: Array  # (m,)

    @property
    def without_rows(self) -> Self:
        """The same with its simple bounds only."""
        return replace(self, R=self.R[:0], rows_lower=self.rows_lower[:0], rows_upper=self.rows_upper[:0])

    def cost(self, z: Array) -> float:
        """½ zᵀ H z + fᵀ z."""
        return float(0.5 * z @ self.H @ z + self.f @ z)

    def violation(self, z: Array) -> float:
        """Greatest violation of a bound or row at `z`; 0 inside, NaN for a point that is not finite."""
        Rz = self.R @ z
        gaps = np.concatenate([self.lower - z, z - self.upper, self.rows_lower - Rz, Rz - self.rows_upper])
        return float(gaps.max(initial=0.0))

    def certify(self, z: Array, multipliers: Array) -> Residuals:
        """The residuals of `z` (n,) with `multipliers` (n + m,)."""
        n = self.f.size
        Hz, push = self.H @ z, multipliers[:n] + self.R.T @ multipliers[n:]
        scale = max(np.abs(self.f).max(), np.abs(Hz).max(), np.abs(push).max(), 1e-300)
        stationarity = np.abs(Hz + self.f + push).max() / scale
        values = np.concatenate([z, self.R @ z])
        bounds = np.where(
            multipliers > 0,
            np.concatenate([self.upper, self.rows_upper]),
            np.concatenate([self.lower, self.rows_lower]),
        )
        held = multipliers != 0
        gap = abs(float(multipliers[held] @ (values - bounds)[held]))
        size = max(abs(float(z @ Hz)), abs(float(self.f @ z)), 1e-300)
        return Residuals(self.violation(z), float(stationarity), gap / max(size, 1.0))


__all__ = ["QP", "Residuals"]
