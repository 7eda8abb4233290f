"""Back-end "convex": the allocation problem in cvxpy.

For affine muscles every goal is a convex quadratic programme and one solve is exact; other muscles are linearised
around the answer until it converges. The cvxpy problem is built once for each kind of goal, with all changing data as
`Parameter` (disciplined parametrised programming), so that repeated solves skip the canonicalisation.
"""

import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from allocator.allocation.optimisers import sqp
from allocator.allocation.optimisers.backends import Answer
from allocator.allocation.optimisers.sqp import SmallQP
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import MissingBackend

if TYPE_CHECKING:
    import cvxpy

Further: TypeAlias = Callable[["cvxpy.Variable", dict[str, "cvxpy.Parameter"]], list["cvxpy.Constraint"]]

_SOLVERS = {
    "clarabel": {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11},
    "osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 20_000},
}


class Programme(NamedTuple):
    """Programme: minimise ‖A d + b‖² over lo ≤ d ≤ hi, with or without floor, kept goal and further constraints."""

    problem: "cvxpy.Problem"
    d: "cvxpy.Variable"
    parameters: dict[str, "cvxpy.Parameter"]

    def run(self, values: Mapping[str, object], solver: str) -> bool:
        """Solve for these parameters; return whether `d` has a value, which the caller must verify."""
        import cvxpy

        for name, parameter in self.parameters.items():
            parameter.value = values[name]
        try:
            with warnings.catch_warnings():  # "may be inaccurate": every answer is checked
                warnings.simplefilter("ignore", UserWarning)
                self.problem.solve(solver=solver.upper(), **_SOLVERS[solver])
        except cvxpy.SolverError:
            return False
        return self.problem.status in ("optimal", "optimal_inaccurate")


def solve(problem: Problem, solver: str | None = None, warm_start: bool = True) -> Answer:
    """Solve by cvxpy; `solver` is "clarabel" (default) or "osqp"."""
    solver = "clarabel" if solver is None else solver
    if solver not in _SOLVERS:
        raise MissingBackend("convex solver", solver, _SOLVERS)

    def solve_qp(qp: SmallQP) -> Array | None:
        return _solve(qp, solver)

    return sqp.solve(problem, solve_qp, warm_start)


def _solve(qp: SmallQP, solver: str) -> Array | None:
    programme = _programme(floor=bool(np.isfinite(qp.least_sum)), kept=qp.row is not None)
    factor = np.linalg.cholesky(qp.H).T  # ½ dᵀH d + gᵀd = ½ ‖A d + b‖² + constant, A = factor, Aᵀb = g
    values = {
        "A": factor,
        "b": np.linalg.solve(factor.T, qp.g),
        "lo": qp.lo,
        "hi": qp.hi,
        "least": qp.least_sum,
        "row": qp.row,
        "right": qp.right,
    }
    if not programme.run(values, solver):
        return None
    return np.asarray(np.clip(programme.d.value, qp.lo, qp.hi))


@lru_cache(maxsize=4)
def _programme(floor: bool, kept: bool) -> Programme:
    return programme_of(2, floor, kept, lambda d, parameters: [])


def programme_of(rows: int, floor: bool, kept: bool, further: Further) -> Programme:
    """Return the programme with A (rows, 2), and with the constraints `further`, which adds its parameters."""
    import cvxpy

    d = cvxpy.Variable(2)
    p = {name: cvxpy.Parameter(shape) for name, shape in (("A", (rows, 2)), ("b", rows), ("lo", 2), ("hi", 2))}
    constraints = [d >= p["lo"], d <= p["hi"]]
    if floor:
        p["least"] = cvxpy.Parameter()
        constraints.append(cvxpy.sum(d) >= p["least"])
    if kept:
        p["row"], p["right"] = cvxpy.Parameter(2), cvxpy.Parameter()
        constraints.append(p["row"] @ d == p["right"])
    constraints += further(d, p)
    return Programme(cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(p["A"] @ d + p["b"])), constraints), d, p)
