"""Block principal pivoting for many targets: compiled if that pays or `warm_up` was called, else plain Python.

An endpoint with more joints than coordinates is solved by repeated linearisation (`settled`). K_x = Gᵀ K G is concave
in K, with the derivative GᵀdKG, where G maps motions of the hand to the joints (`lifted` in
`allocator.mechanism.endpoint.endpoint`). With constant G it is problem [M]. An answer whose own G is the one it was
solved with satisfies the first-order conditions of the problem with the true K_x. Far beyond reach such steps of Gauss
and Newton oscillate; those that have not converged soon become steps of Newton, by the curvature of K_x
(`allocator.mechanism.endpoint.targets`).

Neighbours on a trajectory mostly share their binding limits, and are solved together. If all rows can be met, the free
variables are those nearest to the centre,

    A_freeᵀ = Q R,   Rᵀ s = b - A c',   x = c' + Q s,   R μ = -s,

c' being the centre, with the other variables at their bounds. The answer is proved by the rules of
`allocator.allocation.box.kernel.levels.violations`: x lies in the box, and the gradient x - c + Aᵀμ holds the others at
their bounds. NumPy takes a tenth of the time of the kernel in plain Python; the compiled kernel needs no help.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.box import kernel
from allocator.allocation.box.kernel.data import workspace
from allocator.allocation.box.kernel.levels import CANCELS, OUTSIDE
from allocator.allocation.box.problem import BoxProblem
from allocator.calculus import Array, Mask
from allocator.compilation import jit
from allocator.joint.limits import BINDS
from allocator.mechanism.mechanism import Indices

_MOST_STEPS = 100
_LINEAR_STEPS = 20  # without the curvature of K_x
_SETTLED = 1e-11  # of E, which is near 1
_FLAT = 1e-14  # the same with curvature, whose rows are of the size of its root
_NEAR = 0.8  # share of the last answer in the centre
_INDEPENDENT = 1e-6  # of the longest row: least remainder of another one
_PAYS = 5_000  # targets for which a call may wait for the compiler


class Solved(NamedTuple):
    """Solution of N problems by a method."""

    x: Array  # P/unit (N, m)
    mu: Array  # multipliers of the rows of the levels before each level (N, K + 1, p); K levels and the reference
    rounds: NDArray[np.int64]  # guesses (N,), 0 if they did not end


def solve(problem: BoxProblem, trajectory: bool = False) -> Solved:
    """Solve by block principal pivoting; with `trajectory` each starts from the limits that bind at the one before."""
    N = len(problem.b)
    if trajectory and not problem.pull and N > 1 and _compiled_loop("allocate_batch", N) is None:
        return _along(problem)
    return _pivoted(problem, slice(N), trajectory)[0]


def _pivoted(problem: BoxProblem, chosen: Indices | slice, trajectory: bool) -> tuple[Solved, NDArray[np.int8]]:
    """Return the solutions of the `chosen` targets, and the sides (…, m + p) of variables and rows."""
    (_, ends), box = problem.rows, problem.x_bounds
    which, b, lo, hi, centre = (array[chosen] for array in (problem.which, problem.b, *box))
    N, m, p = *lo.shape, int(ends[-1])
    found = Solved(np.empty((N, m)), np.empty((N, len(ends) + 1, p)), np.zeros(N, np.int64))
    side = np.zeros((N, m + p), np.int8)
    targets = problem.A, b, np.zeros(p, np.bool_), ends, lo, hi, centre, which
    out = found.x, side, found.mu, found.rounds, workspace(p, m, len(ends))
    if problem.pull:
        _loop("weigh_batch", N)(*targets, problem.pull, trajectory, *out)
    else:
        _loop("allocate_batch", N)(*targets, trajectory, *out)
    return found, side


def _along(problem: BoxProblem) -> Solved:
    """Return the solutions along a trajectory: at once of those with the first one's limits, then of the others."""
    first, side = _pivoted(problem, slice(1), False)
    m = first.x.shape[1]
    x, mu, proved = by_sides(problem.A[problem.which], problem.b, *problem.x_bounds, side[0, :m])
    found = Solved(x, np.zeros((len(x), *first.mu.shape[1:])), proved.astype(np.int64))
    found.mu[:, -1] = mu
    if len(others := np.flatnonzero(~proved)):
        for array, values in zip(found, _pivoted(problem, others, True)[0], strict=True):
            array[others] = values
    return found


class Neighbours(NamedTuple):
    """Answers for N targets with m variables and p rows."""

    x: Array  # (N, m)
    mu: Array  # multipliers of the rows in the last level (N, p)
    proved: Mask  # (N,) whether they are the solutions


