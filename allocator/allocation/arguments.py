"""From the arguments of `allocate` to a `Problem`: every check, one clear sentence for every wrong input."""

from typing import Any

import numpy as np

from allocator import checks
from allocator.allocation.problem import PRIORITIES, Priority, Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint


def problem_from(
    joint: AntagonistJoint,
    theta: Any,
    K: Any,
    T: Any,
    *,
    priority: Any,
    weights: Any,
    min_force: Any,
    max_force: Any,
    min_cocontraction: Any,
    stiffness_tolerance: Any,
    pull: Any,
    reference: Any,
    previous: Any,
    max_step: Any,
) -> tuple[Problem, Array]:
    """The flat problem, and the angles asked for in the common shape of all arguments."""
    named = {"theta": checks.angle("theta", theta), "K": checks.stiffness("K", K), "T": checks.real("T", T, "N·m")}
    now = {} if previous is None else checks.pressure_pair("previous", previous, ("P1_now", "P2_now"))
    if (previous is None) is not (max_step is None):
        raise InvalidInput("previous and max_step go together; one came without the other")
    step = {} if max_step is None else {"max_step": checks.positive_pressure("max_step", max_step)}
    rho = checks.not_negative("pull", pull, "cost/Pa²")
    if (reference is not None) is not (rho > 0):
        raise InvalidInput("pull > 0 and reference = (P1, P2) go together; one came without the other")
    towards = {} if reference is None else checks.pressure_pair("reference", reference, ("P1_ref", "P2_ref"))
    names = [*named, *now, *step, *towards]
    arrays = checks.broadcast(**named, **now, **step, **towards)
    flat = {name: array.flatten() for name, array in zip(names, arrays, strict=True)}  # copies: they stay as they are
    asked = flat["theta"].reshape(arrays[0].shape)
    low, high = _force_limits(min_force, max_force)
    problem = Problem(
        joint,
        theta=np.clip(flat.pop("theta"), *joint.angle_range),
        priority=_priority(priority),
        weights=_weights(priority, weights),
        min_force=low,
        max_force=high,
        min_cocontraction=_cocontraction(joint, min_cocontraction),
        stiffness_tolerance=_tolerance(priority, stiffness_tolerance),
        pull=rho,
        **flat,
    )
    return problem, asked


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


def _force_limits(min_force: Any, max_force: Any) -> tuple[float | None, float | None]:
    low = None if min_force is None else checks.not_negative("min_force", min_force, "N")
    high = None if max_force is None else checks.not_negative("max_force", max_force, "N")
    if high is not None and high <= (low or 0.0):
        raise InvalidInput(f"max_force = {high:g} N contradicts min_force = {low or 0.0:g} N: it has to exceed it")
    return low, high


def _cocontraction(joint: AntagonistJoint, floor: Any) -> float | None:
    if floor is None:
        return None
    value = checks.not_negative("min_cocontraction", checks.pressure("min_cocontraction", floor), "Pa")
    if value > joint.pressure_limits[1]:
        raise InvalidInput(
            f"min_cocontraction = {value:g} Pa contradicts the supply pressure of {joint.pressure_limits[1]:g} Pa"
        )
    return value


def _tolerance(priority: Priority, tolerance: Any) -> float:
    value = checks.not_negative("stiffness_tolerance", tolerance, "N·m/rad")
    if value and priority != "torque":
        raise InvalidInput(
            "stiffness_tolerance holds for priority='torque' only: elsewhere no answers are equally good"
        )
    return value


__all__ = ["problem_from"]
