"""The terminal cost of an arm is the linear-quadratic regulator's value function, as `mpc.tracking.terminal` has it.

The arm is linearised about rest in the middle of its ranges and of the supply.
"""

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.arm.model import Arm
from mpc.arm.tracking.prediction import predictor_of
from mpc.model.riccati import semidefinite_factor, solve_riccati
from mpc.tracking.cost import Rows, charged
from mpc.tracking.weights import Weights


def arm_terminal_factor(arm: Arm, dt: float, weights: Weights, rows: Rows) -> Array:
    """Return L with LᵀL = S, the terminal cost ½|L ξ|² of ξ = (x_N - x*_N, e_{N-1}) ∈ R^(2n+2m). SI units.

    `rows` are the weights of the stage cost by kinds of rows.
    """
    A, B, C = _middle(arm, dt)
    size, m = arm.size, arm.m
    du = weights.terminal_rate / dt**2  # [cost]/[Pa]² per sample
    units = np.concatenate([np.ones(2 * arm.n), np.full(2 * m, BAR)])  # of ξ, for the equation's conditioning
    A_aug, B_aug = np.zeros((size + m, size + m)), np.vstack([B, np.eye(m)])
    A_aug[:size, :size] = A
    Q, R = np.zeros_like(A_aug), np.diag(rows.e) + du * np.eye(m)
    Q[:size, :size] = np.diag(rows.x) + sum(w * np.outer(C[i], C[i]) for i, w in charged(rows.y))
    Q[size:, size:] = du * np.eye(m)
    cross = np.vstack([np.zeros((size, m)), -du * np.eye(m)])
    S = solve_riccati(
        A_aug * units / units[:, None],
        B_aug * BAR / units[:, None],
        Q * np.outer(units, units),
        R * BAR**2,
        cross * BAR * units[:, None],
    )
    return np.asarray(semidefinite_factor(S) / units)


def _middle(arm: Arm, dt: float) -> tuple[Array, Array, Array]:
    """Return A, B and the outputs' slope about rest in the middle, moved by no torque: gravity is held from outside."""
    q, P = arm.middle, np.full(arm.m, np.mean(arm.mechanism.pressure_limits))
    x = np.concatenate([q, np.zeros(arm.n), P])
    held = arm.bodies.gravity_torque(q) - arm.mechanism.torque(q, P)
    model = predictor_of(arm, dt, 1).linearise(x, P[None], held[None])
    return model.A[0], model.B[0], model.slope[0]
