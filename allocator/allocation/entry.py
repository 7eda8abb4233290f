"""`allocate` turns torque and stiffness targets into pressures, of a joint here and of a mechanism in its own entry."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial, singledispatch
from typing import TYPE_CHECKING, Any, NamedTuple, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.allocation import exact
from allocator.allocation.arguments import problem_from
from allocator.allocation.free_valves import with_free_valves
from allocator.allocation.friction import checked_direction, with_friction
from allocator.allocation.kernels import calls
from allocator.allocation.kernels.scalars import number
from allocator.allocation.method import Method, Name
from allocator.allocation.optimisers import backends
from allocator.allocation.pair import PairAllocation
from allocator.allocation.planning import planned
from allocator.allocation.problem import Priority, Problem
from allocator.allocation.result import Allocation, as_status, shaped
from allocator.allocation.status import OPTIMISER, UNCERTAIN, Assessment, Status, assess, assess_inverse
from allocator.allocation.uncertain.spread import with_covariance
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput, MissingBackend
from allocator.inverse import solve_inverse
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.gas import HELD, ISOBARIC, Stiffness, StiffnessKind, of_a_joint
from allocator.joint.limits import TAUT, Limits

if TYPE_CHECKING:
    from allocator.mechanism.mechanism import Mechanism
    from allocator.mechanism.result import BoxAllocation

METHODS: tuple[Name, ...] = get_args(Name)
Solve = Callable[[Problem], PairAllocation]


@overload
def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = ...,
    *,
    joint: AntagonistJoint | None = ...,
    limits: Limits = ...,
    stiffness: Stiffness = ...,
    priority: Priority = ...,
    weights: tuple[ArrayLike, ArrayLike] | None = ...,
    pull: tuple[float, ArrayLike] | None = ...,
    along: int | None = ...,
    direction: Value = ...,
    method: Name | Method = ...,
) -> PairAllocation: ...


@overload
def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = ...,
    *,
    joint: "Mechanism",
    limits: Limits = ...,
    stiffness: Stiffness = ...,
    priority: Priority = ...,
    weights: tuple[ArrayLike, ArrayLike] | None = ...,
    pull: tuple[float, ArrayLike] | None = ...,
    along: int | None = ...,
    direction: Value = ...,
    method: Name | Method = ...,
) -> "BoxAllocation": ...


def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    joint: "AntagonistJoint | Mechanism | None" = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    priority: Priority = "torque",
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    pull: tuple[float, ArrayLike] | None = None,
    along: int | None = None,
    direction: Value = 0.0,
    method: Name | Method = "exact",
) -> Allocation:
    """Return the pressures that give stiffness `K` and torque `T` at the posture `theta`, or the closest feasible ones.

    Solves for an `AntagonistJoint` problem [A] of `allocator.allocation.problem`, for a `Mechanism` of n joints and m
    muscles [M] of `allocator.mechanism.problem`. Targets broadcast like a ufunc; those of a mechanism in leading axes.

    Parameters
    ----------
    theta, K, T
        Joint angle [rad], stiffness [N·m/rad] and torque [N·m]; scalars or arrays. Beyond the angle limits the nearest
        posture within is answered, and named. Of a mechanism postures and torques are (…, n), or one torque for all
        joints; stiffnesses are matrices (…, n, n), symmetric and positive definite, or only what their diagonals shall
        be (…, n), or all of one diagonal, a number: the other entries are then free.
    joint
        An `AntagonistJoint` or a `Mechanism`; by default the report's joint (two Tondu2021 DMSP-20-400N on a 2 cm
        pulley, 0–5 bar, ±125°).
    limits
        Limits on forces and pressures beyond supply and joint range. By default cables are kept taut. Of a mechanism
        `previous` without `max_step` says to which of equally good pressures the answer is nearest, instead of to 0.
    stiffness
        Which stiffness `K` is: by default isobaric; `Stiffness("shut")` with gas trapped, `Stiffness(frequency=2.0,
        lag=0.1)` what motions meet, `Stiffness(amplitude=2*DEG)` what pushes by ±2° meet with the hysteresis of a joint
        with affine muscles, `Stiffness(tolerance=0.5)` any so near; of free valves see `Allocation.valves`.
        Of an endpoint K is K_x [N/m], matrices (…, dim, dim), diagonals or a number, and T what is asked for besides
        Jᵀ·force; nearest is the least ‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F. With n > dim the joints that the hand
        does not see are free: the answer is a local optimum, found by linearising K_x again and again.
    priority
        What is met first where not both can be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K) in [cost]/[N·m]² and [cost]/[N·m/rad]², for priority "weighted". Of a mechanism also w_T (n,) and
        w_K (n, n) for each entry, 0 for free ones; the sum over K has all n² entries.
    pull
        (ρ, P_ref) in [cost]/[Pa]² and [Pa]: a pull of the pressures towards a reference (P1, P2), or (…, m); of a
        mechanism for priority "weighted".
    along
        The axis of the targets along which time runs, for "exact". Of a joint: where several pairs of pressures give
        the same torque and stiffness (on some levers), those of the whole trajectory are chosen together, with the
        least sum of squared steps. Of a mechanism each target is begun with the limits that bind in the one before.
    direction
        Where a joint is to move: +1 θ rises, -1 θ falls, 0 it rests (default). The muscles of a joint with `friction`
        then add what friction takes, so that `T` is left for the link; the answer's torques are the muscles'.
    method
        A name, or a `Method` with the options of a solver. Of a mechanism "exact" is block principal pivoting, or for
        curved muscles a search within `Method.gap`; "qp" one QP a level through qpsolvers, slow and readable.

    Raises
    ------
    InvalidInput
        For an argument that makes no sense: NaN, K ≤ 0 or not positive definite, degrees for radians, bar for Pa,
        shapes that do not fit, contradictory limits; for a pull where "exact" has no closed form; for valves, a
        frequency or a lag that cannot be, and for gas in a muscle whose volume is not known (`Muscle.rest_volume`); for
        mechanisms of muscles whose force does not rise with the pressure, and where an endpoint's Jacobian is singular.
    MissingBackend
        For an unknown method or solver; the message lists the ones there are.
    """
    joint = report_joint() if joint is None else joint
    if (
        isinstance(joint, AntagonistJoint)
        and isinstance(method, str)  # and no array
        and method == "exact"
        and weights is pull is along is None  # type: ignore[comparison-overlap]  # all None
        and type(limits) is Limits
        and _ordinary(joint, direction, stiffness)
    ):
        kind = HELD if stiffness is ISOBARIC else stiffness.kind().of_gas(joint.gas, joint.affine)
        found = calls.answer(joint, theta, K, T, priority, limits, kind)
        if found is not None:
            return found
    asked = Asked(theta, K, T, limits, stiffness, priority, weights, pull, along, direction, Method.of(method))
    return allocated(joint, asked)


class Asked(NamedTuple):
    """`Asked` are the arguments of `allocate` about a machine, of these names."""

    theta: object
    K: object
    T: object
    limits: Limits
    stiffness: Stiffness
    priority: object
    weights: object
    pull: object
    along: object
    direction: object
    method: Method


@singledispatch
def allocated(joint: object, asked: Asked) -> Allocation:
    """Return the allocation of a machine; each kind of machine registers how it is found. Raises InvalidInput."""
    getattr(joint, "sides", None)  # of a joint without a force scale, which raises its own sentence
    raise InvalidInput(f"joint = {checks.brief(joint)} has to be an AntagonistJoint or a Mechanism")


@allocated.register
def _of_a_pair(joint: AntagonistJoint, asked: Asked) -> Allocation:
    """Return the allocation of two muscles that no kernel has answered."""
    chosen, kind = _checked_method(asked.method), of_a_joint(asked.stiffness, joint.gas, joint.affine)
    _check_together(kind, chosen, asked.along)
    if chosen.uncertainty is not None:
        joint = with_covariance(joint, chosen.uncertainty)
    s = checked_direction(asked.direction)
    T = checks.broadcast(T=checks.real("T", asked.T, "N·m"), direction=s)[0] if s.ndim else asked.T
    problem, angles = problem_from(
        *(joint, asked.theta, asked.K, T),
        limits=asked.limits,
        priority=asked.priority,
        weights=asked.weights,
        tolerance=asked.stiffness.tolerance,
        pull=asked.pull,
        shares=None if kind.shares is None else kind.fixed,
        felt=kind.secant(joint.loop) if kind.amplitude is not None else None,
    )
    solve = _solver(chosen, angles, _axis(asked.along, angles.ndim, chosen, asked.limits))
    answer = partial(_answer, solve=solve, kind=kind)
    if not (joint.friction and s.any()):
        return answer(problem)
    return with_friction(answer, problem, np.broadcast_to(s, angles.shape).ravel())


def _solver(method: Method, asked: Array, along: int | None) -> Solve:
    """Return the solver for problems at the given angles."""
    if method.name == "exact":
        return partial(_exact, asked=asked, along=along)
    if method.name == "analytic":
        return partial(_inverted, asked=asked)
    if method.uncertainty is not None:
        return partial(_uncertain, asked=asked, risk=method.risk)
    return partial(_optimised, asked=asked, method=method)


def _answer(problem: Problem, solve: Solve, kind: StiffnessKind) -> PairAllocation:
    """Return what `solve` finds for the stiffness that is meant; free valves are as they serve best."""
    if kind.shares is None:
        return with_free_valves(solve, problem, kind)
    found = solve(problem)
    return found if kind is HELD else replace(found, kind=kind)


def _ordinary(joint: AntagonistJoint, direction: object, stiffness: Stiffness) -> bool:
    """Return whether friction takes nothing, and neither a tolerance, a hand nor a force is given."""
    if stiffness is not ISOBARIC and not (
        type(stiffness) is Stiffness
        and number(stiffness.tolerance) == number(stiffness.force) == 0
        and stiffness.endpoint is None
    ):
        return False
    if type(direction) is float and direction == 0:
        return True
    return number(direction) == 0 or (joint.friction == 0 and abs(number(direction)) <= 1)


def _checked_method(chosen: Method) -> Method:
    """Return the method. Raises for methods that there are not, and options that belong to other methods."""
    if chosen.name not in METHODS:
        raise MissingBackend("method", chosen.name, METHODS)
    if chosen.solver is not None and chosen.name not in backends.OPTIMISERS:
        raise InvalidInput(
            f"solver = {chosen.solver!r} belongs to the methods {', '.join(backends.OPTIMISERS)}, not {chosen.name!r}"
        )
    if chosen.uncertainty is not None and (chosen.name != "convex" or chosen.solver is not None):
        raise InvalidInput("uncertainty belongs to method='convex' with its default solver")
    return chosen


def _check_together(kind: StiffnessKind, method: Method, along: object) -> None:
    """Refuse what has no answer for a stiffness with trapped gas in it."""
    if kind is HELD:
        return
    if method.uncertainty is not None:
        raise InvalidInput(
            f"uncertainty is for the isobaric stiffness: it does not know what a {kind.name} stiffness "
            "owes to the muscles' volumes; leave out valves and frequency"
        )
    if kind.amplitude is not None and (method.name != "exact" or along is not None):
        raise InvalidInput(
            f"a stiffness felt by a push is allocated by method='exact' and without along, not by {method.name!r}"
            if along is None
            else "along plans pressures for a stiffness without hysteresis; leave out along or amplitude"
        )
    if kind.shares is None and method.name == "analytic":
        raise InvalidInput(
            "method='analytic' knows no limits by which to choose valves; give a state instead of 'free'"
        )
    if kind.shares is None and along is not None:
        raise InvalidInput("along plans pressures for valves that stay as they are; give a state instead of 'free'")


def _axis(along: object, ndim: int, method: Method, limits: Limits) -> int | None:
    """Return the axis of time, counted from 0."""
    if along is None:
        return None
    if method.name != "exact" or limits.previous is not None:
        raise InvalidInput(
            "along plans the exact answers of a whole trajectory: without previous, and by no other method"
        )
    return checks.axis("along", along, ndim)


def _exact(problem: Problem, asked: Array, along: int | None) -> PairAllocation:
    P1, P2, gap = exact.solve(problem)
    if along is not None:
        met = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel())).status == Status.EXACT
        P1, P2 = planned(problem, P1, P2, met, asked.shape, along)
    found = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel()))
    return _allocation(problem, asked, P1, P2, found, "exact", gap=gap)


def _inverted(problem: Problem, asked: Array) -> PairAllocation:
    problem = problem.at(asked.ravel())  # no limit, not even the joint's range
    P1, P2 = solve_inverse(problem.joint, problem.theta, problem.K, problem.T, problem.shares)
    found = assess_inverse(problem, P1, P2, problem.joint.outside_range(problem.theta))
    return _allocation(problem, asked, P1, P2, found, "analytic", gap=np.full(P1.shape, np.nan))


def _optimised(problem: Problem, asked: Array, method: Method) -> PairAllocation:
    P1, P2, iterations, failed = backends.optimise(problem, method.name, method.solver, method.warm_start)
    found = assess(problem, P1, P2, problem.joint.outside_range(asked.ravel()), OPTIMISER)
    found = found._replace(status=np.where(failed, np.int8(Status.SOLVER_FAILED), found.status))
    return _allocation(problem, asked, P1, P2, found, method.name, gap=None, iterations=iterations)


def _uncertain(problem: Problem, asked: Array, risk: float) -> PairAllocation:
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
) -> PairAllocation:
    shape = asked.shape

    def form(array: NDArray[Any]) -> Any:
        return shaped(array, shape)

    return PairAllocation(
        theta=form(asked.ravel()),
        T_target=form(problem.T),
        K_target=form(problem.K),
        P1=form(P1),
        P2=form(P2),
        T=form(found.T),
        K=form(found.K),
        status=as_status(found.status, shape),
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
