"""A path leads to the best decisions, proved: by sweeps, or where these do not settle by an interior point.

`buffer` holds the path, `given` what is new in the step (`mpc.tracking.compiled.flat_records`). This file is used by
way of a copy, `mpc.tracking.compiled.module` says why.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.commands import deviations, new_errors, slew_bounds
from mpc.tracking.compiled.flat_records import given_in, path_in, setting_in
from mpc.tracking.compiled.jit import compiled, inlined
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.active_set import Active, active_set, new_active, reversed_instead
from mpc.tracking.compiled.structured_qp.certificate import brought_within, confirmed, needed
from mpc.tracking.compiled.structured_qp.interior import MOST, Work, interior, new_point, new_work
from mpc.tracking.compiled.structured_qp.newton import ALL, BOUNDS, adjoint, gradients
from mpc.tracking.compiled.structured_qp.riccati import Sweep, give_set, new_sweep, settled, take_set


@compiled
def settle(numbers: Array, starts: Any, given: Array, buffer: Array, guess: Any, z: Array) -> tuple[bool, int]:
    """Return whether `z` (n,) is the QP's proved solution, and how many iterations of the interior point that took.

    `guess` (n,) of the bounds that bind becomes the set found.
    """
    setting, path, u = setting_in(numbers, starts), *path_in(buffer)
    _, _, _, reference, last = given_in(given)
    N = u.shape[0]
    errors, at, sweep = new_errors(N), new_point(N), new_sweep(N)
    deviations(path, u, reference, last, errors)
    bounded = Bounded(np.empty((N, 2)), np.empty((N, 2)), np.empty(N, np.bool_))
    slew_bounds(setting, u, last, bounded)
    solved, iterations = True, 0
    count = swept(path, errors, setting, u, bounded, guess, at, sweep, new_active(N))
    if count > 0:
        work = new_work(N, sweep)
        solved, iterations = persistent(path, errors, setting, u, bounded, count, guess, at, work, MOST)
    for block in range(starts.size):
        for i in range(2):
            z[2 * block + i] = at.v[starts[block], i]
    return solved, iterations


@inlined
def swept(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, guess: Any, at: Point, sweep: Sweep,
    a: Active
) -> int:
    """Set the point to what sweeps come to; return 0 if that is the proved solution, or how many rows of every sample
    the interior point is to begin with.
    """
    at.xi[:], at.v[:] = 0.0, 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.r)
    first, other = sweep.r.copy(), new_point(path.A.shape[0])
    if settled(path, setting, sweep.gx, sweep.gv, bounded, guess, 1, at, sweep):
        brought_within(path, bounded, at)
        if confirmed(path, errors, setting, bounded, at, sweep.gx, sweep.gv, sweep.r):
            if needed(path, setting, u, at, setting.tolerance) == BOUNDS:
                return 0
    take_set(setting.starts, guess, sweep.held)
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.r)
    if reversed_instead(path, errors, setting, bounded, first, at, other, sweep):
        give_set(setting.starts, sweep.held, guess)
        at.xi[:], at.v[:] = 0.0, 0.0
        gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
        settled(path, setting, sweep.gx, sweep.gv, bounded, guess, 1, at, sweep)
        take_set(setting.starts, guess, sweep.held)
        gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
        adjoint(path, sweep.gx, sweep.gv, sweep.r)
    if active_set(path, errors, setting, u, bounded, ALL, at, sweep, a):
        give_set(setting.starts, sweep.held, guess)
        return 0
    return needed(path, setting, u, at, setting.tolerance)


@inlined
def persistent(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, count: int, guess: Any, at: Point,
    work: Work, limit: int
) -> tuple[bool, int]:  # fmt: skip
    """Return whether the interior point comes to a solution `at`, and after how many iterations.

    It begins with the first `count` rows of every sample, adds others that are broken, and takes `limit` iterations at
    most.
    """
    iterations = interior(path, errors, setting, u, bounded, count, guess, at, work, limit)
    brought_within(path, bounded, at)
    return iterations >= 0, iterations if iterations >= 0 else limit


__all__ = ["settle"]
