"""Solution of the QP along a path, with its proof: a sweep, and an exchange of the limits that it holds wrongly.

The sweep begins with the limits of the last QP. If these are far from right, or wrong in many places, or an exchange
has fewer turns left than it needs for what is still violated, a barrier chooses others. When an exchange of these needs
too many turns as well, the barrier goes on from there, to a smaller product.
"""

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.tracking.compiled.commands import HUGE, change_bounds, deviations, new_bounded, new_errors
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Reference, Setting, Signs
from mpc.tracking.compiled.structured_qp.active import Active, astray, new_active
from mpc.tracking.compiled.structured_qp.barrier import guessed
from mpc.tracking.compiled.structured_qp.exchange import based, exchanged
from mpc.tracking.compiled.structured_qp.riccati import Sweep, give_set, new_sweep, take_charges, take_set
from mpc.tracking.compiled.structured_qp.sizes import NU, NXI

MOST = 16  # exchanges per decision, at most
SEARCHES = 3  # from the last set, from that of the barrier, and from that of a finer one
PATIENCE = 16  # exchanges of the first search, at most; twice as many of the second
FAR = 10.0  # [bar] beyond a limit: with a change so far, the barrier comes first; noise takes a set less far
MANY = 7  # runs of changes beyond a limit: with so many, it does as well
CLOSE = 1.0  # [bar] beyond a limit: with no change farther, the barrier resumes from the last set


@inlined
def decide(
    path: Path, u: Array, setting: Setting, reference: Reference, last: Array, guess: Signs, z: Array
) -> tuple[bool, int]:
    """Return whether `z` (n + 1,) is the proved solution of the QP along a path with the commands `u` [bar], and the
    number of exchanges.

    Its last entry is the bound of the suboptimality of the others, which are within slew and supply. `guess` (n,)
    becomes the active set.
    """
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
    at.xi[:], at.v[:], solved, exchanges, gap = 0.0, 0.0, False, 0, HUGE
    take_set(setting.starts, guess, sweep.held)
    take_charges(setting.cost, sweep)
    size = based(path, errors, setting, bounded, 0, at, sweep, a)
    furthest, runs = astray(bounded, sweep.held, sweep, at, a.r)
    hopeful = limit == 0 or (furthest < FAR and runs < MANY)
    for search in range(0 if hopeful else 1, SEARCHES):
        left, fine = limit - exchanges, search == SEARCHES - 1
        if search > 0:
            named = guessed(path, errors, setting, bounded, fine or furthest < CLOSE, fine, at, sweep, a)
            size = based(path, errors, setting, bounded, named, at, sweep, a)
        most = left if fine else min(PATIENCE * (1 + search), left)
        solved, more, gap = exchanged(path, errors, setting, bounded, size, at, sweep, a, most, most == left)
        exchanges += more
        if solved or exchanges == limit:
            break
    if solved:
        give_set(setting.starts, a.guess, guess)
    return solved, exchanges, gap
