"""QP solvers by name: DAQP directly (the default), and whatever qpsolvers finds installed.

A solver is a function from a `QP` and the time it may take to a point and its multipliers, or None when it gives up.
What it returns is only a proposal: `mpc.tracking.qp.certified` checks it, and looks at the clock. Of an exception
`guarded` makes None, and of what is no pair of arrays of the right lengths, full of numbers: no solver's fault stops a
joint. MemoryError is such an exception; KeyboardInterrupt and SystemExit, which are not the solver's, go through.
"""

import warnings
from math import inf, isfinite
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import MissingBackend
from mpc.tracking.qp.programme import QP


class Solver(Protocol):
    """See above."""

    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        """Point (n,) and multipliers (n + m,) of `qp` within `limit` [s]."""


_SETTINGS: dict[str, dict[str, Any]] = {
    # OSQP's own 1e-3 calls "solved" what is off by up to 8 % of the range
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 50_000, "polishing": True, "raise_error": False},
    "clarabel": {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12},  # 1e-8 of the cost is 0.4 bar
    "scs": {"eps_abs": 1e-8, "eps_rel": 1e-8},
}
_TIME_LIMITS = {"osqp": "time_limit", "clarabel": "time_limit", "scs": "time_limit_secs"}  # settings [s]


def solver(name: str) -> Solver:
    """The solver called `name`; `MissingBackend` lists the names there are."""
    if name == "daqp":
        return daqp
    import qpsolvers

    if name not in qpsolvers.available_solvers:
        raise MissingBackend("QP solver", name, {"daqp", *qpsolvers.available_solvers})
    return guarded(_through_qpsolvers(name))


def guarded(solve: Solver) -> Solver:
    """`solve`, giving up where it would fail; `daqp`, which does not raise, stays itself
    (`mpc.tracking.compiled.qp_step` looks for it).
    """
    if solve is daqp:
        return solve

    def proposed(qp: QP, limit: float = inf) -> tuple[Array, Array] | None:
        try:
            z, multipliers = (np.asarray(part, float) for part in solve(qp, limit) or (None, None))
        except Exception:
            return None
        right = z.shape == qp.f.shape and multipliers.shape == (qp.f.size + len(qp.R),)
        return (z, multipliers) if right and np.isfinite(z).all() and np.isfinite(multipliers).all() else None

    return proposed


def daqp(qp: QP, limit: float = inf) -> tuple[Array, Array] | None:
    """By DAQP, an active-set method for small dense QPs."""
    from daqp import solve

    upper, lower = qp.upper, qp.lower
    if len(qp.R):
        upper, lower = np.concatenate([upper, qp.rows_upper]), np.concatenate([lower, qp.rows_lower])
    marks = None if qp.guess is None else _marks(qp.guess)
    seconds = limit if isfinite(limit) else 0.0  # 0: as long as it takes
    z, _, flag, info = solve(qp.H, qp.f, qp.R, upper, lower, marks, time_limit=seconds)
    return (z, info["lam"]) if flag > 0 else None


_ACTIVE, _AT_LOWER = 1, 2  # bits of DAQP's marks


def _marks(guess: NDArray[Any]) -> NDArray[np.intc]:
    """DAQP's marks of the limits that are guessed to bind: those with multipliers."""
    marks: NDArray[np.intc] = _ACTIVE * (guess != 0).astype(np.intc) + _AT_LOWER * (guess < 0).astype(np.intc)
    return marks


def _through_qpsolvers(name: str) -> Solver:
    import qpsolvers
    from scipy.sparse import csc_matrix

    matrix = np.asarray if name in qpsolvers.dense_solvers else csc_matrix

    def solve(qp: QP, limit: float = inf) -> tuple[Array, Array] | None:
        rows, bounds = np.concatenate([qp.R, -qp.R]), np.concatenate([qp.rows_upper, -qp.rows_lower])
        used = np.isfinite(bounds)
        problem = qpsolvers.Problem(matrix(qp.H), qp.f, matrix(rows[used]), bounds[used], lb=qp.lower, ub=qp.upper)
        settings = dict(_SETTINGS.get(name, {}))
        if name in _TIME_LIMITS and isfinite(limit):
            settings[_TIME_LIMITS[name]] = limit
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a failure is seen from the answer, no need to be told twice
            found = qpsolvers.solve_problem(problem, name, **settings)
        if found.x is None or found.z is None or found.z_box is None:
            return None
        pushes = np.zeros(bounds.size)
        pushes[used] = found.z
        above, below = np.split(pushes, 2)
        return found.x, np.concatenate([found.z_box, above - below])

    return solve


__all__ = ["Solver", "daqp", "guarded", "solver"]
