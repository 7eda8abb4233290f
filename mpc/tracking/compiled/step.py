"""The template has what of a step depends on the joint: feed-forward, linearisation, and the rollout of an answer.

`mpc.tracking.compiled.module` puts the formulas of the joint in the place of the lines below that
begin with `FORMULAS`, as functions of scalars that return tuples: `rate` (x, u, d) ↦ x', `rate_slopes` (x, u, d) ↦ (x',
its Jacobian by x and u), `outputs` x ↦ y = (K, F1, F2), `output_slopes` x ↦ (y, its Jacobian), `expansion` x ↦ the
pressures' fall as the muscles swell; Jacobians by columns.
`allocated` (θ, K, T) ↦ (P1, P2, T, K, …, sure) is the kernel of `allocator.allocation` for the joint, if there is one.
The array c holds the numbers of all of them, p those of the kernel.

The motion is that of `mpc.model.integration`, and its derivatives are those of the formula. A formula stands here once
and is gone through four times: written out, its graph would be four times as long, and so would compiling it take.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.tracking.compiled.certificate import finite
from mpc.tracking.compiled.commands import cumulative, limit
from mpc.tracking.compiled.flat_records import given_in, path_in, setting_in
from mpc.tracking.compiled.jit import compiled, inlined, merged
from mpc.tracking.compiled.records import Path

FORMULAS: Any = None
rate = rate_slopes = outputs = output_slopes = expansion = allocated = FORMULAS

NODES, SHARES = (0.0, 1 / 2, 1 / 2, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # of the classical Runge–Kutta method


@compiled
def feed_forward(
    c: Array, p: Any, physics: Array, slopes1: Array, slopes2: Array, asked: Array, K: Array, d: Array
) -> tuple[bool, Array, Array, Array, Array]:
    """Return what `mpc.tracking.feedforward.InverseDynamics` does: whether the kernel is sure, x*, y*, u* and how far
    all was moved (3,).

    `slopes1`, `slopes2` (N+1, N+1): derivatives of a preview, transposed; `physics`: see
    `mpc.tracking.compiled.qp_step`.
    """
    inertia, damping, gravity, alpha1, alpha2 = physics[0], physics[1], physics[2], physics[3], physics[4]
    left, right, min_force, half_lag1, half_lag2 = physics[5], physics[6], physics[7], physics[8] / 2, physics[9] / 2
    M, q1, q2 = asked.size, 0.0, 0.0
    theta, omega, speeding = np.empty(M), np.zeros(M), np.zeros(M)
    x, y, u, moved, sure = np.empty((M, 4)), np.zeros((M, 3)), np.empty((M - 1, 2)), np.zeros(3), True
    for j in range(M):
        theta[j] = min(max(asked[j], left), right)
        for k in range(M):
            omega[k] += slopes1[j, k] * theta[j]
            speeding[k] += slopes2[j, k] * theta[j]
    for k in range(M):
        T = inertia * speeding[k] + damping * omega[k] + gravity * np.sin(theta[k]) - d[k]
        found = allocated(theta[k], K[k], T, p, left, right, min_force, c)
        x[k, 0], x[k, 1], x[k, 2], x[k, 3] = theta[k], omega[k], found[0], found[1]
        y[k, 0], sure = found[3], sure and found[6]
        moved[0] = max(moved[0], abs(asked[k] - theta[k]))
        moved[1] = max(moved[1], abs(K[k] - y[k, 0]))
        moved[2] = max(moved[2], abs(T - found[2]))
        last1, last2 = q1, q2
        q1, q2 = expansion(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c)
        if k > 0:
            u[k - 1, 0] = (x[k, 2] - alpha1 * x[k - 1, 2]) / (1 - alpha1) + half_lag1 * (q1 + last1)
            u[k - 1, 1] = (x[k, 3] - alpha2 * x[k - 1, 3]) / (1 - alpha2) + half_lag2 * (q2 + last2)
    return sure, x, y, u, moved


@compiled
def linearise(c: Array, h: float, substeps: int, numbers: Array, starts: Any, given: Array, buffer: Array) -> None:
    """Leave in `buffer` the commands of `given`, moved to within the limits, and the linear model along them."""
    setting, path, u = setting_in(numbers, starts), *path_in(buffer)
    x0, asked, d, _, last = given_in(given)
    for k in range(u.shape[0]):
        u[k, 0], u[k, 1] = asked[k, 0] / BAR, asked[k, 1] / BAR
    limit(setting.bounds, last[0, 0] / BAR, last[0, 1] / BAR, u)
    linear_model(c, x0, u, d, h, substeps, path)
    read_outputs(c, path)


@compiled
def rollout(
    c: Array, h: float, substeps: int, numbers: Array, starts: Any, given: Array, buffer: Array, z: Array
) -> tuple[bool, Array, Array, Array, Array]:
    """Return what follows from `z`: whether all is finite, and commands (N, 2) [Pa], states, K and F (N+1, 2)."""
    bounds, (_, u) = setting_in(numbers, starts).bounds, path_in(buffer)
    x0, _, d, _, last = given_in(given)
    N = u.shape[0]
    moved, x, K, F = np.empty((N, 2)), np.empty((N + 1, 4)), np.empty(N + 1), np.empty((N + 1, 2))
    cumulative(starts, z, moved)
    for k in range(N):
        moved[k, 0] += u[k, 0]
        moved[k, 1] += u[k, 1]
    limit(bounds, last[0, 0] / BAR, last[0, 1] / BAR, moved)
    motion(c, x0, moved, d, h, substeps, x)
    for k in range(N + 1):
        K[k], F[k, 0], F[k, 1] = outputs(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c)
    for k in range(N):
        moved[k, 0] *= BAR
        moved[k, 1] *= BAR
    return finite(moved) and finite(x) and finite(F), moved, x, K, F


@inlined
def motion(c: Array, start: Array, u: Array, d: Array, h: float, substeps: int, x: Array) -> None:
    """Fill in the states `x` (N+1, 4) from `start` (4,) under the commands `u` (N, 2) [bar], in steps of `h` [s]."""
    x0, x1, x2, x3 = start[0], start[1], start[2], start[3]
    x[0, 0], x[0, 1], x[0, 2], x[0, 3] = x0, x1, x2, x3
    for k in range(u.shape[0]):
        for _ in range(substeps):
            k0, k1, k2, k3 = 0.0, 0.0, 0.0, 0.0
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for i in range(4):
                a, b = h * NODES[i], h * SHARES[i]
                k0, k1, k2, k3 = rate(x0 + a * k0, x1 + a * k1, x2 + a * k2, x3 + a * k3, u[k, 0], u[k, 1], d[k], c)
                s0, s1, s2, s3 = s0 + b * k0, s1 + b * k1, s2 + b * k2, s3 + b * k3
            x0, x1, x2, x3 = x0 + s0, x1 + s1, x2 + s2, x3 + s3
        x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], x[k + 1, 3] = x0, x1, x2, x3


@inlined
def linear_model(c: Array, start: Array, u: Array, d: Array, h: float, substeps: int, path: Path) -> None:
    """Fill in the motion and its Jacobians A, B, sample by sample; a column beside them is the motion's own."""
    x, S, K, total = path.x, np.empty((4, 7)), np.empty((4, 7)), np.empty((4, 7))  # S = (A, B, x)
    for i in range(4):
        x[0, i] = S[i, 6] = start[i]
    for k in range(u.shape[0]):
        for i in range(4):
            for j in range(6):
                S[i, j] = 1.0 if i == j else 0.0
        for _ in range(substeps):
            K[:], total[:] = 0.0, 0.0
            for i in range(4):
                stage(c, S, u[k, 0], u[k, 1], d[k], h * NODES[i], h * SHARES[i], K, total)
            for i in range(4):
                for j in range(7):
                    S[i, j] += total[i, j]
        for i in range(4):
            x[k + 1, i] = S[i, 6]
            for j in range(4):
                path.A[k, i, j] = S[i, j]
            for j in range(2):
                path.B[k, i, j] = S[i, 4 + j]


