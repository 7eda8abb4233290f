"""A path leads to the best decisions, proved, or to the condensed QP for a solver where these do not come about.

`buffer` holds the path, `given` what is new in the step (`mpc.tracking.compiled.flat_records`). This file is used by
way of a copy, `mpc.tracking.compiled.module` says why.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.certificate import keeps_rows, proved
from mpc.tracking.compiled.commands import deviations, slew_bounds
from mpc.tracking.compiled.condense import condensed, gradient, rows_of
from mpc.tracking.compiled.flat_records import given_in, path_in, setting_in
from mpc.tracking.compiled.jit import compiled
from mpc.tracking.compiled.riccati import moved, settled

SOLVED, ROWS, REFUSED = 0, 1, 2


@compiled
def settle(numbers: Array, starts: Any, given: Array, buffer: Array, guess: Any, sweeps: int) -> tuple[int, Array]:
    """Return SOLVED or why not, and z (n,); `guess` (n,) of the bounds that bind becomes the set found."""
    setting, path, u = setting_in(numbers, starts), *path_in(buffer)
    _, _, _, reference, last = given_in(given)
    errors = deviations(path, u, reference, last)
    lower, upper = slew_bounds(setting, u, last)
    z = np.zeros(lower.size)
    if not settled(path, errors, setting.cost, starts, lower, upper, guess, sweeps, z):
        return REFUSED, z
    there = gradient(path, moved(path, errors, starts, z), setting.cost, starts)
    if not proved(there, lower, upper, z, setting):
        return REFUSED, z
    return SOLVED if keeps_rows(path, setting, u, z) else ROWS, z


@compiled
def build(numbers: Array, starts: Any, given: Array, buffer: Array) -> tuple[Array, Array, Array, Array]:
    """Return H (n, n), f, lower and upper (n,) of the QP of the path without its rows."""
    setting, path, u = setting_in(numbers, starts), *path_in(buffer)
    _, _, _, reference, last = given_in(given)
    H, f = condensed(path, deviations(path, u, reference, last), setting.cost, starts)
    lower, upper = slew_bounds(setting, u, last)
    return H, f, lower, upper


@compiled
def rows(numbers: Array, starts: Any, buffer: Array) -> tuple[Array, Array, Array]:
    """Return R, lower and upper of the whole QP."""
    path, u = path_in(buffer)
    return rows_of(path, u, setting_in(numbers, starts).bounds, starts)


__all__ = ["REFUSED", "ROWS", "SOLVED", "build", "rows", "settle"]
