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
from mpc.linearise import Linearisation
from mpc.plant import NU, NX
from mpc.qp import QP
from mpc.weights import Weights


@dataclass(frozen=True)
class Targets:
    """What the horizon is compared with."""

    theta: Array  # (N+1,) [rad]
    omega: Array  # (N+1,) [rad/s]
    K: Array  # (N+1,) [N·m/rad]
    P: Array  # (N+1, 2) [Pa]
    u: Array  # (N, 2) feed-forward commands [Pa]
    u_before: Array  # (2,) the feed-forward of the sample before [Pa]


@dataclass(frozen=True)
class Limits:
    """What the commands and the angle have to keep to."""

    pressure: tuple[float, float]  # of every command [Pa], hard
    step: float  # greatest |u_k - u_{k-1}| [Pa], hard
    theta: tuple[float, float]  # [rad], soft


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


def condense(
    model: Linearisation, u_last: Array, targets: Targets, limits: Limits, weights: Weights, L: Array, E: Array, dt: float
) -> QP:
    """The QP of one step about `model`; `u_last` (2,) is the command that holds now [Pa], `L` the terminal factor."""
    G = sensitivity(model.A, model.B, E)
    M, r = _residuals(model, G, targets, u_last, weights, L, E, dt)
    H, f = M.T @ M, M.T @ r
    H[-1, -1], f[-1] = weights.slack_square, weights.slack

    changes = np.diff(model.u, axis=0, prepend=u_last[None]).ravel() / BAR
    step = limits.step / BAR
    # z = 0 is allowed whatever rounding says
    lower, upper = np.minimum(-step - changes, 0.0), np.maximum(step - changes, 0.0)
    lower, upper = np.append(lower, 0.0), np.append(upper, np.inf)
    return QP(H, f, lower, upper, *_rows(model, G, limits, E))


def _residuals(
    model: Linearisation, G: Array, targets: Targets, u_last: Array, weights: Weights, L: Array, E: Array, dt: float
) -> tuple[Array, Array]:
    """M (m, n) and r̄ (m,) of the cost ½|r̄ + M z|²."""
    N, _, n = E.shape
    away = model.u - targets.u  # e (N, 2) [Pa]
    changed = np.diff(away, axis=0, prepend=(u_last - targets.u_before)[None])
    E_changed = np.diff(E, axis=0, prepend=np.zeros((1, NU, n)))
    x_star = np.concatenate([[targets.theta[-1], targets.omega[-1]], targets.P[-1]])
    xi = np.concatenate([model.x[-1] - x_star, away[-1]])
    inner = slice(1, N)  # the states before the last, which the terminal cost takes
    terms = [  # root of the weight, Jacobian, residual at z = 0
        (weights.theta**0.5, G[inner, 0], model.x[inner, 0] - targets.theta[inner]),
        (weights.omega**0.5, G[inner, 1], model.x[inner, 1] - targets.omega[inner]),
        (weights.K**0.5, (model.C[inner, None] @ G[inner])[:, 0], model.K[inner] - targets.K[inner]),
        (weights.u**0.5, E.reshape(-1, n), away.ravel()),
        (weights.rate**0.5 / dt, E_changed.reshape(-1, n), changed.ravel()),
        (1.0, L @ np.concatenate([G[-1], E[-1]]), L @ xi),
    ]
    M = np.concatenate([w * J for w, J, _ in terms])
    return M, np.concatenate([w * r for w, _, r in terms])


def _rows(model: Linearisation, G: Array, limits: Limits, E: Array) -> tuple[Array, Array, Array]:
    """Commands within the supply; θ - s at most its upper, θ + s at least its lower limit.

    Pressures that start outside the supply come back no faster than the slew limit, as those of `model` do: up to
    there z = 0 has to be allowed.
    """
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


__all__ = ["Limits", "Targets", "condense", "increments", "sensitivity"]
