"""Proved solution of the QP about a path: by a sweep; if that does not settle, by an exchange of its set; if that takes
too long, by an interior point.

`buffer` holds the path, `given` the new data of the step (`mpc.tracking.compiled.records`). A copy of this file is
used, for the reason in `mpc.codegen.modules`.
"""

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.commands import deviations, new_errors, slew_bounds
from mpc.tracking.compiled.records import (
    Bounded,
    Errors,
    Indices,
    Path,
    Point,
    Reference,
    Setting,
    Signs,
    given_in,
    path_in,
    setting_in,
)
from mpc.tracking.compiled.structured_qp.active_set import active_set, new_active, reversed_instead
from mpc.tracking.compiled.structured_qp.certificate import brought_within, confirmed, needed
from mpc.tracking.compiled.structured_qp.exchange import Active
from mpc.tracking.compiled.structured_qp.interior import MOST, Work, interior, new_point, new_work
from mpc.tracking.compiled.structured_qp.newton import adjoint, gradients
from mpc.tracking.compiled.structured_qp.riccati import Sweep, give_set, new_sweep, settled, take_set
from mpc.tracking.compiled.structured_qp.sizes import BOUNDS, NU


@compiled
def settle(numbers: Array, starts: Indices, given: Array, buffer: Array, guess: Signs, z: Array) -> tuple[bool, int]:
    """Return whether `z` (n,) is the QP's proved solution, and the number of iterations of the interior point.

    `guess` (n,) of the active bounds becomes the set found.
    """
    setting, (path, u) = setting_in(numbers, starts), path_in(buffer)
    _, _, _, reference, last = given_in(given)
    return decide(path, u, setting, reference, last, guess, z)


@inlined
def decide(
    path: Path, u: Array, setting: Setting, reference: Reference, last: Array, guess: Signs, z: Array
) -> tuple[bool, int]:
    """Return the results of `settle` for a path with the commands `u` [bar]."""
    N, starts = u.shape[0], setting.starts
    errors, at, sweep = new_errors(N), new_point(N), new_sweep(N)
    deviations(path, u, reference, last, errors)
    bounded = Bounded(np.empty((N, NU)), np.empty((N, NU)), np.empty(N, np.bool_))
    slew_bounds(setting, u, last, bounded)
    solved, iterations = True, 0
    count = swept(path, errors, setting, u, bounded, guess, at, sweep, new_active(N))
    if count > 0:
        work = new_work(N, sweep)
        solved, iterations = persistent(path, errors, setting, u, bounded, count, guess, at, work, MOST)
    for block in range(starts.size):
        for i in range(NU):
            z[NU * block + i] = at.v[starts[block], i]
    return solved, iterations


@inlined
def swept(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, guess: Signs, at: Point, sweep: Sweep,
    a: Active
) -> int:  # fmt: skip
    """Set the point to the result of a sweep or an exchange of its set; return 0 if that is the proved solution, or the
    number of rows of every sample with which the interior point has to begin.
    """
    if begun(path, errors, setting, bounded, guess, at, sweep, a):
        brought_within(path, bounded, at)
        proved = confirmed(path, errors, setting, bounded, at, sweep.gx, sweep.gv, sweep.r)
        if proved and needed(path, setting, u, at, setting.tolerance) == BOUNDS:
            return 0
    held_gradient(path, errors, setting, guess, at, sweep)
    if reversed_instead(path, errors, setting, bounded, at, sweep, a):
        give_set(setting.starts, sweep.held, guess)
        begun(path, errors, setting, bounded, guess, at, sweep, a)
        held_gradient(path, errors, setting, guess, at, sweep)
    if active_set(path, errors, setting, u, bounded, at, sweep, a):
        give_set(setting.starts, sweep.held, guess)
        return 0
    brought_within(path, bounded, at)
    return needed(path, setting, u, at, setting.tolerance)


@inlined
def begun(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, guess: Signs, at: Point, sweep: Sweep, a: Active
) -> bool:  # fmt: skip
    """Set the point to the result of a sweep; return whether that settles the QP without its rows."""
    at.xi[:], at.v[:], at.sigma[:] = 0.0, 0.0, 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, a.first)
    return settled(path, setting, sweep.gx, sweep.gv, bounded, guess, 1, at, sweep)


@inlined
def held_gradient(path: Path, errors: Errors, setting: Setting, guess: Signs, at: Point, sweep: Sweep) -> None:
    """Hold the changes of the guess again, and set the gradient by v at the point."""
    take_set(setting.starts, guess, sweep.held)
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.r)


@inlined
def persistent(
    path: Path, errors: Errors, setting: Setting, u: Array, bounded: Bounded, count: int, guess: Signs, at: Point,
    work: Work, limit: int
) -> tuple[bool, int]:  # fmt: skip
    """Return whether the interior point finds a solution `at`, and the number of iterations.

    It begins with the first `count` rows of every sample, adds violated ones, and takes at most `limit` iterations.
    """
    iterations = interior(path, errors, setting, u, bounded, count, guess, at, work, limit)
    brought_within(path, bounded, at)
    return iterations >= 0, iterations if iterations >= 0 else limit
