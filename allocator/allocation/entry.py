"""`allocate` turns torque and stiffness targets into the two pressures."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.allocation import exact
from allocator.allocation.arguments import problem_from
from allocator.allocation.free_valves import with_free_valves
from allocator.allocation.friction import checked_direction, with_friction
from allocator.allocation.kernels import calls
from allocator.allocation.kernels.scalars import number
from allocator.allocation.optimisers import backends
from allocator.allocation.planning import planned
from allocator.allocation.problem import Priority, Problem
from allocator.allocation.result import Allocation, shaped
from allocator.allocation.status import Assessment, Status, assess, assess_inverse
from allocator.allocation.tolerances import OPTIMISER, UNCERTAIN
from allocator.allocation.uncertain.covariance import with_covariance
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput, MissingBackend
from allocator.inverse import solve_inverse
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.gas import ISOBARIC, StiffnessKind, Valves
from allocator.joint.limits import TAUT, Limits

Method = Literal["analytic", "exact", backends.Optimiser]
METHODS: tuple[Method, ...] = get_args(Method)
Solve = Callable[[Problem], Allocation]


def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    joint: AntagonistJoint | None = None,
    direction: Value = 0.0,
    method: Method = "exact",
    priority: Priority = "torque",
    weights: tuple[float, float] | None = None,
    min_force: float | None = 0.0,
    max_force: float | None = None,
    min_cocontraction: float | None = None,
    stiffness_tolerance: float = 0.0,
    pull: float = 0.0,
    reference: tuple[ArrayLike, ArrayLike] | None = None,
    previous: tuple[ArrayLike, ArrayLike] | None = None,
    max_step: ArrayLike | None = None,
    solver: str | None = None,
    warm_start: bool = True,
    along: int | None = None,
    uncertainty: Any = None,
    risk: float = 0.05,
    valves: Valves = "open",
    frequency: float | None = None,
    lag: float | tuple[float, float] | None = None,
) -> Allocation:
    """Find the pressures (P1, P2) that give stiffness `K` and torque `T` at the joint angle `theta`, or come nearest.

    Solves problem [A] of `allocator.allocation.problem`.

    Parameters
    ----------
    theta, K, T
        Joint angle [rad], stiffness [N·m/rad] and torque [N·m]; scalars or arrays, broadcast like a ufunc. The
        stiffness is the isobaric one unless `valves` or `frequency` say otherwise.
    joint
        The joint; by default the report's (two Tondu2021 DMSP-20-400N on a 2 cm pulley, 0–5 bar, ±125°).
    direction
        Where the joint is to move: +1 θ rises, -1 θ falls, 0 it rests (default). The muscles of a joint with `friction`
        then add what friction takes, so that `T` is left for the link; the answer's torques are the muscles'.
    method
        "exact": the global optimum, in closed form or by a complete search, see `Allocation.gap`. "analytic": the
        inverse alone, without limits; NaN where it does not exist. "qp" (successive QPs), "nlp" (CasADi), "convex"
        (cvxpy): optimisers that start from the analytic inverse; an answer that fails the library's own check is
        replaced, and the status says so.
    priority
        What is met first where not both can be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K) in [cost]/[N·m]² and [cost]/[N·m/rad]², both positive, for priority "weighted".
    min_force, max_force
        Least and greatest muscle force [N]. 0 keeps the cables taut; None lifts the limit, e.g. to compare with the
        report's figures.
    min_cocontraction
        Least mean pressure (P1 + P2)/2 [Pa].
    stiffness_tolerance
        All stiffnesses this near to K are as good [N·m/rad]; of them the one with the least pressures is given.
    pull, reference
        ρ [cost]/[Pa]² and (P1, P2) [Pa]: a pull of the pressures towards the reference.
    previous, max_step
        The pressures now (P1, P2) [Pa] and how far each may move [Pa]: a slew limit.
    solver
        For "qp" any solver that qpsolvers finds ("daqp", "osqp", …), for "nlp" "ipopt" or "sqpmethod", for "convex"
        "clarabel" or "osqp".
    along
        The axis of the targets along which time runs, for "exact": where several pairs of pressures give the same
        torque and stiffness (on some levers), those of the whole trajectory are chosen together, with the least sum of
        squared steps. None: each target alone is given the least pressures, or with `previous` the nearest.
    uncertainty, risk
        For "convex" with affine muscles: covariance of the muscle's parameters (a matrix, a pair of them, or True for
        the fitted muscles' own), and the probability α with which a force limit may be broken, see
        `allocator.allocation.uncertain.problem`.
    valves
        Which stiffness `K` is (`allocator.joint.gas`): "open" isobaric, pressures are held; "shut" with the gas of both
        muscles trapped; a pair of truth values for (agonist, antagonist), True for shut; "free" with the valves as
        they serve best, for the least pressures where several serve as well, see `Allocation.valves`.
    frequency, lag
        `K` is what small motions at this frequency [Hz] meet while regulators with this lag [s] (a number, or one for
        each muscle) hold the pressures: the real part of the dynamic stiffness.
    warm_start
        False starts the optimisers in the middle of the box instead, to measure what the warm start gains.

    Raises
    ------
    InvalidInput
        For an argument that makes no sense: NaN, K ≤ 0, degrees for radians, bar for Pa, shapes that do not fit,
        contradictory limits; for a pull where "exact" has no closed form; for valves, a frequency or a lag that
        cannot be, and for gas in a muscle whose volume is not known (`Muscle.rest_volume`).
    MissingBackend
        For an unknown method or solver; the message lists the ones there are.
    """
    joint = report_joint() if joint is None else joint
    if not isinstance(joint, AntagonistJoint):
        raise _refused(joint)
    kind = ISOBARIC
    if not (isinstance(valves, str) and valves == "open" and frequency is lag is None):
        kind = StiffnessKind.of(valves, frequency, lag)
        kind = ISOBARIC if kind.isobaric else kind
    limits = TAUT  # as mostly; to make them again takes 5 % of a call
    taut = type(min_force) is float and min_force == 0
    if not (taut and max_force is min_cocontraction is previous is max_step is None):  # type: ignore[comparison-overlap]  # all None
        limits = Limits(min_force, max_force, min_cocontraction, previous, max_step)
    if (
        isinstance(method, str)  # and no array
        and method == "exact"
        and solver is weights is reference is uncertainty is along is None  # type: ignore[comparison-overlap]  # all None
        and _ordinary(joint, direction, stiffness_tolerance, pull)
    ):
        found = calls.answer(joint, theta, K, T, priority, limits, kind)
        if found is not None:
            return found
    _check_method(method, solver, uncertainty)
    _check_kind(kind, method, uncertainty, along)
    if uncertainty is not None:
        joint, risk = with_covariance(joint, uncertainty), checks.probability("risk", risk)
    s = checked_direction(direction)
    problem, asked = problem_from(
        joint,
        theta,
        K,
        checks.broadcast(T=checks.real("T", T, "N·m"), direction=s)[0] if s.ndim else T,
        limits=limits,
        priority=priority,
        weights=weights,
        stiffness_tolerance=stiffness_tolerance,
        pull=pull,
        reference=reference,
        shares=None if kind.shares is None else kind.fixed,
    )
    axis = _axis(along, asked.ndim, method, previous)
    solve: Solve
    if method == "exact":
        solve = partial(_exact, asked=asked, along=axis)
    elif method == "analytic":
        solve = partial(_inverted, asked=asked)
    elif uncertainty is not None:
        solve = partial(_uncertain, asked=asked, risk=risk)
    else:
        solve = partial(_optimised, asked=asked, method=method, solver=solver, warm_start=warm_start)
    answer = partial(_answer, solve=solve, kind=kind)
    if not (joint.friction and s.any()):
        return answer(problem)
    return with_friction(answer, problem, np.broadcast_to(s, asked.shape).ravel())


def _refused(joint: Any) -> InvalidInput:
    """Return what to raise for a joint that is none; one without a force scale raises its own sentence."""
    getattr(joint, "sides", None)
    return InvalidInput(f"joint = {checks.brief(joint)} has to be an AntagonistJoint")


def _answer(problem: Problem, solve: Solve, kind: StiffnessKind) -> Allocation:
    """Return what `solve` finds for the stiffness that is meant; free valves are as they serve best."""
    if kind.shares is None:
        return with_free_valves(solve, problem, kind)
    found = solve(problem)
    return found if kind is ISOBARIC else replace(found, kind=kind)


def _ordinary(joint: AntagonistJoint, direction: Any, stiffness_tolerance: Any, pull: Any) -> bool:
    """Return whether friction takes nothing, and neither a tolerance nor a pull is asked for."""
    floats = type(direction) is type(stiffness_tolerance) is type(pull) is float
    if floats and direction == stiffness_tolerance == pull == 0:
        return True
    return number(pull) == number(stiffness_tolerance) == 0 and (
        number(direction) == 0 or (joint.friction == 0 and abs(number(direction)) <= 1)
    )


def _check_method(method: Any, solver: Any, uncertainty: Any) -> None:
    """Refuse methods that there are not, and options that belong to other methods."""
    if not isinstance(method, str) or method not in METHODS:
        raise MissingBackend("method", method, METHODS)
    if solver is not None and method not in backends.OPTIMISERS:
        raise InvalidInput(
            f"solver = {solver!r} belongs to the methods {', '.join(backends.OPTIMISERS)}, not {method!r}"
        )
    if uncertainty is not None and (method != "convex" or solver is not None):
        raise InvalidInput("uncertainty belongs to method='convex' with its default solver")


def _check_kind(kind: StiffnessKind, method: Any, uncertainty: Any, along: Any) -> None:
    """Refuse what has no answer for a stiffness with trapped gas in it."""
    if kind is ISOBARIC:
        return
    if uncertainty is not None:
        raise InvalidInput(
            f"uncertainty is for the isobaric stiffness: it does not know what a {kind.name} stiffness "
            "owes to the muscles' volumes; leave out valves and frequency"
        )
    if kind.shares is None and method == "analytic":
        raise InvalidInput(
            "method='analytic' knows no limits by which to choose valves; give a state instead of 'free'"
        )
    if kind.shares is None and along is not None:
        raise InvalidInput("along plans pressures for valves that stay as they are; give a state instead of 'free'")


def _axis(along: Any, ndim: int, method: str, previous: Any) -> int | None:
    """Return the axis of time, counted from 0."""
    if along is None:
        return None
    if method != "exact" or previous is not None:
        raise InvalidInput(
            "along plans the exact answers of a whole trajectory: without previous, and by no other method"
        )
    if not isinstance(along, int) or isinstance(along, bool) or not -ndim <= along < ndim:
        raise InvalidInput(f"along = {along!r} is no axis of targets with {ndim} of them")
    return along % ndim


def _exact(problem: Problem, asked: Array, along: int | None) -> Allocation:
    P1, P2, gap = exact.solve(problem)
    if along is not None:
        met = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel())).status == Status.EXACT
        P1, P2 = planned(problem, P1, P2, met, asked.shape, along)
    found = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel()))
    return _allocation(problem, asked, P1, P2, found, "exact", gap=gap)


def _inverted(problem: Problem, asked: Array) -> Allocation:
    problem = problem.at(asked.ravel())  # no limit, not even the joint's range
    P1, P2 = solve_inverse(problem.joint, problem.theta, problem.K, problem.T, problem.shares)
    found = assess_inverse(problem, P1, P2, problem.joint.outside_range(problem.theta))
    return _allocation(problem, asked, P1, P2, found, "analytic", gap=np.full(P1.shape, np.nan))


def _optimised(problem: Problem, asked: Array, method: str, solver: str | None, warm_start: bool) -> Allocation:
    P1, P2, iterations, failed = backends.optimise(problem, method, solver, warm_start)
    found = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel()), OPTIMISER)
    found = found._replace(status=np.where(failed, np.int8(Status.SOLVER_FAILED), found.status))
    return _allocation(problem, asked, P1, P2, found, method, gap=None, iterations=iterations)


def _uncertain(problem: Problem, asked: Array, risk: float) -> Allocation:
    from allocator.allocation.uncertain import chance

    P1, P2, iterations, failed, box, infeasible = chance.optimise(problem, risk)
    outside = problem.joint.outside_range(asked.ravel())
    found = assess(problem, P1, P2, outside, OPTIMISER)
    missed = np.isin(found.status, (Status.TORQUE_LIMITED, Status.STIFFNESS_LIMITED, Status.BOTH_LIMITED))
    status = np.where(missed, np.int8(Status.HEDGED), found.status)
    status = np.where(failed, np.int8(Status.SOLVER_FAILED), status)
    limits = box.binding(P1, P2, UNCERTAIN.binds * problem.joint.pressure_span) | outside
    found = found._replace(status=np.where(infeasible, np.int8(Status.TOO_RISKY), status), limits=limits)
    gap = np.full(P1.shape, np.nan)
    return _allocation(problem, asked, P1, P2, found, "uncertain", gap=gap, iterations=iterations)


def _allocation(
    problem: Problem,
    asked: Array,
    P1: Array,
    P2: Array,
    found: Assessment,
    method: str,
    *,
    gap: Array | None,
    iterations: NDArray[np.int32] | None = None,
) -> Allocation:
    shape = asked.shape

    def form(array: NDArray[Any]) -> Any:
        return shaped(array, shape)

    return Allocation(
        theta=form(asked.ravel()),
        T_target=form(problem.T),
        K_target=form(problem.K),
        P1=form(P1),
        P2=form(P2),
        T=form(found.T),
        K=form(found.K),
        status=form(found.status) if shape else Status(int(found.status[0])),
        limits=form(found.limits),
        _gap=None if gap is None else form(gap),
        method=method,
        iterations=None if iterations is None else form(iterations),
        joint=problem.joint,
        priority=problem.priority,
        _within=problem.limits,
        _built=problem,
        _shape=shape,
    )
