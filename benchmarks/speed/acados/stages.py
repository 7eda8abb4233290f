"""A step's QP by stages for solvers of optimal control, without elimination of states.

    ξ_k = (δθ, δω, δP [bar], w [bar], s [rad], s_F [N])       8 states; of stage 0, where δx = 0 and w = 0, the slacks
    v_k                                                       2 inputs, changes of the commands [bar]
    ξ_{k+1} = A_k ξ_k + B_k v_k                               the slacks are states that stay as they are

    ½ Σ_k (ξ_kᵀ Q_k ξ_k + v_kᵀ R_k v_k) + q_kᵀ ξ_k + r_kᵀ v_k  with the boxes of v, w, s, s_F and rows C_k ξ_k

It is the QP that `mpc.tracking.qp.condense` condenses, divided by its least curvature: the two slacks belong to the
whole horizon, and every number has a moderate size.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from benchmarks.speed.acados.recorded import RecordedQP
from mpc.tracking.qp.condense import TrackingProblem

NX, NV, NG = 8, 2, 4  # states, inputs, rows
W, SLACKS = [4, 5], [6, 7]  # places of w, s and s_F in ξ
UNITS = np.array([1.0, 1.0, BAR, BAR])  # of δx


class Stages(NamedTuple):
    """The stages k = 0 … N of a QP; a row of a `never` side is infinite."""

    A: Array  # (N, 8, 8)
    B: Array  # (N, 8, 2)
    Q: Array  # (N+1, 8, 8)
    q: Array  # (N+1, 8)
    R: Array  # (N, 2, 2)
    r: Array  # (N, 2)
    v: Array  # (2, N, 2) lower and upper bounds
    w: Array  # (2, N+1, 2) lower and upper bounds
    C: Array  # (N+1, 4, 8)
    rows: Array  # (2, N+1, 4) lower and upper sides


def stages(problem: TrackingProblem, qp: RecordedQP) -> Stages:
    """Return the stages of a QP with commands that may change at every sample."""
    N = len(qp.model.u)
    A, B = np.zeros((N, NX, NX)), np.zeros((N, NX, NV))
    A[:, :4, :4] = qp.model.A * UNITS / UNITS[:, None]
    A[:, :4, 4:6] = B[:, :4] = qp.model.B * BAR / UNITS[:, None]
    A[:, W, W] = B[:, W, [0, 1]] = A[:, SLACKS, SLACKS] = 1.0
    return Stages(A, B, *_costs(problem, qp), *_limits(problem, qp))


def _costs(problem: TrackingProblem, qp: RecordedQP) -> tuple[Array, Array, Array, Array]:
    """Return Q, q, R and r."""
    weights, rows, model, feed = problem.weights, problem.rows, qp.model, qp.feed
    N, unit = len(model.u), 1 / problem.curvature
    x, y = (model.x - feed.x) / UNITS, model.y - feed.y
    e = (model.u - feed.u) / BAR
    change = np.diff(e, axis=0, prepend=(qp.u_last - qp.u_star_last)[None] / BAR)
    wx, wy, slope = rows.x * UNITS**2, rows.y, model.slope * UNITS
    Q, q = np.zeros((N + 1, NX, NX)), np.zeros((N + 1, NX))
    Q[1:N, :4, :4] = np.diag(wx) + np.einsum("kmi,m,kmj->kij", slope, wy, slope)[1:N]
    q[1:N, :4] = (wx * x + np.einsum("kmi,m,km->ki", slope, wy, y))[1:N]
    L = problem.L * np.append(UNITS, [BAR, BAR])
    Q[N, :6, :6], q[N, :6] = L.T @ L, L.T @ L @ np.append(x[N], e[-1])
    Q[1:, W, W] += rows.e * BAR**2
    q[1:, W] += rows.e * BAR**2 * e
    Q[0, SLACKS, SLACKS] = weights.slack_square, weights.slack_force_square
    q[0, SLACKS] = weights.slack, weights.slack_force
    rate = rows.rate * BAR**2 / problem.dt**2
    return unit * Q, unit * q, np.tile(unit * np.diag(rate), (N, 1, 1)), unit * rate * change


def _limits(problem: TrackingProblem, qp: RecordedQP) -> tuple[Array, Array, Array, Array]:
    """Return the bounds of v and w, C and the sides of its rows."""
    limits, model = problem.limits, qp.model
    (low, high), (left, right), N = limits.pressure, limits.theta, len(model.u)
    changes, step = np.diff(model.u, axis=0, prepend=qp.u_last[None]) / BAR, limits.step / BAR
    v = np.stack([np.minimum(-step - changes, 0.0), np.maximum(step - changes, 0.0)])
    w = np.zeros((2, N + 1, NV))
    w[0, 1:], w[1, 1:] = np.minimum((low - model.u) / BAR, 0.0), np.maximum((high - model.u) / BAR, 0.0)
    C, sides = np.zeros((N + 1, NG, NX)), np.full((2, N + 1, NG), np.inf) * np.array([-1, 1])[:, None, None]
    C[1:, :2, 0] = 1.0
    C[1:, 0, SLACKS[0]], C[1:, 1, SLACKS[0]] = -1.0, 1.0
    C[1:, 2:, :4], C[1:, 2:, SLACKS[1]] = model.slope[1:, 1:] * UNITS, 1.0
    theta, F = model.x[1:, 0], model.F[1:]
    sides[1, 1:, 0], sides[0, 1:, 1], sides[0, 1:, 2:] = right - theta, left - theta, limits.min_force - F
    return v, w, C, sides
