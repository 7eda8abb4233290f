"""A path leads to the best decisions, proved: by sweeps, or where these do not settle by an interior point.

`buffer` holds the path, `given` what is new in the step (`mpc.tracking.compiled.flat_records`). This file is used by
way of a copy, `mpc.tracking.compiled.module` says why.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.certificate import brought_within, keeps_rows, proved
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
    solved, iterations = False, 0
    swept = settled(path, setting, gx, gv, bounded, guess, SWEEPS, at)
    if swept:
        swept = confirmed(path, errors, setting, bounded, at, gx, gv)
        solved = swept and keeps_rows(path, setting, u, at)
    if not solved:
        solved, iterations = persistent(path, errors, setting, u, bounded, swept, guess, at)
    for block in range(starts.size):
        for i in range(2):
            z[2 * block + i] = at.v[starts[block], i]
    return solved, iterations


@inlined
def confirmed(path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, gx: Array, gv: Array) -> bool:
    """Return whether the sweeps' answer is the solution, rows left out."""
    brought_within(bounded, at)
    gradients(path, errors, setting.cost, at, gx, gv)
    r = np.empty(gv.shape)
    adjoint(path, gx, gv, r)
    return proved(r, bounded, at.v, setting)


@inlined
def persistent(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, rows_bind: bool, guess: Any, at: Point
) -> tuple[bool, int]:
    """Return whether the interior point comes to a solution `at`, and after how many iterations."""
    work, iterations, solved = new_work(u.shape[0]), 0, False
    for count in (BOUNDS, ALL):  # both by the same compiled code
        if solved or (count == BOUNDS and rows_bind):
            continue
        spent = interior(path, errors, setting, u, bounded, count, guess, at, work)
        iterations += spent if spent >= 0 else MOST
        if spent >= 0 and count == ALL:
            binding(work.rows, setting.starts, guess)
            brought_within(bounded, at)
            solved = True
        elif spent >= 0:
            proof = confirmed(path, errors, setting, bounded, at, work.gx, work.gv)
            solved = proof and keeps_rows(path, setting, u, at)
    return solved, iterations


__all__ = ["settle"]
