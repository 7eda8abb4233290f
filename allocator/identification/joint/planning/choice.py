"""Choice of setpoints whose fit errs least in K, although the force law and the friction model are wrong.

A least-squares fit to the visits of the chosen setpoints estimates y = (dx, b), the unknowns and the friction error of
`allocator.identification.joint.doubt.discrepancy`, from θ = R y + B c + e and takes c, the error of the law, for zero.
With y in units of its standard deviations beforehand and R, B over σ, the error of the quantity G_y y + G_c c has

    E[error²] = Σ (τ (G_c - G_y S Rᵀ B))² + G_y S G_yᵀ,   S = (I + Rᵀ R)⁻¹                             (E1)

The first part does not decrease with the number of readings: setpoints decide by their places. The greedy choice takes
the greatest gain log det(I + R_i S R_iᵀ) until there are as many setpoints as unknowns, and then the setpoint after
which (E1) is least in the mean over the unloaded setpoints.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.identification.joint.doubt.discrepancy import RMS_OF_FIELD, ForceField, FrictionError, angle_effect
from allocator.identification.joint.problem import JointProblem

_FRICTION = 0.1  # standard deviation of b beforehand [rad]


class Goal(NamedTuple):
    """Gradients of log K at the unloaded setpoints."""

    by_x: Array  # (g, m)
    by_law: Array  # (g, k)


@dataclass(frozen=True)
class Candidates:
    """Model (E1) of n candidate setpoints, each visited from both sides."""

    rows: Array  # R (n, 2, p)
    law: Array  # τ B (n, 2, k)
    by_y: Array  # G_y (g, p)
    by_law: Array  # τ G_c (g, k)

    @classmethod
    def of(
        cls, problem: JointProblem, x: Array, field: ForceField, std: Array, goal: Goal, law: float, noise: float
    ) -> "Candidates":
        """Return the model of the samples of `problem`: all setpoints as they fall, then all as they rise.

        `std` (m,) are the standard deviations of x beforehand, `law` the RMS error of the law in its mean force [-] and
        `noise` σ [rad].
        """
        s = problem.samples
        X = -problem.jacobian(x)[: s.n] * std
        N = FrictionError.of(s).columns(s) * _FRICTION
        tau = law / RMS_OF_FIELD
        return cls(
            _paired(np.hstack([X, N]) / noise),
            _paired(angle_effect(problem, x, field) * tau / noise),
            np.pad(goal.by_x * std, ((0, 0), (0, N.shape[1]))),
            goal.by_law * tau,
        )

    def error(self, chosen: list[int]) -> float:
        """Return the RMS error of K [-] after a fit to these setpoints."""
        R, B = (a[chosen].reshape(-1, a.shape[2]) for a in (self.rows, self.law))
        return float(self._errors((np.eye(R.shape[1]) + R.T @ R)[None], (R.T @ B)[None])[0])

    def following(self, chosen: list[int], unknowns: int) -> int | None:
        """Return the setpoint to choose next, or None if all are chosen."""
        if len(chosen) == len(self.rows):
            return None
        R, B = (a[chosen].reshape(-1, a.shape[2]) for a in (self.rows, self.law))
        A, transposed = np.eye(R.shape[1]) + R.T @ R, self.rows.swapaxes(1, 2)
        if len(chosen) < unknowns:
            gain = np.linalg.slogdet(np.eye(2) + self.rows @ np.linalg.solve(A, transposed))[1]
        else:
            gain = -self._errors(A + transposed @ self.rows, R.T @ B + transposed @ self.law)
        gain[chosen] = -np.inf  # a setpoint visited again would show the model's error, not the noise
        return int(gain.argmax())

    def _errors(self, A: Array, seen: Array) -> Array:
        """Return the RMS of (E1) (q,) for the matrices I + Rᵀ R (q, p, p) and τ Rᵀ B (q, p, k)."""
        of_noise = np.linalg.solve(A, np.broadcast_to(self.by_y.T, (len(A), *self.by_y.T.shape)))  # S G_yᵀ
        of_law = self.by_law - of_noise.swapaxes(1, 2) @ seen
        noise = (self.by_y.T * of_noise).sum(axis=1)
        return np.asarray(np.sqrt(np.mean((of_law**2).sum(axis=2) + noise, axis=1)))


def _paired(rows: Array) -> Array:
    return rows.reshape(2, -1, rows.shape[1]).swapaxes(0, 1)
