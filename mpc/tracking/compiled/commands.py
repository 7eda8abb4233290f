"""Commands and what they may do: within their limits, away from what is wished, moved by decisions."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.tracking.compiled.jit import inlined
from mpc.tracking.compiled.records import Errors, Path, Room, Setting, Wish


@inlined
def limit(room: Room, last1: float, last2: float, u: Array) -> None:
    """Move the commands `u` (N, 2) as `mpc.tracking.limits.Limits.limited` does, all in bar; the last one was (last1,
    last2).
    """
    for i in range(2):
        before = last1 if i == 0 else last2
        for k in range(u.shape[0]):
            wanted = min(max(u[k, i], room.low), room.high)
            before = min(max(wanted, before - room.step), before + room.step)
            u[k, i] = before


@inlined
def bounds(setting: Setting, u: Array, last: Array) -> tuple[Array, Array]:
    """What slew leaves to the changes (n,); z = 0 is allowed whatever rounding says."""
    starts, step = setting.starts, setting.room.step
    lower, upper = np.empty(2 * starts.size), np.empty(2 * starts.size)
    for block in range(starts.size):
        k = starts[block]
        for i in range(2):
            change = u[k, i] - (u[k - 1, i] if k > 0 else last[0, i] / BAR)
            lower[2 * block + i] = min(-step - change, 0.0)
            upper[2 * block + i] = max(step - change, 0.0)
    return lower, upper


@inlined
def cumulated(starts: Any, z: Array, du: Array) -> None:
    """Sets `du` (N, 2) to E z: the sum of the changes up to each command."""
    block, d0, d1 = 0, 0.0, 0.0
    for k in range(du.shape[0]):
        if block < starts.size and starts[block] == k:
            d0 += z[2 * block]
            d1 += z[2 * block + 1]
            block += 1
        du[k, 0], du[k, 1] = d0, d1


@inlined
def carried(A: Array, B: Array, dx: Array, du: Array, after: Array) -> None:
    """One sample of the linear model: dx ← A dx + B du; `after` (4,) is room to work in."""
    for i in range(4):
        after[i] = B[i, 0] * du[0] + B[i, 1] * du[1]
        for j in range(4):
            after[i] += A[i, j] * dx[j]
    for i in range(4):
        dx[i] = after[i]


@inlined
def deviations(path: Path, u: Array, wish: Wish, last: Array) -> Errors:
    """Of a path with the commands `u` (N, 2) [bar]; `last` (2, 2) [Pa]: command and feed-forward before."""
    N, x = u.shape[0], path.x
    theta, omega, K = np.empty(N + 1), np.empty(N + 1), np.empty(N + 1)
    for k in range(N + 1):
        theta[k], omega[k], K[k] = x[k, 0] - wish.theta[k], x[k, 1] - wish.omega[k], path.y[k, 0] - wish.K[k]
    e, change, end = np.empty((N, 2)), np.empty((N, 2)), np.empty(6)
    for i in range(2):
        before = (last[0, i] - last[1, i]) / BAR
        for k in range(N):
            e[k, i] = u[k, i] - wish.u[k, i] / BAR
            change[k, i] = e[k, i] - before
            before = e[k, i]
        end[i] = theta[N] if i == 0 else omega[N]
        end[2 + i] = x[N, 2 + i] - wish.P[N, i]
        end[4 + i] = before
    return Errors(theta, omega, K, e, change, end)


__all__ = ["bounds", "carried", "cumulated", "deviations", "limit"]
