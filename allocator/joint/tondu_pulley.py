"""Closed forms of the report's joint, two equal Tondu2021 muscles on a pulley.

In the reciprocals r_i = 1/(P_i+d), with their sum s and difference δ, torque and stiffness are (any c; g = e - cd)

    T = S R [(a-b)(P1-P2) - 2cX - g(X s + ε0 δ)],    K = S R²/l0 (2c + g s),    X = Rθ/l0           (22)

so the stiffness fixes s, and the torque gives a cubic in δ, [C]. Put δ = s z: below the pole P < -d both reciprocals
are negative, so |z| < 1, and the cubic becomes

    f(z) = τ + α z - β z/(1 - z²) = 0,   τ = T/(S R) + 2cX + gXs,   α = g ε0 s > 0,   β = -4(a-b)/s > 0

which falls from +∞ to -∞ on (-1, 1) when α ≤ β: exactly one root, for every torque. α ≤ β says K ≤ `K_crit`.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from allocator.calculus import Array
from allocator.joint.geometry import Pulley
from allocator.muscles import Tondu2021

_NEWTON_STEPS = 50  # bound; four or five are used


@dataclass(frozen=True)
class TonduPulley:
    """Closed forms of two equal `muscle`s on a `pulley`, for arrays of one shape."""

    muscle: Tondu2021
    pulley: Pulley

    @property
    def K_crit(self) -> float:
        """Stiffness [N·m/rad] up to which the inverse is unique: α = β."""
        m, p = self.muscle, self.pulley
        s = -2 * sqrt((m.a - m.b) / (-m.g * p.initial_contraction))
        return m.S * p.radius**2 / p.rest_length * (2 * m.c + m.g * s)

    @property
    def K_floor(self) -> float:
        """Stiffness [N·m/rad] below that of all pairs of pressures: s = 0, pressures at minus infinity."""
        m, p = self.muscle, self.pulley
        return m.S * p.radius**2 / p.rest_length * 2 * m.c

    def inverse(self, theta: Array, K: Array, T: Array) -> tuple[Array, Array]:
        """Return the pressures [Pa] that give (T, K) at θ by [C]; NaN unless K_floor < K <= K_crit."""
        m, p = self.muscle, self.pulley
        X = p.radius * theta / p.rest_length
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            s = (K * p.rest_length / (m.S * p.radius**2) - 2 * m.c) / m.g
            s = np.where((K > self.K_floor) & (K <= self.K_crit), s, np.nan)
            tau = T / (m.S * p.radius) + 2 * m.c * X + m.g * X * s
            z = _root_of_f(tau, m.g * p.initial_contraction * s, -4 * (m.a - m.b) / s)
            # 2/(s+δ) and 2/(s-δ)
            return 2 / (s * (1 + z)) - m.d, 2 / (s * (1 - z)) - m.d

    def equilibrium(self, P1: Array, P2: Array, T: Array) -> Array:
        """Return the angle [rad] at which these pressures give the torque T; for c = 0 and T = 0 equation (23)."""
        m, p = self.muscle, self.pulley
        r1, r2 = 1 / (P1 + m.d), 1 / (P2 + m.d)
        push = (m.a - m.b) * (P1 - P2) - p.initial_contraction * m.g * (r1 - r2) - T / (m.S * p.radius)
        return np.asarray(p.rest_length / p.radius * push / (2 * m.c + m.g * (r1 + r2)))


def _root_of_f(tau: Array, alpha: Array, beta: Array) -> Array:
    """Return the root z in (-1, 1) of f; arrays of one shape, NaN passes.

    f is odd in (τ, z), so take τ ≥ 0. Cleared of its denominator f is -p, p(z) = αz³ + τz² + (β-α)z - τ, convex on
    [0, 1] with p(0) ≤ 0 < β = p(1). Without the cubic term p has the root below, which is therefore an upper bound;
    from there Newton's method falls monotonically onto the root.
    """
    t = np.abs(tau)
    z = np.where(t > 0, 2 * t / (beta - alpha + np.hypot(beta - alpha, 2 * t)), 0.0)
    for _ in range(_NEWTON_STEPS):
        p = ((alpha * z + t) * z + (beta - alpha)) * z - t
        slope = (3 * alpha * z + 2 * t) * z + (beta - alpha)
        step = np.where(slope > 0, p / slope, 0.0)
        z = z - step
        if not (np.abs(step) > 4e-16 * z).any():
            break
    return np.copysign(z, tau)
