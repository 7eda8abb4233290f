"""`allocate_mechanism` turns torques and a stiffness matrix into the pressures of all muscles."""

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.gas import Valves
from allocator.mechanism import batches, qp, relaxation
from allocator.mechanism.arguments import problem_from
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.problem import MechanismProblem, Priority
from allocator.mechanism.relaxation import Nearby
from allocator.mechanism.result import MechanismAllocation
from allocator.mechanism.status import MechanismStatus, decide

Method = Literal["exact", "qp"]
METHODS: tuple[Method, ...] = get_args(Method)


def allocate_mechanism(
    mechanism: Mechanism,
    q: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    priority: Priority = "torque",
    weights: Any = None,
    min_force: ArrayLike | None = 0.0,
    max_force: ArrayLike | None = None,
    previous: ArrayLike | None = None,
    max_step: ArrayLike | None = None,
    trajectory: bool = False,
    method: Method = "exact",
    solver: str | None = None,
    gap: float = 1e-3,
    valves: Valves = "open",
    frequency: float | None = None,
    lag: ArrayLike | None = None,
) -> MechanismAllocation:
    """Find the pressures of all muscles that give stiffness `K` and torques `T` at the posture `q`, or come nearest.

    Solves problem [M] of `allocator.mechanism.problem`, whose answer is unique. Leading axes of arguments broadcast.

    Parameters
    ----------
    mechanism
        A mechanism with n joints and m muscles.
    q
        Posture (…, n) [rad]; beyond the angle limits it is answered at the nearest posture within, and says so.
    K
        Stiffness [N·m/rad], isobaric unless `valves` or `frequency` say otherwise: matrices (…, n, n), symmetric and
        positive definite; or only what their diagonals shall be (…, n), or all of one diagonal, a number: the other
        entries are then free.
    T
        Torques (…, n) [N·m], or a number for every joint.
    priority
        What is met first where not both can be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K), of the squared errors in [N·m]² and [N·m/rad]²: numbers, or w_T (n,) and w_K (n, n) for each entry;
        0 leaves an entry free. The sum over K has all n² entries. By default 1; needed for "weighted".
    min_force, max_force
        Least and greatest muscle force [N], numbers or rows (m,). 0 keeps the muscles taut; None lifts the limit.
    previous, max_step
        The pressures now (…, m) [Pa]: of equally good pressures those nearest to them are given, instead of the least
        Σ P²; with `max_step` [Pa], a number or (…), no pressure moves farther than that.
    trajectory
        True: consecutive targets are near each other, and each is begun with the limits that bind in the one before.
        The answers are the same.
    method, solver
        "exact": block principal pivoting. "qp": one QP a level through qpsolvers, slow and readable, by DAQP or another
        `solver`; for muscles affine in the pressure.
    gap
        For muscles that are not affine: the search ends when each level's cost, its weighted squared error, is proved
        to be above the least by no more than gap·(1 + cost), see `MechanismAllocation.gap`. Of equally good pressures
        those given are nearest in their neighbourhood.
    valves, frequency, lag
        Which stiffness `K` is, as in `Mechanism.stiffness`: "open" isobaric; "shut", or a truth value for each muscle,
        with gas trapped; or what motions at the frequency [Hz] meet, with regulators of this lag [s], a number or (m,).

    Raises
    ------
    InvalidInput
        For an argument that makes no sense: shapes that do not fit n and m, a K that is not symmetric or not positive
        definite, NaN, degrees for radians, bar for Pa, contradictory limits, valves, a frequency or a lag that cannot
        be; for gas in a muscle whose volume is not known (`Muscle.rest_volume`), and for muscles whose force does not
        rise with the pressure all over their limits.
    MissingBackend
        For an unknown method or solver.
    """
    if not isinstance(mechanism, Mechanism):
        raise InvalidInput(
            f"mechanism is a {type(mechanism).__name__}; expected a Mechanism, such as Mechanism.from_joint"
        )
    if method not in METHODS:
        raise MissingBackend("method", method, METHODS)
    if solver is not None and method != "qp":
        raise InvalidInput(f"solver = {solver!r} belongs to the method 'qp', not {method!r}")
    problem, shape = problem_from(
        mechanism,
        q,
        K,
        T,
        priority=priority,
        weights=weights,
        min_force=min_force,
        max_force=max_force,
        previous=previous,
        max_step=max_step,
        kind=mechanism.kind(valves, frequency, lag),
    )
    if not 0 < checks.number("gap", gap, "of 1 + cost") < 1:
        raise InvalidInput(f"gap = {gap:g} has to lie between 0 and 1, a share of 1 + cost")
    solved, residual, costs, bounds = _solved(problem, method, solver, trajectory, gap)
    P = np.clip(solved.x * problem.unit, *problem.bounds)
    y, left = problem.given(P), ((costs - bounds) / (1 + costs)).max(axis=1)
    n, (rows, columns) = mechanism.n, mechanism.upper_triangle
    stiffness = np.empty((problem.size, n, n))
    stiffness[:, rows, columns] = stiffness[:, columns, rows] = y[:, n:]
    proof = residual if mechanism.affine else np.where(left <= gap, 0.0, np.inf)
    found = decide(problem, y, stiffness, proof)

    def form(array: Any) -> Any:
        array.flags.writeable = False
        return array.reshape(shape) if shape else array[0].item()

    P.flags.writeable = stiffness.flags.writeable = y.flags.writeable = False
    return MechanismAllocation(
        P=P.reshape(*shape, mechanism.m),
        T=y[:, :n].reshape(*shape, n),
        K=stiffness.reshape(*shape, n, n),
        status=form(found.status) if shape else MechanismStatus(int(found.status[0])),
        torque_met=form(found.torque_met),
        stiffness_met=form(found.stiffness_met),
        holds=form(found.holds),
        kkt_residual=form(residual),
        rounds=form(solved.rounds),
        gap=form(left),
        lower_bounds=bounds.reshape(*shape, -1),
        method=method,
        _problem=problem,
        _mu=solved.mu,
        _shape=shape,
    )


def _solved(problem: MechanismProblem, method: Method, solver: str | None, trajectory: bool, gap: float) -> Nearby:
    """Return what the method finds, with the residuals of optimality and the lower bounds of the levels' costs."""
    if not problem.mechanism.affine:
        if method != "exact":
            problem.mechanism.check_affine(f"method={method!r}")
        return relaxation.solve(problem, gap)
    solved = qp.solve(problem, solver) if method == "qp" else batches.solve(problem, trajectory)
    costs = problem.costs(solved.x)
    return Nearby(solved, batches.residuals(problem, solved), costs, costs)


__all__ = ["METHODS", "Method", "allocate_mechanism"]
