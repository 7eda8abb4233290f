"""`allocate`: from torque and stiffness targets to the two pressures."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.allocation import exact
from allocator.allocation.problem import PRIORITIES, Priority, Problem
from allocator.allocation.result import Allocation, Verdict, assess, assess_analytic, shaped
from allocator.allocation.status import Status
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput, MissingBackend
from allocator.inverse import solve_inverse
from allocator.joint import AntagonistJoint, report_joint
from allocator.levels import Pair

_DEFAULT_JOINT = report_joint()


def allocate(
    theta: Value,
    K: Value,
    T: Value = 0.0,
    *,
    joint: AntagonistJoint | None = None,
    method: str = "exact",
    priority: Priority = "torque",
    weights: tuple[float, float] | None = None,
    min_force: float | None = 0.0,
    previous: tuple[Value, Value] | None = None,
    max_step: float | None = None,
) -> Allocation:
    """Find the pressures (P1, P2) that give stiffness `K` and torque `T` at the joint angle `theta`, or come nearest.

    Solves problem [A] of `allocator.allocation.problem`: within supply limits, taut muscles, model validity and slew.

    Parameters
    ----------
    theta, K, T
        Joint angle [rad], isobaric stiffness [N·m/rad] and torque [N·m]; scalars or arrays, broadcast like a ufunc.
    joint
        The joint; by default the report's (two Tondu2021 DMSP-20-400N on a 2 cm pulley, 0–5 bar, ±125°).
    method
        "exact": the global optimum. "analytic": the inverse alone, without limits; NaN where it does not exist.
    priority
        What is met first where not both can be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K) in [cost]/[N·m]² and [cost]/[N·m/rad]², both positive, for priority "weighted".
    min_force
        Least muscle force [N], keeps the cables taut; None lifts it, to compare with the report's figures.
    previous, max_step
        The pressures now (P1, P2) [Pa] and how far each may move [Pa]: a slew limit.

    Raises
    ------
    InvalidInput
        For an argument that makes no sense: NaN, K ≤ 0, degrees for radians, bar for Pa, shapes that do not fit.
    MissingBackend
        For an unknown method; the message lists the ones there are.
    """
    if method not in _METHODS:
        raise MissingBackend("method", method, _METHODS)
    joint = _DEFAULT_JOINT if joint is None else joint
    theta, K, T = checks.angle("theta", theta), checks.stiffness("K", K), checks.real("T", T, "N·m")
    theta, K, T, *slew = checks.broadcast(theta=theta, K=K, T=T, **checks.slew(previous, max_step))
    problem = Problem(
        joint,
        np.clip(theta, *joint.angle_range).ravel(),
        K.ravel(),
        T.ravel(),
        priority=_priority(priority),
        weights=_weights(priority, weights),
        min_force=checks.force("min_force", min_force),
        slew=tuple(array.ravel() for array in slew) or None,
    )
    return _METHODS[method](problem, theta, method)


def _exact(problem: Problem, theta: Array, method: str) -> Allocation:
    P1, P2 = exact.solve(problem)
    outside = _outside(problem.joint, theta.ravel())
    return _allocation(problem, theta, (P1, P2), assess(problem, P1, P2, outside), exact.is_local(problem), method)


def _analytic(problem: Problem, theta: Array, method: str) -> Allocation:
    problem = problem.at(theta.ravel())  # no limit, not even the joint's range
    P1, P2 = solve_inverse(problem.joint, problem.theta, problem.K, problem.T)
    verdict = assess_analytic(problem, P1, P2, _outside(problem.joint, problem.theta))
    return _allocation(problem, theta, (P1, P2), verdict, np.zeros(P1.shape, bool), method)


_METHODS: dict[str, Callable[[Problem, Array, str], Allocation]] = {"analytic": _analytic, "exact": _exact}


def _allocation(
    problem: Problem, theta: Array, P: Pair, verdict: Verdict, local: NDArray[np.bool_], method: str
) -> Allocation:
    columns = (problem.T, problem.K, *P, *verdict, local)
    T_target, K_target, P1, P2, T, K, status, limits, local = (shaped(c, theta.shape) for c in columns)
    status = status if theta.shape else Status(status)
    asked: Any = shaped(theta.ravel(), theta.shape)
    return Allocation(
        asked, T_target, K_target, P1, P2, T, K, status, limits, local, method, _problem=problem, _shape=theta.shape
    )


def _outside(joint: AntagonistJoint, theta: Array) -> NDArray[np.int32]:
    """The Limit flag that ends the joint range where `theta` lies beyond it, else 0."""
    left, right = joint.angle_range
    below, above = (np.int32(joint.angle_limit(upper)) for upper in (False, True))
    return np.where(theta < left, below, np.where(theta > right, above, np.int32(0)))


def _priority(priority: Any) -> Priority:
    if priority not in PRIORITIES:
        raise InvalidInput(f"priority = {priority!r} is unknown; choose one of {', '.join(PRIORITIES)}")
    return priority  # type: ignore[no-any-return]  # narrowed by the line above


def _weights(priority: Priority, weights: Any) -> tuple[float, float]:
    if (weights is None) is (priority == "weighted"):
        raise InvalidInput("weights = (w_T, w_K) and priority='weighted' go together; one came without the other")
    if weights is None:
        return 1.0, 1.0
    array = checks.real("weights", weights, "cost/target²")
    if array.shape != (2,) or not (array > 0).all():
        raise InvalidInput(f"weights = {weights!r} have to be two positive numbers (w_T, w_K)")
    return float(array[0]), float(array[1])


__all__ = ["allocate"]
