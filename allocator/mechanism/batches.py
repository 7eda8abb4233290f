"""Many targets go through the kernel here: compiled where that pays or has been asked for, else as plain Python."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.compilation import jit
from allocator.joint.limits import BINDS
from allocator.mechanism import kernel
from allocator.mechanism.kernel.data import workspace
from allocator.mechanism.problem import BoxProblem

_PAYS = 5_000  # targets for which a call may wait for the compiler


class Solved(NamedTuple):
    """`Solved` is what a method finds for N problems."""

    x: Array  # P/unit (N, m)
    mu: Array  # multipliers of the rows of the levels before each level (N, K + 1, p); K levels and the reference
    rounds: NDArray[np.int64]  # guesses (N,), 0 where they did not end


def solve(problem: BoxProblem, trajectory: bool = False) -> Solved:
    """Solve by block principal pivoting; `trajectory` begins each with the limits that bind in the one before."""
    (_, ends), (lo, hi, centre) = problem.rows, problem.x_bounds
    N, m, p = *lo.shape, int(ends[-1])
    found = Solved(np.empty((N, m)), np.empty((N, len(ends) + 1, p)), np.zeros(N, np.int64))
    targets = problem.A, problem.b, np.zeros(p, np.bool_), ends, lo, hi, centre, problem.which
    out = found.x, np.zeros((N, m + p), np.int8), found.mu, found.rounds, workspace(p, m, len(ends))
    if problem.pull:
        _loop("weigh_batch", N)(*targets, problem.pull, trajectory, *out)
    else:
        _loop("allocate_batch", N)(*targets, trajectory, *out)
    return found


def residuals(problem: BoxProblem, solved: Solved) -> Array:
    """Return the residual of optimality (N,) of answers, see `allocator.mechanism.certificate`; inf without one."""
    (_, ends), (lo, hi, centre) = problem.rows, problem.x_bounds
    p, m = int(ends[-1]), lo.shape[1]
    out, memory = np.empty(len(lo)), (np.empty(p + m, np.bool_), workspace(p, m, len(ends)))
    targets = problem.A, problem.b, np.zeros(p, np.bool_), ends, lo, hi, centre, problem.which
    _loop("residual_batch", len(lo))(*targets, solved.x, solved.mu, problem.pull, BINDS, out, *memory)
    return np.where(solved.rounds > 0, out, np.inf)


def _loop(name: str, targets: int) -> jit.Function:
    """Return the compiled loop where it is there or pays, else plain Python."""
    plain: jit.Function = getattr(kernel, name)
    return _compiled(name) or plain if targets >= _PAYS or _ready else plain


def loop(name: str) -> jit.Function:
    """Return the loop "allocate_batch" or "residual_batch" of the kernel for who fills its arrays: compiled, if it can.

    numba reads past the end of arrays that are too short.
    """
    plain: jit.Function = getattr(kernel, name)
    return _compiled(name) or plain


@cache
def _compiled(name: str) -> jit.Function | None:
    function = jit.compiled(getattr(kernel, name), kernel.FUNCTIONS, inline=True, unaliased=True)
    if function is not None:
        _ready.append(name)
    return function


_ready: list[str] = []  # loops, once they are compiled


def warm_up() -> bool:
    """Compile now what `allocate` needs for mechanisms, so that later calls are fast; False where it cannot be.

    It takes some twenty seconds after an installation and one or two in a new process. Without it a call with fewer
    than 5 000 targets does not wait for the compiler, and takes about a millisecond a target.
    """
    if _compiled("allocate_batch") is None:
        return False
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    targets = one[None], one, np.zeros(1, np.bool_), np.ones(1, np.int64), zero, one, zero, np.zeros(1, np.int64)
    found = Solved(np.empty((1, 1)), np.empty((1, 2, 1)), np.zeros(1, np.int64))
    memory, out = workspace(1, 1, 1), (np.empty(1), np.empty(2, np.bool_))
    sides = found.x, np.zeros((1, 2), np.int8), found.mu, found.rounds, memory
    _loop("weigh_batch", 1)(*targets, 1.0, False, *sides)
    _loop("allocate_batch", 1)(*targets, False, *sides)
    _loop("residual_batch", 1)(*targets, found.x, found.mu, 0.0, BINDS, *out, memory)
    return bool(found.rounds[0])
