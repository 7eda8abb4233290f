"""`problem_from` turns the arguments of `allocate` into a `Problem`: every check, a clear sentence for wrong input."""

from typing import Any

import numpy as np

from allocator import checks
from allocator.allocation.problem import PRIORITIES, Priority, Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.felt import Secant
from allocator.joint.gas import Shares
from allocator.joint.limits import TAUT, Limits, checked_limits
from allocator.joint.torque_levels import Pair

_STRONGEST = 1e100  # [cost]/[Pa]² of a pull


def problem_from(
    joint: AntagonistJoint,
    theta: object,
    K: object,
    T: object,
    *,
    limits: Limits = TAUT,
    priority: object = "torque",
    weights: object = None,
    tolerance: object = 0.0,
    pull: object = None,
    shares: Shares | None = None,
    felt: Secant | None = None,
) -> tuple[Problem, Array]:
    """Return the checked, flat problem, and the angles asked for in the common shape of all arguments.

    Arguments are those of `allocate`, the limits as their value, `shares` those of the trapped gas in the stiffness,
    `felt` the hysteresis in it; angles are moved into the joint range. Raises InvalidInput, as `allocate` says.
    """
    named = {"theta": checks.angle("theta", theta), "K": checks.stiffness("K", K), "T": checks.real("T", T, "N·m")}
    limits = checked_limits(limits)
    named |= _slew(limits)
    chosen = checked_priority(priority)
    rho, reference = (0.0, None) if pull is None else pulled(pull)
    if reference is not None:
        named |= checks.pressure_pair("pull[1]", reference, ("P1_ref", "P2_ref"))
    arrays = checks.broadcast(**named)
    flat = {name: array.flatten() for name, array in zip(named, arrays, strict=True)}  # copies: they stay as they are
    low, high = _force_limits(limits)
    push = None if felt is None or joint.affine else felt.separable
    problem = Problem(
        joint,
        theta=np.clip(flat["theta"], *joint.angle_range),
        K=flat["K"],
        T=flat["T"],
        priority=chosen,
        weights=_weights(chosen, weights),
        limits=Limits(low, high, _cocontraction(joint, limits), _pair(flat, "P1_now", "P2_now"), flat.get("max_step")),
        stiffness_tolerance=_tolerance(chosen, tolerance),
        pull=rho,
        reference=_pair(flat, "P1_ref", "P2_ref"),
        felt=None if push is not None else felt,
        push=push,
    )
    problem = problem if shares is None else problem.with_shares(shares)
    return problem, flat["theta"].reshape(arrays[0].shape)


def two(name: str, value: Any, expected: str) -> tuple[Any, Any]:
    """Return both parts of a pair. Raises InvalidInput unless `given` has two parts."""
    try:
        first, second = value
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} = {checks.brief(value)} {expected}") from None
    return first, second


def pulled(pull: object) -> tuple[float, Any]:
    """Return the weight ρ > 0 [cost]/[Pa]² of a pull = (ρ, P_ref), and what is given for P_ref."""
    weight, reference = two("pull", pull, "has to be (ρ, P_ref), [cost]/[Pa]² and pressures")
    rho = checks.not_negative("pull[0]", weight, "cost/Pa²")
    if rho == 0:
        raise InvalidInput("pull = (ρ, P_ref) has to have ρ > 0; None is no pull")
    if rho > _STRONGEST:
        raise InvalidInput(f"pull[0] = {rho:g} cost/Pa² is over {_STRONGEST:g}, the most that is taken")
    return rho, reference


def _slew(limits: Limits) -> dict[str, Array]:
    """Return the checked arrays of the slew limit, none where there is no such limit."""
    given = limits.previous is not None, limits.max_step is not None
    now = checks.pressure_pair("previous", limits.previous, ("P1_now", "P2_now")) if given[0] else {}
    if given[0] is not given[1]:
        raise InvalidInput("previous and max_step go together; one came without the other")
    return now | ({"max_step": checks.positive_pressure("max_step", limits.max_step)} if given[1] else {})


def _pair(flat: dict[str, Array], first: str, second: str) -> Pair | None:
    """Return two of the arrays, None where they are not there."""
    return (flat[first], flat[second]) if first in flat else None


def checked_priority(priority: object) -> Priority:
    """Return the priority. Raises InvalidInput for one that there is not."""
    return checks.one_of("priority", priority, PRIORITIES)  # type: ignore[return-value]  # one of these words


def _weights(priority: Priority, weights: object) -> tuple[float, float]:
    if (weights is None) is (priority == "weighted"):
        raise InvalidInput("weights = (w_T, w_K) and priority='weighted' go together; one came without the other")
    if weights is None:
        return 1.0, 1.0
    array = checks.real("weights", weights, "cost/target²")
    if array.shape != (2,) or not (array > 0).all():
        raise InvalidInput(f"weights = {weights!r} have to be two positive numbers (w_T, w_K)")
    return float(array[0]), float(array[1])


def _force_limits(limits: Limits) -> tuple[float | None, float | None]:
    low = None if limits.min_force is None else checks.not_negative("min_force", limits.min_force, "N")
    high = None if limits.max_force is None else checks.not_negative("max_force", limits.max_force, "N")
    if high is not None and high <= (low or 0.0):
        raise InvalidInput(f"max_force = {high:g} N contradicts min_force = {low or 0.0:g} N: it has to exceed it")
    return low, high


def _cocontraction(joint: AntagonistJoint, limits: Limits) -> float | None:
    if limits.min_cocontraction is None:
        return None
    pressure = checks.pressure("min_cocontraction", limits.min_cocontraction)
    value = checks.not_negative("min_cocontraction", pressure, "Pa")
    if value > joint.pressure_limits[1]:
        raise InvalidInput(
            f"min_cocontraction = {value:g} Pa contradicts the supply pressure of {joint.pressure_limits[1]:g} Pa"
        )
    return value


def _tolerance(priority: Priority, tolerance: object) -> float:
    value = checks.not_negative("tolerance", tolerance, "N·m/rad")
    if value and priority != "torque":
        raise InvalidInput(
            "a stiffness tolerance holds for priority='torque' only: elsewhere no answers are equally good"
        )
    return value
