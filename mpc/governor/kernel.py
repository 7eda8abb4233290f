"""One command is governed here: rows that keep the joints in their range, and the nearest pressures that keep the rows.

It is plain Python for arrays that numba compiles as it stands, and that `mpc.export` prints as C.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for arrays; types would say Any
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.kernels.source import clip, interval
from allocator.mechanism.kernel import levels as least_squares
from allocator.mechanism.kernel.data import Box, Levels
from allocator.mechanism.kernel.levels import prepare, solve

SAFE, MOVED, NOT_KEPT, BAD_INPUT = 0, 1, 2, -1
KEPT = 1e-8  # of a row's size: it is exceeded by more
ENORMOUS = 1e30  # [Pa] no command


class Ways(NamedTuple):
    """The `Ways` are what the mechanism's formulas say of a state (`mpc.governor.model`); r of them at ends."""

    gain: Any  # A (m) of the forces A P + B [N/Pa]
    force: Any  # B (m) [N]
    torque_gain: Any  # (n, m) of the torques [N·m/Pa]
    torque: Any  # (n) without pressure [N·m]
    now: Any  # (n) at the pressures now [N·m]
    passed: Any  # (n) how far the joints get until the pressures have followed [rad]
    kinetic: Any  # (1) energy [J]
    work_gain: Any  # (r, m) of the work on the way to an end, over its length [N·m/Pa]
    work: Any  # (r) without pressure, with the load's [N·m]
    way: Any  # (r) how far it is to the end [rad]


class Rules(NamedTuple):
    """The `Rules` are the governor's numbers."""

    load: Any  # (n) greatest torque from outside [N·m]
    most: Any  # (m) supply or validity [Pa]
    least: Any  # [Pa]
    min_force: Any  # [N]
    step: Any  # by which a command may change [Pa]
    near: Any  # a pressure this near to a bound lies on it [Pa]
    unit: Any  # in which pressures are solved for [Pa]
    reaction: Any  # until a command has its effect [s]
    energy: Any  # greatest kinetic energy [J], inf: any


class Memory(NamedTuple):
    """The `Memory` is what `govern` works in, p = r + 1; `memory_for` makes it."""

    rows: Any
    right: Any
    onesided: Any
    ends: Any
    lo: Any
    hi: Any
    centre: Any
    x: Any
    side: Any
    mu: Any


def memory_for(p: int, m: int) -> Memory:
    """Return the memory for p rows and m muscles."""
    return Memory(
        np.empty((p, m)),
        np.empty(p),
        np.empty(p, np.bool_),
        np.empty(1, np.int64),
        np.empty(m),
        np.empty(m),
        np.empty(m),
        np.empty(m),
        np.empty(m + p, np.int8),
        np.empty((2, p)),
    )


def govern_batch(ways, rules, omega, previous, command, safe, status, memory, work):
    """Govern N commands; arrays of `ways` and the others have a leading axis (N), of which `status` (N) is one."""
    for i in range(len(command)):
        one = Ways(
            ways.gain[i],
            ways.force[i],
            ways.torque_gain[i],
            ways.torque[i],
            ways.now[i],
            ways.passed[i],
            ways.kinetic[i],
            ways.work_gain[i],
            ways.work[i],
            ways.way[i],
        )
        found = 0
        for j in range(command.shape[1]):
            taut = (rules.min_force - one.force[j]) / one.gain[j]
            slew = previous[i, j] - rules.step, previous[i, j] + rules.step
            ends = interval((rules.least, rules.most[j], taut, np.inf, slew[0], slew[1]), rules.near)
            memory.lo[j], memory.hi[j], found = ends[0], ends[1], max(found, ends[2])
        status[i] = govern(one, rules, omega[i], previous[i], command[i], found, safe[i], memory, work)


