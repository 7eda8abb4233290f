"""Limits of commands, their deviations from the reference, and their changes by decisions."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import inlined
from mpc.tracking.compiled.records import Bounded, Errors, Indices, Path, Reference, Setting
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, NX, NXI, NY
from mpc.tracking.compiled.structured_qp.stage import first_of

HUGE = 1e30  # no bound


@inlined
def limit(low: float, high: float, step: float, before: Array, unit: float, commands: Array) -> None:
    """Move `commands` (N, m) as `mpc.tracking.limits.Limits.limited` does; the last one was `before` (m,) / `unit`.

    The slew limit has priority: from outside the supply's range, commands return as fast as it permits.
    """
    for i in range(NU):
        last = before[i] / unit
        for k in range(commands.shape[0]):
            wanted = min(max(commands[k, i], low), high)
            last = min(max(wanted, last - step), last + step)
            commands[k, i] = last


@inlined
def excess(left: Any, right: Any, least: float, states: Array, forces: Array, beyond: Array) -> None:
    """Set `beyond` (2,) to the excursions of a motion from the joint ranges [rad] and below the least force [N].

    The first state does not count for the force.
    """
    beyond[0] = beyond[1] = 0.0
    for k in range(states.shape[0]):
        for i in range(JOINTS):
            beyond[0] = max(beyond[0], first_of(left, i) - states[k, i], states[k, i] - first_of(right, i))
        for i in range(NU if k > 0 else 0):
            beyond[1] = max(beyond[1], least - forces[k, i])


@inlined
def new_bounded(N: int) -> Bounded:
    """Return uninitialised bounds."""
    ends = np.empty((4, N + 1, NU))
    return Bounded(ends[0], ends[1], ends[2], ends[3], np.empty(N, np.bool_))


@inlined
def change_bounds(setting: Setting, u: Array, last: Array, bounded: Bounded) -> None:
    """Set the bounds of changes and commands of every block by slew and supply.

    v = 0 is feasible despite rounding, and commands outside the supply need not return at once.
    """
    bounds, N, there = setting.bounds, u.shape[0], bounded.there
    bounded.lower[:], bounded.upper[:], bounded.low[:], bounded.high[:], there[:] = 0.0, 0.0, -HUGE, HUGE, False
    for k in setting.starts:
        there[k] = True
    for i in range(NU):
        start = 0
        bounded.upper[N, i] = HUGE if i < 2 else 0.0  # of the slacks
        for k in range(N):
            if there[k]:
                start = k
                change = u[k, i] - (u[k - 1, i] if k > 0 else last[0, i] / BAR)
                bounded.lower[k, i] = min(-bounds.step - change, 0.0)
                bounded.upper[k, i] = max(bounds.step - change, 0.0)
            bounded.low[start, i] = max(bounded.low[start, i], min(bounds.low - u[k, i], 0.0))
            bounded.high[start, i] = min(bounded.high[start, i], max(bounds.high - u[k, i], 0.0))


@inlined
def cumulative(starts: Indices, z: Array, du: Array) -> None:
    """Set `du` (N, m) to E z, the sum of the changes up to each command."""
    for i in range(NU):
        block, change = 0, 0.0
        for k in range(du.shape[0]):
            if block < starts.size and starts[block] == k:
                change += z[NU * block + i]
                block += 1
            du[k, i] = change


@inlined
def new_errors(N: int) -> Errors:
    """Return uninitialised errors."""
    return Errors(np.empty((N + 1, NX)), np.empty((N + 1, NY)), np.empty((N, NU)), np.empty((N, NU)), np.empty(NXI))


@inlined
def deviations(path: Path, u: Array, reference: Reference, last: Array, errors: Errors) -> None:
    """Set the errors of a path with the commands `u` (N, 2) [bar]; `last` (2, 2) [Pa]: previous command and
    feed-forward.
    """
    N = u.shape[0]
    x, y, e, change, end = errors
    for k in range(N + 1):
        for i in range(NX):
            x[k, i] = path.x[k, i] - reference.x[k, i]
        for i in range(NY):
            y[k, i] = path.y[k, i] - reference.y[k, i]
    for i in range(NU):
        previous = (last[0, i] - last[1, i]) / BAR
        for k in range(N):
            e[k, i] = u[k, i] - reference.u[k, i] / BAR
            change[k, i] = e[k, i] - previous
            previous = e[k, i]
        end[NX + i] = previous
    for i in range(NX):
        end[i] = x[N, i]


@inlined
def finite(array: Array) -> bool:
    """Return whether all numbers of `array` (m, n) are finite."""
    for row in array:
        for value in row:
            if not np.isfinite(value):
                return False
    return True
