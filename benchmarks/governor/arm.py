"""An arm of two links in the plane that moves, many of them at once, with muscles that may be unlike their model."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from allocator.mechanism import Mechanism, machines

LINK, MASS, CENTRE, INERTIA = 0.30, (1.2, 0.9), 0.15, (0.010, 0.008)  # [m], [kg], [m], [kg·m²] about the centre


def mass_matrix(q: np.ndarray) -> np.ndarray:
    """M(q) (…, 2, 2) [kg·m²]."""
    c = np.cos(q[..., 1])
    M22 = np.full(c.shape, INERTIA[1] + MASS[1] * CENTRE**2)
    M12 = M22 + MASS[1] * LINK * CENTRE * c
    M11 = INERTIA[0] + MASS[0] * CENTRE**2 + MASS[1] * LINK**2 + 2 * M12 - M22
    return np.stack([np.stack([M11, M12], -1), np.stack([M12, M22], -1)], -2)


def symbolic_mass_matrix(q: Any) -> Any:
    """M(q) of a CasADi column."""
    import casadi as ca

    M22 = INERTIA[1] + MASS[1] * CENTRE**2
    M12 = M22 + MASS[1] * LINK * CENTRE * ca.cos(q[1])
    M11 = INERTIA[0] + MASS[0] * CENTRE**2 + MASS[1] * LINK**2 + 2 * M12 - M22
    return ca.vertcat(ca.horzcat(M11, M12), ca.horzcat(M12, M22))


@dataclass
class Arms:
    """N arms without gravity; pressures follow commands with a lag, muscle forces are `strength` times the model's."""

    q: np.ndarray  # (N, 2)
    omega: np.ndarray  # (N, 2)
    P: np.ndarray  # (N, 6)
    lag: float
    damping: float
    strength: np.ndarray  # (N, 6)
    mechanism: Mechanism

    @classmethod
    def at_rest(cls, N: int, lag: float, damping: float, off: float, rng: np.random.Generator) -> "Arms":
        """Arms in the middle, all muscles equal; forces up to `off` of the model's too great or too small."""
        strength = 1 + off * rng.choice([-1.0, 1.0], (N, 6))
        return cls(np.zeros((N, 2)), np.zeros((N, 2)), np.full((N, 6), 2.5e5), lag, damping, strength, machines.arm26())

    def acceleration(self, q: np.ndarray, omega: np.ndarray, P: np.ndarray) -> np.ndarray:
        """ω' (N, 2) from M ω' = τ - C - D ω."""
        force = self.mechanism.forces(q, P) * self.strength
        torque = (force[..., None] * self.mechanism.arms(q)).sum(axis=1)
        h = MASS[1] * LINK * CENTRE * np.sin(q[:, 1])
        coriolis = np.stack([-h * omega[:, 1] * (2 * omega[:, 0] + omega[:, 1]), h * omega[:, 0] ** 2], -1)
        return np.linalg.solve(mass_matrix(q), (torque - coriolis - self.damping * omega)[..., None])[..., 0]

    def step(self, u: np.ndarray, dt: float, substeps: int = 10) -> None:
        """Move for `dt` [s] with the commands `u` (N, 6), by the classical Runge–Kutta method."""
        h = dt / substeps
        half, whole = np.exp(-h / 2 / self.lag), np.exp(-h / self.lag)
        for _ in range(substeps):
            q, v, P1, P2 = self.q, self.omega, u + half * (self.P - u), u + whole * (self.P - u)
            a1 = self.acceleration(q, v, self.P)
            a2 = self.acceleration(q + h / 2 * v, v + h / 2 * a1, P1)
            a3 = self.acceleration(q + h / 2 * v + h**2 / 4 * a1, v + h / 2 * a2, P1)
            a4 = self.acceleration(q + h * v + h**2 / 2 * a2, v + h * a3, P2)
            self.q = q + h * v + h**2 / 6 * (a1 + a2 + a3)
            self.omega, self.P = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), P2