def govern(ways, rules, omega, previous, command, found, safe, memory, work):
    """Fill `safe` (m) with the pressures nearest to `command` (m) that keep the rows; return what became of it.

    Whatever the rows ask for, they lie between `memory.lo` and `memory.hi`, of which `found` says what no pressure can
    keep. `work` is that of the kernel.
    """
    lo, hi, centre = memory.lo, memory.hi, memory.centre
    status = found
    for j in range(len(command)):
        centre[j] = command[j]
        if not abs(command[j]) < ENORMOUS:
            centre[j], status = previous[j], BAD_INPUT
    for j in range(len(command)):
        safe[j] = clip(centre[j], lo[j], hi[j])
        if safe[j] != centre[j] and status == SAFE:
            status = MOVED
    range_rows(ways, rules, memory)
    energy_row(ways, rules, omega, memory)
    if kept(memory, safe, rules.unit):
        return status
    nearest(memory, safe, rules.unit, work)
    if status != SAFE and status != MOVED:
        return status
    return MOVED if kept(memory, safe, rules.unit) else NOT_KEPT


def range_rows(ways, rules, memory):
    """Fill in a row for each posture at an end: held at u, the pressures stop the arm before it gets there.

    That is so if the muscles' work W(u) on the way, and the load's, use up the kinetic energy: ½ ωᵀM ω + W(u) ≤ 0.
    Until the pressures have followed, the joints pass Δ, on which the torques τ(P) do the work and not yet τ(u):
    ½ ωᵀM ω + W(u) + (τ(P) - τ(u))·Δ ≤ 0, here over the length of the way.
    """
    rows, right, passed = memory.rows, memory.right, ways.passed
    early = ways.kinetic[0]
    for i in range(len(passed)):
        early += (ways.now[i] - ways.torque[i]) * passed[i]
    for r in range(len(ways.way)):
        right[r] = -(ways.work[r] + early / ways.way[r])
        for j in range(rows.shape[1]):
            gain = ways.work_gain[r, j]
            for i in range(len(passed)):
                gain -= passed[i] / ways.way[r] * ways.torque_gain[i, j]
            rows[r, j] = gain * rules.unit


def energy_row(ways, rules, omega, memory):
    """Fill in the last row: in the time of reaction the torques' power keeps the kinetic energy below its bound.

    ½ ωᵀM ω + t ω·τ(u) ≤ E, the load included; 0 ≤ 0 where there is no bound.
    """
    rows, right = memory.rows, memory.right
    last = len(right) - 1
    bounded = rules.energy < ENORMOUS
    right[last] = rules.energy / rules.reaction if bounded else 0.0
    for j in range(rows.shape[1]):
        rows[last, j] = 0.0
    if bounded:
        right[last] -= ways.kinetic[0] / rules.reaction
        for i in range(len(omega)):
            right[last] -= omega[i] * ways.torque[i] + abs(omega[i]) * rules.load[i]
            for j in range(rows.shape[1]):
                rows[last, j] += omega[i] * ways.torque_gain[i, j] * rules.unit


def kept(memory, safe, unit):
    """Return whether pressures keep all rows, up to rounding."""
    rows, right = memory.rows, memory.right
    for r in range(len(right)):
        left, size = right[r], abs(right[r])
        for j in range(len(safe)):
            left -= rows[r, j] * safe[j] / unit
            size += abs(rows[r, j])
        if left < -KEPT * size:
            return False
    return True


def nearest(memory, safe, unit, work):
    """Fill `safe` with the pressures nearest to the centre [Pa] that exceed the rows by the least squares."""
    lo, hi, centre, x = memory.lo, memory.hi, memory.centre, memory.x
    for j in range(len(safe)):
        lo[j], hi[j], centre[j] = lo[j] / unit, hi[j] / unit, centre[j] / unit
    for r in range(len(memory.right)):
        memory.onesided[r] = True
    memory.ends[0] = len(memory.right)
    levels = Levels(memory.rows, memory.right, memory.onesided, memory.ends)
    prepare(levels, work)
    if solve(levels, Box(lo, hi, centre), x, memory.side, memory.mu, False, work) > 0:
        for j in range(len(safe)):
            safe[j] = clip(x[j], lo[j], hi[j]) * unit


_OWN: tuple[Callable[..., Any], ...] = (interval, clip, govern, range_rows, energy_row, kept, nearest)
FUNCTIONS = least_squares.FUNCTIONS + _OWN

__all__ = ["FUNCTIONS", "Memory", "Rules", "Ways", "govern_batch", "memory_for"]