def by_sides(A: Array, b: Array, lo: Array, hi: Array, centre: Array, side: NDArray[np.int8]) -> Neighbours:
    """Return the answers for the rows `A` (N, p, m) and `b` (N, p), the box and the centre (N, m) of the targets.

    `side` (m,) of a variable is -1 at lo, 0 free, +1 at hi.
    """
    N, p, m = A.shape
    free = side == 0
    if free.sum() < p:
        return Neighbours(np.zeros((N, m)), np.zeros((N, p)), np.zeros(N, bool))
    start = np.where(free, centre, np.where(side < 0, lo, hi))
    Q, R = np.linalg.qr((A * free).swapaxes(1, 2))
    longest, pivots = np.sqrt((A**2).sum(axis=2).max(axis=1)), np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1)
    independent = pivots > _INDEPENDENT * longest
    R[~independent] = np.eye(p)
    s = np.linalg.solve(R.swapaxes(1, 2), (b - (A @ start[:, :, None])[:, :, 0])[:, :, None])
    x = start + (Q @ s)[:, :, 0]
    mu = np.linalg.solve(R, -s)[:, :, 0]
    gradient = x - centre + (mu[:, None] @ A)[:, 0]
    size = np.abs(x - centre) + (np.abs(A) * np.abs(mu).max(axis=1, initial=0.0)[:, None, None]).sum(axis=1)
    held = np.where(lo < hi, (gradient * side <= 0) | (np.abs(gradient) <= CANCELS * size), side < 0)
    inside = (x >= lo - OUTSIDE) & (x <= hi + OUTSIDE) & (lo < hi)
    proved = independent & np.where(free, inside, held).all(axis=1)
    return Neighbours(np.clip(x, lo, hi), mu, proved)


def residuals(problem: BoxProblem, solved: Solved) -> Array:
    """Return the residual of optimality (N,) (see `allocator.allocation.box.certificate`), inf without an answer."""
    (_, ends), (lo, hi, centre) = problem.rows, problem.x_bounds
    p, m = int(ends[-1]), lo.shape[1]
    out, memory = np.empty(len(lo)), (np.empty(p + m, np.bool_), workspace(p, m, len(ends)))
    targets = problem.A, problem.b, np.zeros(p, np.bool_), ends, lo, hi, centre, problem.which
    _loop("residual_batch", len(lo))(*targets, solved.x, solved.mu, problem.pull, BINDS, out, *memory)
    return np.where(solved.rounds > 0, out, np.inf)


def _loop(name: str, targets: int) -> jit.Function:
    """Return the compiled loop if it is ready or pays, else plain Python."""
    plain: jit.Function = getattr(kernel, name)
    return _compiled_loop(name, targets) or (lambda *arguments: plain(*map(_viewed, arguments)))


def _compiled_loop(name: str, targets: int) -> jit.Function | None:
    return _compiled(name) if targets >= _PAYS or _ready else None


def _viewed(argument: Any) -> Any:
    """Return an array as a view, and one of several targets as a list of views, of which plain Python reads numbers
    twice as quickly.
    """
    if isinstance(argument, tuple):
        return type(argument)(*(memoryview(one) for one in argument))  # the workspace
    if not isinstance(argument, np.ndarray):
        return argument
    view: Any = memoryview
    return view(argument) if argument.ndim == 1 else [view(one) for one in argument]


def loop(name: str) -> jit.Function:
    """Return the loop "allocate_batch" or "residual_batch" of the kernel, compiled if possible.

    The caller supplies the arrays; numba reads past the end of arrays that are too short.
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
    """Compile the code that `allocate` needs for mechanisms now; return False if it cannot be compiled.

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


def settled(problem: BoxProblem, method: Callable[[BoxProblem], Solved]) -> tuple[BoxProblem, Solved]:
    """Solve by `method`; repeat for an endpoint with more joints than coordinates until G converges.

    Returns the last problem and its answer; 0 rounds if G does not converge or `method` fails.
    """
    targets = problem.endpoint
    if targets is None or not targets.redundant:
        return problem, method(problem)
    P, least = np.mean(problem.bounds, axis=0), problem.reference
    K, curved = problem.joint_stiffness(P), np.zeros(problem.size, bool)
    for step in range(_MOST_STEPS):
        # a centre between P_ref and the last P, in fixed shares, leads to the same answer by smaller steps
        centre = _NEAR * P + (1 - _NEAR) * least
        targets, _ = targets.relifted(K, curved)
        problem = replace(problem, endpoint=targets, reference=centre)
        solved = method(problem)
        P = problem.pressures(solved.x)
        K = problem.joint_stiffness(P)
        moved = targets.relifted(K, curved)[1]
        ended = moved <= np.where(curved, _FLAT, _SETTLED)
        if ended.all():
            break
        if step == _LINEAR_STEPS:
            curved = ~ended
    return problem, solved._replace(rounds=np.where(ended, solved.rounds, 0))
