"""QP solvers by name: DAQP directly (the default), and whatever qpsolvers finds installed.

A solver is a function from a `QP` to a point and its multipliers, or None when it gives up. What it returns is only a
proposal: `mpc.controller` certifies it.
"""

import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from allocator.calculus import Array
from allocator.errors import MissingBackend
from mpc.qp import QP

Solver: TypeAlias = Callable[[QP], tuple[Array, Array] | None]

_SETTINGS: dict[str, dict[str, Any]] = {
    # OSQP's own 1e-3 calls "solved" what is off by up to 8 % of the range
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 50_000, "polishing": True, "raise_error": False},
    "scs": {"eps_abs": 1e-8, "eps_rel": 1e-8},
}


def solver(name: str) -> Solver:
    """The solver called `name`; `MissingBackend` lists the names there are."""
    if name == "daqp":
        return _daqp
    import qpsolvers

    if name not in qpsolvers.available_solvers:
        raise MissingBackend("QP solver", name, {"daqp", *qpsolvers.available_solvers})
    return _through_qpsolvers(name)


def _daqp(qp: QP) -> tuple[Array, Array] | None:
    import daqp

    upper, lower = np.concatenate([qp.upper, qp.rows_upper]), np.concatenate([qp.lower, qp.rows_lower])
    z, _, flag, info = daqp.solve(qp.H, qp.f, qp.R, upper, lower)
    return (z, info["lam"]) if flag > 0 else None


def _through_qpsolvers(name: str) -> Solver:
    import qpsolvers
    from scipy.sparse import csc_matrix

    matrix = np.asarray if name in qpsolvers.dense_solvers else csc_matrix

    def solve(qp: QP) -> tuple[Array, Array] | None:
        rows, bounds = np.concatenate([qp.R, -qp.R]), np.concatenate([qp.rows_upper, -qp.rows_lower])
        used = np.isfinite(bounds)
        problem = qpsolvers.Problem(matrix(qp.H), qp.f, matrix(rows[used]), bounds[used], lb=qp.lower, ub=qp.upper)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a failure is seen from the answer, no need to be told twice
            try:
                found = qpsolvers.solve_problem(problem, name, **_SETTINGS.get(name, {}))
            except (qpsolvers.SolverError, qpsolvers.ProblemError):
                return None
        if found.x is None or found.z is None or found.z_box is None:
            return None
        pushes = np.zeros(bounds.size)
        pushes[used] = found.z
        above, below = np.split(pushes, 2)
        return found.x, np.concatenate([found.z_box, above - below])

    return solve


__all__ = ["Solver", "solver"]
