"""From stage matrices to the dense QP: the states are eliminated, only the changes of the commands remain.

The commands are u = ū + E z, where E (N, 2, n) says which decisions move which command; here z are the N changes
Δu_k = u_k - u_{k-1} (less those of ū), so that every command carries the sum of the changes before it, followed by one
slack s for the joint range. With δx_0 = 0 the linear model gives

    δx_{k+1} = A_k δx_k + B_k E_k z      so      x_k = x̄_k + G_k z,    G_0 = 0,    G_{k+1} = A_k G_k + B_k E_k

and every term of the cost is a residual r̄ + M z: H = MᵀM, f = Mᵀr̄. Pressures count in bar within z.
"""

from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.feedforward import FeedForward
from mpc.limits import Limits
from mpc.linearise import Linearisation
from mpc.plant import NU, NX
from mpc.qp import QP
from mpc.weights import Weights


@dataclass(frozen=True)
class Problem:
    """What does not change from step to step of the problem in `mpc.controller`."""

    weights: Weights
    limits: Limits
    L: Array  # (6, 6) terminal factor
    E: Array  # (N, 2, n) [Pa] a unit of each decision
    dt: float  # [s]


def increments(N: int) -> Array:
    """E (N, 2, 2N + 1) [Pa/bar]: change j moves all commands from j on; the slack moves none."""
    E = np.zeros((N, NU, N * NU + 1))
    for k in range(N):
        E[k, :, : (k + 1) * NU] = BAR * np.tile(np.eye(NU), k + 1)
    return E


def sensitivity(A: Array, B: Array, E: Array) -> Array:
    """G (N+1, 4, n) = ∂x/∂z: the linear model unrolled."""
    N, _, n = E.shape
    moves = B @ E  # (N, 4, n)
    G = np.zeros((N + 1, NX, n))
    for k in range(N):
        G[k + 1] = A[k] @ G[k] + moves[k]
    return G


def condense(problem: Problem, model: Linearisation, feed: FeedForward, u_last: Array, u_star_last: Array) -> QP:
    """The QP of one step about `model`. Of the sample before: command `u_last`, its feed-forward `u_star_last` (2,)."""
    G = sensitivity(model.A, model.B, problem.E)
    M, r = _residuals(problem, model, G, feed, u_last - u_star_last)
    H, f = M.T @ M, M.T @ r
    H[-1, -1], f[-1] = problem.weights.slack_square, problem.weights.slack

    changes = np.diff(model.u, axis=0, prepend=u_last[None]).ravel() / BAR
    step = problem.limits.step / BAR
    # z = 0 is allowed whatever rounding says
    lower, upper = np.minimum(-step - changes, 0.0), np.maximum(step - changes, 0.0)
    lower, upper = np.append(lower, 0.0), np.append(upper, np.inf)
    return QP(H, f, lower, upper, *_rows(problem, model, G))


def _residuals(
    problem: Problem, model: Linearisation, G: Array, feed: FeedForward, e_last: Array
) -> tuple[Array, Array]:
    """M (m, n) and r̄ (m,) of the cost ½|r̄ + M z|²."""
    weights, E, L = problem.weights, problem.E, problem.L
    N, _, n = E.shape
    e = model.u - feed.u  # (N, 2) [Pa]
    rate = np.diff(e, axis=0, prepend=e_last[None]) / problem.dt
    E_rate = np.diff(E, axis=0, prepend=np.zeros((1, NU, n))) / problem.dt
    x_star = np.concatenate([[feed.theta[-1], feed.omega[-1]], feed.P[-1]])
    xi = np.concatenate([model.x[-1] - x_star, e[-1]])
    inner = slice(1, N)  # the states before the last, which the terminal cost takes
    terms = [  # root of the weight, Jacobian, residual at z = 0
        (weights.theta**0.5, G[inner, 0], model.x[inner, 0] - feed.theta[inner]),
        (weights.omega**0.5, G[inner, 1], model.x[inner, 1] - feed.omega[inner]),
        (weights.K**0.5, (model.C[inner, None] @ G[inner])[:, 0], model.K[inner] - feed.K[inner]),
        (weights.u**0.5, E.reshape(-1, n), e.ravel()),
        (weights.rate**0.5, E_rate.reshape(-1, n), rate.ravel()),
        (1.0, L @ np.concatenate([G[-1], E[-1]]), L @ xi),
    ]
    M = np.concatenate([w * J for w, J, _ in terms])
    return M, np.concatenate([w * r for w, _, r in terms])


def _rows(problem: Problem, model: Linearisation, G: Array) -> tuple[Array, Array, Array]:
    """Commands within the supply; θ - s at most its upper, θ + s at least its lower limit.

    Pressures that start outside the supply come back no faster than the slew limit, as those of `model` do: up to
    there z = 0 has to be allowed.
    """
    E, limits = problem.E, problem.limits
    n = E.shape[-1]
    commands, angle = E.reshape(-1, n) / BAR, G[1:, 0]
    slack = np.eye(n)[-1]
    u, theta = model.u.ravel() / BAR, model.x[1:, 0]
    (P_lo, P_hi), (left, right) = limits.pressure, limits.theta
    never = np.full(theta.shape, np.inf)
    return (
        np.concatenate([commands, angle - slack, angle + slack]),
        np.concatenate([np.minimum(P_lo / BAR - u, 0.0), -never, left - theta]),
        np.concatenate([np.maximum(P_hi / BAR - u, 0.0), right - theta, never]),
    )


__all__ = ["Problem", "condense", "increments", "sensitivity"]
