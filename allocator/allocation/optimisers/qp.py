"""Back-end "qp": successive quadratic programmes through qpsolvers."""

import warnings

import numpy as np
from scipy.sparse import csc_matrix

from allocator.allocation.optimisers import sqp
from allocator.allocation.optimisers.backends import Answer
from allocator.allocation.optimisers.sqp import SmallQP
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import MissingBackend

_OPTIONS: dict[str, dict[str, float]] = {  # the solvers' defaults (OSQP 1e-3, DAQP 1e-6) are coarser than these steps
    "daqp": {"primal_tol": 1e-12, "dual_tol": 1e-12},
    "osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 20_000, "raise_error": False},
}


def solve(problem: Problem, solver: str | None = None, warm_start: bool = True) -> Answer:
    """Solve by SQP; `solver` is any QP solver that qpsolvers finds installed, DAQP by default."""
    import qpsolvers

    solver = "daqp" if solver is None else solver
    if solver not in qpsolvers.available_solvers:
        raise MissingBackend("QP solver", solver, qpsolvers.available_solvers)
    sparse = solver in qpsolvers.sparse_solvers and solver not in qpsolvers.dense_solvers

    def solve_qp(qp: SmallQP) -> Array | None:
        form = csc_matrix if sparse else np.asarray
        floor = (None, None) if np.isinf(qp.least_sum) else (form([[-1.0, -1.0]]), np.array([-qp.least_sum]))
        kept = (None, None) if qp.row is None else (form(qp.row[None]), np.array([qp.right]))
        small = qpsolvers.Problem(form(qp.H), qp.g, *floor, *kept, lb=qp.lo, ub=qp.hi)
        with warnings.catch_warnings():  # "maximum iterations reached": every answer is checked by `certificate`
            warnings.simplefilter("ignore", UserWarning)
            solution = qpsolvers.solve_problem(small, solver=solver, **_OPTIONS.get(solver, {}))
        return None if solution.x is None else np.asarray(np.clip(solution.x, qp.lo, qp.hi))

    return sqp.solve(problem, solve_qp, warm_start)
