"""Arguments of `allocate`, and the checks that turn those of a joint into a `Problem`.

`allocator.allocation.box.arguments` checks those of a mechanism and shares checks with this module.
"""

from typing import Any, Literal, NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.allocation.status import PRIORITIES, Priority
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.felt import Secant
from allocator.joint.gas import Shares, Stiffness
from allocator.joint.limits import TAUT, Limits, checked_limits
from allocator.joint.torque_levels import Pair

Name = Literal["analytic", "exact", "qp", "nlp", "convex"]
_STRONGEST = 1e100  # [cost]/[Pa]² of a pull


class Method(NamedTuple):
    """Solution method with its options. A plain name stands for `Method(name)`.

    "exact": the global optimum, in closed form or by a complete search, see `Allocation.gap`. "analytic": the inverse
    alone, without limits; NaN where it does not exist. "qp" (successive QPs, of a mechanism one a level), "nlp"
    (CasADi), "convex" (cvxpy): optimisers that start from the analytic inverse; an answer that fails the library's own
    check is replaced, and the status says so.
    """

    name: Name = "exact"
    solver: str | None = None  # "qp": "daqp", "osqp", …; "nlp": "ipopt", "sqpmethod"; "convex": "clarabel", "osqp"
    warm_start: bool = True  # False starts the optimisers in the middle of the box, to measure its benefit
    gap: float = 1e-3  # of mechanisms that are not affine: the search ends at gap·(1 + cost) above the proved least
    uncertainty: object = None  # "convex": covariance of the muscles' parameters, a pair of them, or True for their own
    risk: float = 0.05  # α, the probability with which a force limit may be broken, see `uncertain.problem`

    @classmethod
    def of(cls, method: object) -> Self:
        """Return the `Method` of a name or a `Method`. Raises InvalidInput, also for invalid options."""
        if isinstance(method, cls):
            if not 0 < checks.number("gap", method.gap, "of 1 + cost") < 1:
                raise InvalidInput(f"gap = {method.gap:g} has to lie between 0 and 1, a share of 1 + cost")
            checks.probability("risk", method.risk)
            checks.flag("warm_start", method.warm_start)
            return method
        if isinstance(method, str):
            return cls(method)  # type: ignore[arg-type]  # the solver checks the names
        raise InvalidInput(f"method = {method!r} has to be a name, such as 'exact', or a Method")


class Asked(NamedTuple):
    """Arguments of `allocate` for a machine; only the method is checked."""

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
    """Return the checked, flat problem, and the requested angles in the common shape of all arguments.

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
    push, now = None if felt is None or joint.affine else felt.separable, _pair(flat, "P1_now", "P2_now")
    problem = Problem(
        joint,
        theta=np.clip(flat["theta"], *joint.angle_range),
        K=flat["K"],
        T=flat["T"],
        priority=chosen,
        weights=_weights(chosen, weights),
        limits=Limits(*_force_limits(limits), _cocontraction(joint, limits), now, flat.get("max_step")),
        stiffness_tolerance=_tolerance(chosen, tolerance),
        pull=rho,
        reference=_pair(flat, "P1_ref", "P2_ref"),
        felt=None if push is not None else felt,
        push=None if push is None else push[:2],
        own=0.0 if push is None else push[2],
    )
    return problem if shares is None else problem.with_shares(shares), flat["theta"].reshape(arrays[0].shape)


def pulled(pull: object) -> tuple[float, Any]:
    """Return the weight ρ > 0 [cost]/[Pa]² of a pull = (ρ, P_ref), and P_ref as given."""
    weight, reference = checks.pair("pull", pull, "has to be (ρ, P_ref), [cost]/[Pa]² and pressures")
    rho = checks.not_negative("pull[0]", weight, "cost/Pa²")
    if rho == 0:
        raise InvalidInput("pull = (ρ, P_ref) has to have ρ > 0; None is no pull")
    if rho > _STRONGEST:
        raise InvalidInput(f"pull[0] = {rho:g} cost/Pa² is over {_STRONGEST:g}, the most that is taken")
    return rho, reference


def checked_direction(direction: object) -> Array:
    """Return directions of motion from -1 to +1; fractions allow smooth changes."""
    s = checks.real("direction", direction, "-1 to +1")
    if (wrong := np.abs(s) > 1).any():
        raise InvalidInput(
            f"direction{checks.at(s, wrong)} has to lie between -1 (θ falls) and +1 (θ rises); 0: at rest"
        )
    return s


def _slew(limits: Limits) -> dict[str, Array]:
    """Return the checked arrays of the slew limit, or none without such a limit."""
    given = limits.previous is not None, limits.max_step is not None
    now = checks.pressure_pair("previous", limits.previous, ("P1_now", "P2_now")) if given[0] else {}
    if given[0] is not given[1]:
        raise InvalidInput("previous and max_step go together; one came without the other")
    return now | ({"max_step": checks.positive_pressure("max_step", limits.max_step)} if given[1] else {})


def _pair(flat: dict[str, Array], first: str, second: str) -> Pair | None:
    """Return two of the arrays, or None if they are missing."""
    return (flat[first], flat[second]) if first in flat else None


def checked_priority(priority: object) -> Priority:
    """Return the priority. Raises InvalidInput for an unknown one."""
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
