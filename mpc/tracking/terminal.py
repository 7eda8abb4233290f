"""Terminal cost: the value function of a linear-quadratic regulator beyond the horizon.

After the last sample, limits are ignored and the plant is linear about the middle of its range. The deviation
ξ = (x_N - x*_N, e_{N-1}) from the reference then costs at least ½ ξᵀ S ξ to remove, with S the solution of the discrete
algebraic Riccati equation of

    ξ⁺ = [A 0; 0 0] ξ + [B; I] e,    cost  ½ (xᵀ W_x x + (C x)ᵀ W_y (C x) + w_u |e|² + w_t |e - e_last|²/dt²)

with the weights W_x, W_y and w_u of `mpc.tracking.cost`, and C the gradients of the outputs.

The rate weight w_t = `Weights.terminal_rate` is far above that within the horizon: w_θ (1°)² = w_t (2.5 bar/s)², so
that the regulator beyond the horizon seldom exceeds the slew limit. Otherwise a horizon shorter than the time to brake
ends in a limit cycle at the slew limit.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.model.experiment import RESOLUTION
from mpc.model.machine import Machine
from mpc.tracking.cost import Rows, charged, diagonal
from mpc.tracking.linearise import Predictor
from mpc.tracking.riccati import semidefinite_factor, solve_riccati
from mpc.tracking.weights import Weights


class Middle(NamedTuple):
    """Linear model of a plant with s states and m muscles, about rest in the middle of its ranges and of the supply."""

    A: Array  # (s, s)
    B: Array  # (s, m)
    C: Array  # (p, s) gradients of the outputs

    @property
    def units(self) -> Array:
        """Units (s + m,) of ξ in the Riccati equation, for its conditioning: bar for Pa."""
        states, m = self.B.shape
        return np.concatenate([np.ones(states - m), np.full(2 * m, BAR)])


class Regulator(NamedTuple):
    """Linear-quadratic problem of ξ = (x - x*, e_last) about the middle of the range, in units of bar for Pa."""

    A: Array  # (s + m, s + m)
    B: Array  # (s + m, m)
    Q: Array  # (s + m, s + m)
    R: Array  # (m, m)
    cross: Array  # (s + m, m), cost of ξᵀ cross e


def regulator(model: Middle, dt: float, rows: Rows, rate: float) -> Regulator:
    """Return the regulator for the weights `rows` of a sample, with the rate weight `rate` [cost]/[Pa/s]² for w_t."""
    (states, m), units, du = model.B.shape, model.units, rate / dt**2  # [cost]/[Pa]² per sample
    A, B = np.zeros((states + m, states + m)), np.vstack([model.B, np.eye(m)])
    A[:states, :states] = model.A
    Q, R = np.zeros_like(A), np.diag(rows.e) + du * np.eye(m)
    Q[:states, :states] = np.diag(rows.x) + sum(w * np.outer(model.C[i], model.C[i]) for i, w in charged(rows.y))
    Q[states:, states:] = du * np.eye(m)
    cross = np.vstack([np.zeros((states, m)), -du * np.eye(m)])
    return Regulator(
        A * units / units[:, None],
        B * BAR / units[:, None],
        Q * np.outer(units, units),
        R * BAR**2,
        cross * BAR * units[:, None],
    )


def value_factor(model: Middle, dt: float, weights: Weights, rows: Rows) -> Array:
    """Return L (s + m, s + m) with LᵀL = S: the terminal cost is ½|L ξ|². SI units."""
    S = solve_riccati(*regulator(model, dt, rows, weights.terminal_rate))
    return np.asarray(semidefinite_factor(S) / model.units)


def terminal_factor(plant: Machine, dt: float, weights: Weights) -> Array:
    """Return the `value_factor` L of a plant."""
    return value_factor(middle(plant, dt), dt, weights, diagonal(weights, plant.n, plant.m, plant.stiffnesses))


def middle(plant: Machine, dt: float) -> Middle:
    """Return A, B and C about rest in the middle, where an external torque balances an arm's gravity."""
    P = np.full(plant.m, np.mean(plant.pressure_limits))
    x = np.concatenate([np.atleast_1d(plant.middle), np.zeros(plant.n), P])
    n = plant.substeps(dt, RESOLUTION)  # one by one: a formula of all of them would be n times as long
    d = np.broadcast_to(plant.balance(x), (n, plant.n))
    model = Predictor(plant, dt / n, n).linearise(x, np.tile(P, (n, 1)), d)
    A, B = model.A[0], model.B[0]
    for A_k, B_k in zip(model.A[1:], model.B[1:], strict=True):
        A, B = A_k @ A, A_k @ B + B_k
    return Middle(A, B, model.slope[0])
