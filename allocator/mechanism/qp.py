"""The readable road to problem [M] is one QP a level through qpsolvers, what was achieved before as its equalities."""

import warnings

import numpy as np

from allocator.calculus import Array
from allocator.errors import MissingBackend
from allocator.mechanism.batches import Solved
from allocator.mechanism.mechanism import Indices
from allocator.mechanism.problem import BoxProblem

Box = tuple[Array, Array, Array]
"""(lo, hi, centre) of x, each (m,)."""

_MET = 1e-10  # of the right-hand sides: a residual below it is the solver's tolerance

_OPTIONS: dict[str, dict[str, float]] = {"daqp": {"primal_tol": 1e-9, "dual_tol": 1e-10}}


def solve(problem: BoxProblem, solver: str | None = None) -> Solved:
    """Solve target after target, by DAQP or another of qpsolvers. Raises `MissingBackend` for one that there is not."""
    import qpsolvers

    solver = "daqp" if solver is None else solver
    if solver not in qpsolvers.available_solvers:
        raise MissingBackend("QP solver", solver, qpsolvers.available_solvers)
    (_, ends), (lo, hi, centre) = problem.rows, problem.x_bounds
    x, mu = np.array(lo), np.zeros((len(lo), len(ends) + 1, ends[-1]))
    rounds = np.ones(len(lo), np.int64)
    for i in range(len(lo)):
        A, b, box = problem.A[problem.which[i]], problem.b[i], (lo[i], hi[i], centre[i])
        x[i], mu[i], solved = (
            _weighed(A, b, problem.pull, box, solver) if problem.pull else _levels(A, b, ends, box, solver)
        )
        rounds[i] = solved
    return Solved(x, mu, rounds)


def _levels(A: Array, b: Array, ends: Indices, box: Box, solver: str) -> tuple[Array, Array, bool]:
    """Return (x, multipliers, whether all levels were solved) of one target."""
    lo, hi, centre = box
    x, mu, begin, m = np.clip(centre, lo, hi), np.zeros((len(ends) + 1, len(A))), 0, len(lo)
    for k, end in enumerate([*ends, None]):
        G = np.eye(m) if end is None else A[begin:end]  # the level's rows
        target = centre if end is None else b[begin:end]
        found, duals = _qp(G.T @ G, -G.T @ target, A[:begin], A[:begin] @ x, lo, hi, solver)
        if found is None:
            return x, mu, False
        x = np.clip(found, lo, hi)
        mu[k, :begin] = duals
        if end is not None:
            left = A[begin:end] @ x - b[begin:end]
            mu[k, begin:end] = np.where(np.abs(left) > _MET * (1 + np.abs(b[begin:end]).max()), left, 0.0)
            begin = int(end)
    return x, mu, True


def _weighed(A: Array, b: Array, pull: float, box: Box, solver: str) -> tuple[Array, Array, bool]:
    """Return what `_levels` does, of the one QP ‖A x - b‖² + pull ‖x - c‖²."""
    lo, hi, centre = box
    H, none = A.T @ A + pull * np.eye(len(lo)), np.zeros((0, len(lo)))
    found, _ = _qp(H, -A.T @ b - pull * centre, none, np.zeros(0), lo, hi, solver)
    x = np.clip(centre if found is None else found, lo, hi)
    return x, np.stack([A @ x - b, np.zeros(len(b))]), found is not None


def _qp(H: Array, g: Array, kept: Array, right: Array, lo: Array, hi: Array, solver: str) -> tuple[Array | None, Array]:
    """Return (the minimum of ½ xᵀHx + gᵀx under kept·x = right in the box, or None; the equalities' multipliers)."""
    import qpsolvers

    equalities = (kept, right) if len(kept) else (None, None)
    with warnings.catch_warnings():  # what is not solved shows in the certificate
        warnings.simplefilter("ignore", UserWarning)
        problem = qpsolvers.Problem(H, g, None, None, *equalities, lb=lo, ub=hi)
        solution = qpsolvers.solve_problem(problem, solver=solver, **_OPTIONS.get(solver, {}))
    duals = np.zeros(len(kept)) if solution.y is None or not len(kept) else np.asarray(solution.y)
    return (None if solution.x is None else np.asarray(solution.x)), duals
