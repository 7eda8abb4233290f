"""What of a step depends on the joint's law, compiled: what to follow, the path to improve, and what comes of it.

This file is a template. `mpc.compiled.module` puts the law of the joint in the place of the lines below that begin with
`LAW`, as functions of scalars that return tuples: `stage` (x, u, d) ↦ (x after a substep, its Jacobian by x and u),
`outputs` x ↦ (y, its Jacobian) with y = (K, F1, F2), `advance` and `look` the same without Jacobians; Jacobians by
columns. `allocated` (θ, K, T) ↦ (P1, P2, T, K, …, sure) is the kernel of `allocator.allocation` for the joint, if there
is one. The array c holds the numbers of all of them, p those of the kernel.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.compiled.certificate import finite
from mpc.compiled.commands import cumulated, limit
from mpc.compiled.jit import compiled, inlined
from mpc.compiled.memory import given_in, path_in, setting_in
from mpc.compiled.records import Path

LAW: Any = None
stage = outputs = advance = look = allocated = LAW


@compiled
def follow(
    c: Array, p: Any, physics: Array, slopes1: Array, slopes2: Array, asked: Array, K: Array, d: Array
) -> tuple[bool, Array, Array, Array, Array, Array, Array]:
    """`mpc.feedforward.FeedForwardLaw`: whether the kernel is sure, and θ, ω, K, P, u and how far all was moved (3,).

    `slopes1`, `slopes2` (N+1, N+1): derivatives of a preview, transposed; `physics`: see `mpc.quick`.
    """
    inertia, damping, gravity, alpha1, alpha2 = physics[0], physics[1], physics[2], physics[3], physics[4]
    left, right, min_force = physics[5], physics[6], physics[7]
    M = asked.size
    theta, omega, speeding = np.empty(M), np.zeros(M), np.zeros(M)
    K_given, P, u, moved, sure = np.empty(M), np.empty((M, 2)), np.empty((M - 1, 2)), np.zeros(3), True
    for j in range(M):
        theta[j] = min(max(asked[j], left), right)
        for k in range(M):
            omega[k] += slopes1[j, k] * theta[j]
            speeding[k] += slopes2[j, k] * theta[j]
    for k in range(M):
        T = inertia * speeding[k] + damping * omega[k] + gravity * np.sin(theta[k]) - d[k]
        found = allocated(theta[k], K[k], T, p, left, right, min_force, c)
        P[k, 0], P[k, 1], K_given[k], sure = found[0], found[1], found[3], sure and found[6]
        moved[0] = max(moved[0], abs(asked[k] - theta[k]))
        moved[1] = max(moved[1], abs(K[k] - K_given[k]))
        moved[2] = max(moved[2], abs(T - found[2]))
        if k > 0:
            u[k - 1, 0] = (P[k, 0] - alpha1 * P[k - 1, 0]) / (1 - alpha1)
            u[k - 1, 1] = (P[k, 1] - alpha2 * P[k - 1, 1]) / (1 - alpha2)
    return sure, theta, omega, K_given, P, u, moved


@compiled
def prepare(c: Array, substeps: int, numbers: Array, starts: Any, given: Array, memory: Array) -> None:
    """Leave in `memory` the commands of `given`, moved to within the limits, and the linear model along them."""
    setting, path, u = setting_in(numbers, starts), *path_in(memory)
    x0, asked, d, _, last = given_in(given)
    for k in range(u.shape[0]):
        u[k, 0], u[k, 1] = asked[k, 0] / BAR, asked[k, 1] / BAR
    limit(setting.room, last[0, 0] / BAR, last[0, 1] / BAR, u)
    slopes(c, x0, u, d, substeps, path)
    read(c, path)


@compiled
def march(
    c: Array, substeps: int, numbers: Array, starts: Any, given: Array, memory: Array, z: Array
) -> tuple[bool, Array, Array, Array, Array]:
    """What follows from `z`: whether all is finite, and commands (N, 2) [Pa], states, K and F (N+1, 2)."""
    room, (_, u) = setting_in(numbers, starts).room, path_in(memory)
    x0, _, d, _, last = given_in(given)
    N = u.shape[0]
    moved, x, K, F = np.empty((N, 2)), np.empty((N + 1, 4)), np.empty(N + 1), np.empty((N + 1, 2))
    cumulated(starts, z, moved)
    for k in range(N):
        moved[k, 0] += u[k, 0]
        moved[k, 1] += u[k, 1]
    limit(room, last[0, 0] / BAR, last[0, 1] / BAR, moved)
    motion(c, x0, moved, d, substeps, x)
    for k in range(N + 1):
        K[k], F[k, 0], F[k, 1] = look(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c)
    for k in range(N):
        moved[k, 0] *= BAR
        moved[k, 1] *= BAR
    return finite(moved) and finite(x) and finite(F), moved, x, K, F


@inlined
def motion(c: Array, start: Array, u: Array, d: Array, substeps: int, x: Array) -> None:
    """The states `x` (N+1, 4) from `start` (4,) under the commands `u` (N, 2) [bar]."""
    x0, x1, x2, x3 = start[0], start[1], start[2], start[3]
    x[0, 0], x[0, 1], x[0, 2], x[0, 3] = x0, x1, x2, x3
    for k in range(u.shape[0]):
        for _ in range(substeps):
            x0, x1, x2, x3 = advance(x0, x1, x2, x3, u[k, 0], u[k, 1], d[k], c)
        x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], x[k + 1, 3] = x0, x1, x2, x3


@inlined
def slopes(c: Array, x0: Array, u: Array, d: Array, substeps: int, path: Path) -> None:
    """The motion and its Jacobians A, B, sample by sample."""
    x, A, B = path.x, path.A, path.B
    for i in range(4):
        x[0, i] = x0[i]
    for k in range(u.shape[0]):
        for i in range(4):
            x[k + 1, i] = x[k, i]
            for j in range(4):
                A[k, i, j] = 1.0 if i == j else 0.0
            for j in range(2):
                B[k, i, j] = 0.0
        for _ in range(substeps):
            now = x[k + 1]
            o = stage(now[0], now[1], now[2], now[3], u[k, 0], u[k, 1], d[k], c)
            for i in range(4):
                now[i] = o[i]
            chain(o, A[k])
            chain(o, B[k])
            for i in range(4):
                B[k, i, 0] += o[20 + i]
                B[k, i, 1] += o[24 + i]


@inlined
def chain(o: Any, S: Array) -> None:
    """S ← (∂x_next/∂x) S; the Jacobian begins at o[4], by columns."""
    for j in range(S.shape[1]):
        s0, s1, s2, s3 = S[0, j], S[1, j], S[2, j], S[3, j]
        for i in range(4):
            S[i, j] = o[4 + i] * s0 + o[8 + i] * s1 + o[12 + i] * s2 + o[16 + i] * s3


@inlined
def read(c: Array, path: Path) -> None:
    """Outputs and their gradients along the motion."""
    for k in range(path.x.shape[0]):
        x = path.x[k]
        o = outputs(x[0], x[1], x[2], x[3], c)
        for i in range(3):
            path.y[k, i] = o[i]
            for j in range(4):
                path.slope[k, i, j] = o[3 + 3 * j + i]


__all__ = ["follow", "march", "prepare"]
