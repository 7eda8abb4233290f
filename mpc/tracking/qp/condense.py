"""Condensing of stage matrices to a dense QP in the changes of the commands, with the states eliminated.

The commands are u = ū + E z, where E (N, 2, n) maps decisions to commands. The decisions z are the N changes
Δu_k = u_k - u_{k-1}, minus those of ū, so that every command contains the sum of the changes up to it, followed by the
slacks s of the joint range and s_F of the muscle forces. Blocked moves have fewer: one pair of changes at the beginning
of every block, after which the commands move as ū does. With δx_0 = 0 the linear model gives

    δx_{k+1} = A_k δx_k + B_k E_k z      so      x_k = x̄_k + G_k z,    G_0 = 0,    G_{k+1} = A_k G_k + B_k E_k

and every term of the cost is a residual r̄ + M z: H = MᵀM, f = Mᵀr̄. Pressures count in bar within z, s in rad, s_F in N.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.model.plant import NU
from mpc.tracking.cost import Rows, Weights, charged, diagonal
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Linearisation
from mpc.tracking.qp.programme import QP

SLACKS = 2  # s and s_F, the last decisions


@dataclass(frozen=True)
class TrackingProblem:
    """Constant data of the problem in `mpc.tracking.controller`."""

    weights: Weights
    limits: Limits
    L: Array  # (6, 6) terminal factor
    blocks: tuple[int, ...]  # samples from one change of the commands to the next, N in all
    dt: float  # [s]
    joints: int = 1  # n; for (4) read 2n + m
    muscles: int = NU  # m; for (2) read m, for (6) 2n + 2m
    stiffnesses: int = 1  # entries of svec K

    @cached_property
    def starts(self) -> Array:
        """Samples at which the commands may leave ū, one for each block."""
        return np.cumsum([0, *self.blocks[:-1]])

    @cached_property
    def rows(self) -> Rows:
        """Weights of the stage cost by kinds of rows."""
        return diagonal(self.weights, self.joints, self.muscles, self.stiffnesses)

    @cached_property
    def curvature(self) -> float:
        """Curvature c [cost]/[bar]², a lower bound of the eigenvalues of H, because every change has this cost."""
        return float(self.rows.rate.min()) * BAR**2 / self.dt**2

    @cached_property
    def E(self) -> Array:
        """Change E (N, 2, n) [Pa] of the commands per unit of each decision."""
        return increments(self.blocks, self.muscles)


def increments(blocks: Sequence[int], m: int = NU) -> Array:
    """Return E (N, 2, 2 blocks + 2) [Pa/bar]: a block's change moves all commands from there on; slacks move none."""
    E = np.zeros((sum(blocks), m, len(blocks) * m + SLACKS))
    for j, start in enumerate(np.cumsum([0, *blocks[:-1]])):
        E[start:, :, j * m : (j + 1) * m] = BAR * np.eye(m)
    return E


def sensitivity(A: Array, B: Array, E: Array) -> Array:
    """Return G (N+1, 4, n) = ∂x/∂z, the linear model unrolled."""
    N, _, n = E.shape
    moves = B @ E  # (N, 4, n)
    G = np.zeros((N + 1, A.shape[1], n))
    for k in range(N):
        G[k + 1] = A[k] @ G[k] + moves[k]
    return G


def condense(
    problem: TrackingProblem, model: Linearisation, feed: FeedForward, u_last: Array, u_star_last: Array
) -> QP:
    """Return the QP of a step about `model`; `u_last`, `u_star_last` (2,) are the previous command and feed-forward."""
    G = sensitivity(model.A, model.B, problem.E)
    M, r = _residuals(problem, model, G, feed, u_last - u_star_last)
    H, f = M.T @ M, M.T @ r
    weights = problem.weights
    H[-SLACKS:, -SLACKS:] = np.diag([weights.slack_square, weights.slack_force_square])
    f[-SLACKS:] = weights.slack, weights.slack_force

    changes = np.diff(model.u, axis=0, prepend=u_last[None])[problem.starts].ravel() / BAR
    step = problem.limits.step / BAR
    # z = 0 is feasible despite rounding
    lower, upper = np.minimum(-step - changes, 0.0), np.maximum(step - changes, 0.0)
    lower, upper = np.append(lower, SLACKS * [0.0]), np.append(upper, SLACKS * [np.inf])
    return QP(H, f, lower, upper, *_rows(problem, model, G))


def _residuals(
    problem: TrackingProblem, model: Linearisation, G: Array, feed: FeedForward, e_last: Array
) -> tuple[Array, Array]:
    """Return M (m, n) and r̄ (m,) of the cost ½|r̄ + M z|²."""
    E, L, W = problem.E, problem.L, problem.rows
    N, _, n = E.shape
    e = model.u - feed.u  # (N, 2) [Pa]
    rate = np.diff(e, axis=0, prepend=e_last[None]) / problem.dt
    E_rate = np.diff(E, axis=0, prepend=np.zeros((1, problem.muscles, n))) / problem.dt
    x, y = model.x - feed.x, model.y - feed.y
    xi = np.concatenate([x[-1], e[-1]])
    inner = slice(1, N)  # the states before the last, which has the terminal cost
    terms = [  # weight, Jacobian, residual at z = 0
        *((w, G[inner, i], x[inner, i]) for i, w in charged(W.x)),
        *((w, (model.slope[inner, None, i] @ G[inner])[:, 0], y[inner, i]) for i, w in charged(W.y)),
        *((w, E[:, i], e[:, i]) for i, w in charged(W.e)),
        *((w, E_rate[:, i], rate[:, i]) for i, w in charged(W.rate)),
        (1.0, L @ np.concatenate([G[-1], E[-1]]), L @ xi),
    ]
    M = np.concatenate([w**0.5 * J for w, J, _ in terms])
    return M, np.concatenate([w**0.5 * r for w, _, r in terms])


def _rows(problem: TrackingProblem, model: Linearisation, G: Array) -> tuple[Array, Array, Array]:
    """Return the rows: commands within the supply; θ - s at most its upper, θ + s at least its lower limit; F + s_F at
    least its own. An arm has as many angles as it has limits.

    Pressures that start outside the supply return no faster than the slew limit, as those of `model` do; z = 0 has to
    stay feasible.
    """
    E, limits = problem.E, problem.limits
    n = E.shape[-1]
    s, s_F = np.eye(n)[-SLACKS:]
    (P_lo, P_hi), (left, right) = limits.pressure, limits.theta
    joints = np.size(left)
    commands, angle = E.reshape(-1, n) / BAR, G[1:, :joints].reshape(-1, n)
    force = (model.D[1:] @ G[1:]).reshape(-1, n)
    u, theta, F = model.u.ravel() / BAR, model.x[1:, :joints], model.F[1:].ravel()
    below, above, never = (left - theta).ravel(), (right - theta).ravel(), np.full(theta.size, np.inf)
    return (
        np.concatenate([commands, angle - s, angle + s, force + s_F]),
        np.concatenate([np.minimum(P_lo / BAR - u, 0.0), -never, below, limits.min_force - F]),
        np.concatenate([np.maximum(P_hi / BAR - u, 0.0), above, never, np.full(F.shape, np.inf)]),
    )
