"""Terminal cost: the value function of a linear-quadratic regulator beyond the horizon.

After the last sample, limits are ignored and the plant is linear about the middle of its range. The deviation
ξ = (x_N - x*_N, e_{N-1}) from the reference then costs at least ½ ξᵀ S ξ to remove, with S the solution of the discrete
algebraic Riccati equation of

    ξ⁺ = [A 0; 0 0] ξ + [B; I] e,    cost  ½ (xᵀ W_x x + (C x)ᵀ W_y (C x) + w_u |e|² + w_t |e - e_last|²/dt²)

with the weights W_x, W_y and w_u of `mpc.tracking.cost`, and C the gradients of the outputs.

The rate weight w_t = `Weights.terminal_rate` is far above that within the horizon: w_θ (1°)² = w_t (2.5 bar/s)², so
that the regulator beyond the horizon seldom exceeds the slew limit. Otherwise a horizon shorter than the time to brake
ends in a limit cycle at the slew limit.

Discrete algebraic Riccati equation for semidefinite costs, and a factor of its solution.

The least cost of bringing ξ to zero, ½ ξᵀ S ξ = min ½ Σ (ξᵀ Q ξ + 2 ξᵀ N u + uᵀ R u) over ξ⁺ = A ξ + B u, solves

    S = Aᵀ S A + Q - (Aᵀ S B + N) (R + Bᵀ S B)⁻¹ (Bᵀ S A + Nᵀ)                                                [R]

If a change of pressures costs nothing (a joint whose stiffness does not depend on its pressures, an arm with more
muscles than targets), S is singular. Its least eigenvalue is then a rounding error of either sign, so that a Cholesky
factorisation may fail, depending on the processor.

[R] is solved by structured doubling (Chu, Fan, Lin, Wang, Int. J. Control 77, 2004): step k gives the cost of 2ᵏ
samples, as a sum of semidefinite terms without cancellation. The ordered Schur form of
`scipy.linalg.solve_discrete_are` is less accurate by four digits and fails for some weights.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.model.experiment import RESOLUTION
from mpc.model.machine import Machine
from mpc.tracking.cost import Rows, Weights, charged, diagonal
from mpc.tracking.linearise import Predictor

_DOUBLINGS = 60  # at most; a horizon of 2⁶⁰ samples
_ENDLESS = 1e60  # of the largest entry of Q: a larger S means a motion that no input can bring to zero
_SETTLED = 1e-16  # of sqrt(S_ii S_jj): a smaller change of S_ij counts as none
_GROWING = 1e-6  # of the largest entry of S: a greater change by the last doubling is not rounding
_NONE = "the Riccati equation has no solution: a motion that costs something never ends"


def solve_riccati(A: Array, B: Array, Q: Array, R: Array, N: Array) -> Array:
    """Return the least semidefinite S (n, n) of [R] for A (n, n), B (n, m), Q (n, n), R (m, m), N (n, m).

    R has to be positive definite and [Q N; Nᵀ R] semidefinite. Raises `InvalidInput` if there is no S, because no input
    can bring a motion with a cost to zero.
    """
    undone = np.linalg.solve(R, N.T)  # u = v - R⁻¹ Nᵀ ξ removes N
    A, S, G = A - B @ undone, Q - N @ undone, B @ np.linalg.solve(R, B.T)
    n, one = len(A), np.eye(len(A))
    for _ in range(_DOUBLINGS):
        both = np.linalg.solve(one + G @ S, np.hstack([A, G]))
        more, G = A.T @ S @ both[:, :n], G + A @ both[:, n:] @ A.T
        A, S = A @ both[:, :n], S + more
        S, G = (S + S.T) / 2, (G + G.T) / 2
        if np.abs(S).max() > _ENDLESS * np.abs(Q).max():
            raise InvalidInput(_NONE)
        size = np.sqrt(np.maximum(np.diag(S), 0.0))
        if (np.abs(more) <= _SETTLED * np.outer(size, size)).all():
            break
    if not np.abs(more).max() <= _GROWING * np.abs(S).max():
        raise InvalidInput(_NONE)
    return np.asarray(S)


def semidefinite_factor(S: Array) -> Array:
    """Return the upper triangular L (n, n), with a diagonal ≥ 0 and LᵀL = S, for a semidefinite S (n, n).

    Eigenvalues that rounding made negative count as zero.
    """
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    L = np.linalg.qr(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, mode="r")
    return np.asarray(np.where(np.diag(L) < 0, -1.0, 1.0)[:, None] * L)


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
    """Return A, B and C about rest in the middle, where an external torque balances gravity and muscles."""
    P = np.full(plant.m, np.mean(plant.pressure_limits))
    x = np.concatenate([np.atleast_1d(plant.middle), np.zeros(plant.n), P])
    n = plant.substeps(dt, RESOLUTION)  # one by one: a formula of all of them would be n times as long
    d = np.broadcast_to(plant.balance(x), (n, plant.n))
    model = Predictor(plant, dt / n, n).linearise(x, np.tile(P, (n, 1)), d)
    A, B = model.A[0], model.B[0]
    for A_k, B_k in zip(model.A[1:], model.B[1:], strict=True):
        A, B = A_k @ A, A_k @ B + B_k
    return Middle(A, B, model.slope[0])
