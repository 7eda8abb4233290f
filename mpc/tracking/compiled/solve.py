"""A path leads to the best decisions, proved: by sweeps, or where these do not settle by an interior point.

`buffer` holds the path, `given` what is new in the step (`mpc.tracking.compiled.flat_records`). This file is used by
way of a copy, `mpc.tracking.compiled.module` says why.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.certificate import brought_within, needed, proved
from mpc.tracking.compiled.commands import deviations, slew_bounds
from mpc.tracking.compiled.flat_records import given_in, path_in, setting_in
from mpc.tracking.compiled.interior import MOST, binding, interior, new_point, new_work
from mpc.tracking.compiled.jit import compiled, inlined
from mpc.tracking.compiled.newton import ALL, BOUNDS, adjoint, gradients
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.riccati import settled

SWEEPS = 2  # before the interior point


@compiled
def settle(numbers: Array, starts: Any, given: Array, buffer: Array, guess: Any, z: Array) -> tuple[bool, int]:
    """Return whether `z` (n,) is the QP's proved solution, and how many iterations of the interior point that took.

    `guess` (n,) of the bounds that bind becomes the set found.
    """
    setting, path, u = setting_in(numbers, starts), *path_in(buffer)
    _, _, _, reference, last = given_in(given)
    errors, N = deviations(path, u, reference, last), u.shape[0]
    bounded = Bounded(np.empty((N, 2)), np.empty((N, 2)), np.empty(N, np.bool_))
    slew_bounds(setting, u, last, bounded)
    at, gx, gv = new_point(N), np.empty((N + 1, 6)), np.empty((N, 2))
    at.xi[:], at.v[:] = 0.0, 0.0
    gradients(path, errors, setting.cost, at, gx, gv)
    solved, iterations = True, 0
    swept = settled(path, setting, gx, gv, bounded, guess, SWEEPS, at)
    brought_within(path, bounded, at)
    swept = swept and confirmed(path, errors, setting, bounded, at, gx, gv)
    count = needed(path, setting, u, at)
    if not swept or count > BOUNDS:
        solved, iterations = persistent(path, errors, setting, u, bounded, count, guess, at)
    for block in range(starts.size):
        for i in range(2):
            z[2 * block + i] = at.v[starts[block], i]
    return solved, iterations


@inlined
def confirmed(path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, gx: Array, gv: Array) -> bool:
    """Return whether the point, within its bounds, is the solution but for the rows."""
    gradients(path, errors, setting.cost, at, gx, gv)
    r = np.empty(gv.shape)
    adjoint(path, gx, gv, r)
    return proved(r, bounded, at.v, setting)


@inlined
def persistent(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, count: int, guess: Any, at: Point
) -> tuple[bool, int]:
    """Return whether the interior point comes to a solution `at`, and after how many iterations.

    It begins with the first `count` rows of every sample, and again with more where the solution breaks others.
    """
    work, iterations = new_work(u.shape[0]), 0
    while True:
        spent = interior(path, errors, setting, u, bounded, count, guess, at, work)
        iterations += spent if spent >= 0 else MOST
        solved = spent >= 0
        brought_within(path, bounded, at)
        if solved and count == BOUNDS:
            solved = confirmed(path, errors, setting, bounded, at, work.gx, work.gv)
        elif solved:
            binding(work.rows, setting.starts, guess)
        more = needed(path, setting, u, at) if solved else ALL
        if count == ALL or (solved and more <= count):
            return solved, iterations
        count = more


__all__ = ["settle"]