@merged
def stage(c: Array, S: Array, u0: float, u1: float, d: float, a: float, b: float, K: Array, total: Array) -> None:
    """Go from one of Runge and Kutta's slopes, `K` (4, 7), to the next, at S + a K; `total` grows by b times that."""
    x0, x1, x2, x3 = S[0, 6] + a * K[0, 6], S[1, 6] + a * K[1, 6], S[2, 6] + a * K[2, 6], S[3, 6] + a * K[3, 6]
    o = rate_slopes(x0, x1, x2, x3, u0, u1, d, c)
    for j in range(6):
        s0, s1, s2, s3 = S[0, j] + a * K[0, j], S[1, j] + a * K[1, j], S[2, j] + a * K[2, j], S[3, j] + a * K[3, j]
        K[0, j] = o[4] * s0 + o[8] * s1 + o[12] * s2 + o[16] * s3
        K[1, j] = o[5] * s0 + o[9] * s1 + o[13] * s2 + o[17] * s3
        K[2, j] = o[6] * s0 + o[10] * s1 + o[14] * s2 + o[18] * s3
        K[3, j] = o[7] * s0 + o[11] * s1 + o[15] * s2 + o[19] * s3
    for i in range(4):
        K[i, 4] += o[20 + i]
        K[i, 5] += o[24 + i]
        K[i, 6] = o[i]
        for j in range(7):
            total[i, j] += b * K[i, j]


@inlined
def read_outputs(c: Array, path: Path) -> None:
    """Fill in outputs and their gradients along the motion."""
    for k in range(path.x.shape[0]):
        x = path.x[k]
        o = output_slopes(x[0], x[1], x[2], x[3], c)
        for i in range(3):
            path.y[k, i] = o[i]
            for j in range(4):
                path.slope[k, i, j] = o[3 + 3 * j + i]


__all__ = ["feed_forward", "linearise", "rollout"]
