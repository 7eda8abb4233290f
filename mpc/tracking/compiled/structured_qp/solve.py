"""Solution of the QP along a path, with its proof: a sweep, and an exchange of the limits that it holds wrongly.

`buffer` holds the path, `given` the new data of the step (`mpc.tracking.compiled.records`). A copy of this file is
used, for the reason in `mpc.codegen.modules`.
"""

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.commands import change_bounds, deviations, new_bounded, new_errors
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
from mpc.tracking.compiled.structured_qp.active import Active, new_active
from mpc.tracking.compiled.structured_qp.exchange import exchanged
from mpc.tracking.compiled.structured_qp.riccati import Sweep, give_set, new_sweep, take_set
from mpc.tracking.compiled.structured_qp.sizes import NU, NXI
from mpc.tracking.compiled.structured_qp.start import begin

MOST = 16  # exchanges per decision, at most


@compiled
def settle(numbers: Array, starts: Indices, given: Array, buffer: Array, guess: Signs, z: Array) -> tuple[bool, int]:
    """Return whether `z` (n + 1,) is the QP's proved solution, and the number of exchanges.

    Its last entry is the bound of the suboptimality of the others, which are within slew and supply. `guess` (n,)
    becomes the active set.
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
    errors, bounded, sweep = new_errors(N), new_bounded(N), new_sweep(N)
    at = Point(np.empty((N + 1, NXI)), np.empty((N, NU)), np.empty(NU))
    deviations(path, u, reference, last, errors)
    change_bounds(setting, u, last, bounded)
    limit = int(min(setting.exchanges, 1.0 * MOST * guess.size))
    solved, exchanges, gap = solve(path, errors, setting, bounded, guess, at, sweep, new_active(N, starts.size), limit)
    z[z.size - 1] = gap
    for block in range(starts.size):
        for i in range(NU):
            z[NU * block + i] = at.v[starts[block], i]
    return solved, exchanges


@inlined
def solve(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, guess: Signs, at: Point, sweep: Sweep, a: Active,
    limit: int
) -> tuple[bool, int, float]:  # fmt: skip
    """Set the point to the solution, in at most `limit` exchanges; return whether it is proved, the number of
    exchanges, and the bound of its suboptimality.
    """
    take_set(setting.starts, guess, sweep.held)
    begin(path, errors, setting, bounded, at, sweep, a)
    solved, exchanges, gap = exchanged(path, errors, setting, bounded, at, sweep, a, limit)
    if solved:
        give_set(setting.starts, a.guess, guess)
    return solved, exchanges, gap
