"""The terminal cost is that of the future beyond the horizon: the linear-quadratic regulator's value function.

After the last sample there is no limit and the plant is linear about the middle of its range; the deviation
ξ = (x_N - x*_N, e_{N-1}) from the reference is then brought to zero at the least cost ½ ξᵀ S ξ, with S the solution of
the discrete algebraic Riccati equation of

    ξ⁺ = [A 0; 0 0] ξ + [B; I] e,    cost  ½ (xᵀ W_x x + (C x)ᵀ W_y (C x) + w_u |e|² + w_t |e - e_last|²/dt²)

with the weights W_x, W_y and w_u of `mpc.tracking.cost`, and C the gradients of the outputs.

The rate weight w_t = `Weights.terminal_rate` is far above that within the horizon: w_θ (1°)² = w_t (2.5 bar/s)², so
that the regulator assumed beyond the horizon seldom asks for more than the slew limit gives. Without this care a
horizon too short to see how long braking takes ends in a limit cycle at the slew limit.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.model.experiment import RESOLUTION
from mpc.model.plant import NU, NX, Plant
from mpc.model.riccati import semidefinite_factor, solve_riccati
from mpc.tracking.cost import charged, diagonal
from mpc.tracking.linearise import Predictor
from mpc.tracking.weights import Weights

UNITS = np.array([1, 1, BAR, BAR, BAR, BAR])  # of ξ in the Riccati equation, for its conditioning


class Regulator(NamedTuple):
    """A regulator is the linear-quadratic problem of ξ = (x - x*, e_last) about the middle of the range, in units of
    bar for Pa.
    """

    A: Array  # (6, 6)
    B: Array  # (6, 2)
    Q: Array  # (6, 6)
    R: Array  # (2, 2)
    cross: Array  # (6, 2), cost of ξᵀ cross e


def regulator(plant: Plant, dt: float, weights: Weights, rate: float) -> Regulator:
    """Return the regulator with the rate weight `rate` [cost]/[Pa/s]² in place of w_t."""
    A, B, C = _middle(plant, dt)
    W, n, du = diagonal(weights), NX + NU, rate / dt**2  # [cost]/[Pa]² per sample
    A_aug, B_aug = np.zeros((n, n)), np.vstack([B, np.eye(NU)])
    A_aug[:NX, :NX] = A
    Q, R = np.zeros((n, n)), np.diag(W.e) + du * np.eye(NU)
    Q[:NX, :NX] = np.diag(W.x) + sum(w * np.outer(C[i], C[i]) for i, w in charged(W.y))
    Q[NX:, NX:] = du * np.eye(NU)
    cross = np.vstack([np.zeros((NX, NU)), -du * np.eye(NU)])

    scale, u_scale = UNITS, np.full(NU, BAR)
    return Regulator(
        A_aug * scale / scale[:, None],
        B_aug * u_scale / scale[:, None],
        Q * np.outer(scale, scale),
        R * np.outer(u_scale, u_scale),
        cross * np.outer(scale, u_scale),
    )


def terminal_factor(plant: Plant, dt: float, weights: Weights) -> Array:
    """Return L (6, 6) with LᵀL = S: the terminal cost is ½|L ξ|². SI units."""
    S = solve_riccati(*regulator(plant, dt, weights, weights.terminal_rate))
    return np.asarray(semidefinite_factor(S) / UNITS)


def _middle(plant: Plant, dt: float) -> tuple[Array, Array, Array]:
    """Return A (4, 4), B (4, 2), C (3, 4) about rest in the middle of the joint's range and of the supply."""
    P = np.full(NU, np.mean(plant.joint.pressure_limits))
    x = np.array([np.mean(plant.joint.angle_range), 0.0, *P])
    n = plant.substeps(dt, RESOLUTION)  # one by one: the formula of all of them would have as many times the length
    model = Predictor(plant, dt / n, n).linearise(x, np.tile(P, (n, 1)))
    A, B = model.A[0], model.B[0]
    for A_k, B_k in zip(model.A[1:], model.B[1:], strict=True):
        A, B = A_k @ A, A_k @ B + B_k
    return A, B, model.slope[0]
