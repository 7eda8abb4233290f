"""Limits of commands, their deviations from the reference, and their changes by decisions."""

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import inlined
from mpc.tracking.compiled.records import Bounded, Errors, Indices, Path, Reference, Setting
from mpc.tracking.compiled.structured_qp.sizes import NU, NX, NXI, NY


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
def excess(left: float, right: float, least: float, states: Array, forces: Array, beyond: Array) -> None:
    """Set `beyond` (2,) to the excursions of a motion from the joint range [rad] and below the least force [N].

    The first state does not count for the force.
    """
    beyond[0] = beyond[1] = 0.0
    for k in range(states.shape[0]):
        beyond[0] = max(beyond[0], left - states[k, 0], states[k, 0] - right)
        if k > 0:
            beyond[1] = max(beyond[1], least - forces[k, 0], least - forces[k, 1])


@inlined
def slew_bounds(setting: Setting, u: Array, last: Array, bounded: Bounded) -> None:
    """Set the bounds of the changes by slew; v = 0 is feasible despite rounding."""
    starts, step = setting.starts, setting.bounds.step
    lower, upper, there = bounded
    lower[:], upper[:], there[:] = 0.0, 0.0, False
    for k in starts:
        there[k] = True
        for i in range(NU):
            change = u[k, i] - (u[k - 1, i] if k > 0 else last[0, i] / BAR)
            lower[k, i], upper[k, i] = min(-step - change, 0.0), max(step - change, 0.0)


@inlined
def cumulative(starts: Indices, z: Array, du: Array) -> None:
    """Set `du` (N, 2) to E z, the sum of the changes up to each command."""
    block, d0, d1 = 0, 0.0, 0.0
    for k in range(du.shape[0]):
        if block < starts.size and starts[block] == k:
            d0 += z[2 * block]
            d1 += z[2 * block + 1]
            block += 1
        du[k, 0], du[k, 1] = d0, d1


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
