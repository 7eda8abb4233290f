"""Answers of `allocate` for a mechanism: choice of the method, and the readable method "qp".

"exact" is block principal pivoting (`allocator.allocation.box.pivoting`), or for muscles that are not affine the search
of `allocator.allocation.relaxation`. "qp" is the readable implementation: one QP per level through qpsolvers, with the
values achieved by earlier levels as equality constraints.
"""

import warnings

import numpy as np

from allocator import checks
from allocator.allocation import relaxation
from allocator.allocation.arguments import Asked, Method, Name, checked_direction
from allocator.allocation.box import pivoting
from allocator.allocation.box.arguments import problem_from
from allocator.allocation.box.pivoting import Solved
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.box.result import BoxAllocation
from allocator.allocation.relaxation import Nearby
from allocator.calculus import Array
from allocator.errors import InvalidInput, MissingBackend
from allocator.mechanism.mechanism import Indices, Mechanism

METHODS: tuple[Name, ...] = ("exact", "qp")
Box = tuple[Array, Array, Array]
"""(lo, hi, centre) of x, each (m,)."""

_MET = 1e-10  # of the right-hand sides: a residual below it is the solver's tolerance

_OPTIONS: dict[str, dict[str, float]] = {"daqp": {"primal_tol": 1e-9, "dual_tol": 1e-10}}


def allocated(mechanism: Mechanism, asked: Asked) -> BoxAllocation:
    """Return the allocation of a mechanism. Raises as `allocate`."""
    method = _checked_method(asked.method)
    if checked_direction(asked.direction).any():
        raise InvalidInput(
            f"direction = {checks.brief(asked.direction)} is for an AntagonistJoint with friction; a mechanism has none"
        )
    if asked.along is not None and method.name != "exact":
        raise InvalidInput(f"along is for the method 'exact', not {method.name!r}")
    problem, shape = problem_from(
        *(mechanism, asked.theta, asked.K, asked.T),
        limits=asked.limits,
        stiffness=asked.stiffness,
        priority=asked.priority,
        weights=asked.weights,
        pull=asked.pull,
    )
    problem, found = _solved(problem, method, checks.axis("along", asked.along, len(shape)) is not None)
    return BoxAllocation.of(problem, found, shape, method.name, method.gap)


def _checked_method(method: Method) -> Method:
    """Return the method. Raises for one that mechanisms lack, and for options of other methods."""
    if method.name not in METHODS:
        raise MissingBackend("method", method.name, METHODS)
    if method.solver is not None and method.name != "qp":
        raise InvalidInput(f"solver = {method.solver!r} belongs to the method 'qp', not {method.name!r}")
    if method.uncertainty is not None:
        raise InvalidInput("uncertainty is of an AntagonistJoint and method='convex'")
    return method


def _solved(problem: BoxProblem, method: Method, trajectory: bool) -> tuple[BoxProblem, Nearby]:
    """Return the method's solution, and the problem that it solved last."""
    if not problem.mechanism.affine:
        if method.name != "exact":
            problem.mechanism.check_affine(f"method={method.name!r}")
        if problem.pull:
            problem.mechanism.check_affine("a pull")
        return problem, relaxation.solve(problem, method.gap)

    if problem.pull and problem.endpoint is not None and problem.endpoint.redundant:
        raise InvalidInput("a pull is not for an endpoint with more joints than coordinates")

    def solve(problem: BoxProblem) -> Solved:
        return level_by_level(problem, method.solver) if method.name == "qp" else pivoting.solve(problem, trajectory)

    problem, solved = pivoting.settled(problem, solve)
    return problem, Nearby.of(problem, solved)


def level_by_level(problem: BoxProblem, solver: str | None = None) -> Solved:
    """Solve target after target, by DAQP or another solver of qpsolvers. Raises `MissingBackend` for an unknown one."""
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
    """Return the same as `_levels`, for the single QP ‖A x - b‖² + pull ‖x - c‖²."""
    lo, hi, centre = box
    H, none = A.T @ A + pull * np.eye(len(lo)), np.zeros((0, len(lo)))
    found, _ = _qp(H, -A.T @ b - pull * centre, none, np.zeros(0), lo, hi, solver)
    x = np.clip(centre if found is None else found, lo, hi)
    return x, np.stack([A @ x - b, np.zeros(len(b))]), found is not None


def _qp(H: Array, g: Array, kept: Array, right: Array, lo: Array, hi: Array, solver: str) -> tuple[Array | None, Array]:
    """Return (the minimum of ½ xᵀHx + gᵀx under kept·x = right in the box, or None; the equalities' multipliers)."""
    import qpsolvers

    equalities = (kept, right) if len(kept) else (None, None)
    with warnings.catch_warnings():  # the certificate reveals failures
        warnings.simplefilter("ignore", UserWarning)
        problem = qpsolvers.Problem(H, g, None, None, *equalities, lb=lo, ub=hi)
        solution = qpsolvers.solve_problem(problem, solver=solver, **_OPTIONS.get(solver, {}))
    duals = np.zeros(len(kept)) if solution.y is None or not len(kept) else np.asarray(solution.y)
    return (None if solution.x is None else np.asarray(solution.x)), duals
