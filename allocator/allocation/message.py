"""`details` puts what one target of a pair misses into words."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from allocator.allocation.status import Status
from allocator.inverse import why_no_inverse
from allocator.presentation.tables import number
from allocator.units import BAR, DEG

if TYPE_CHECKING:
    from allocator.allocation.pair import PairAllocation


def details(a: "PairAllocation") -> list[str]:
    """Return what exists, was asked and is given, as the status of the `PairAllocation` of one target has it."""
    found = _DETAILS.get(Status(a.status))
    return [] if found is None else [found(a)]


def _at(a: "PairAllocation") -> str:
    return f"{a.theta / DEG:.4g}°"


def _torque(a: "PairAllocation") -> str:
    """Return the torques that exist: all, or those with the stiffness given where that is what is in the way."""
    T_min, T_max = a.torque_interval
    if a.priority != "stiffness" and not T_min <= a.T_target <= T_max:
        return f"torque at {_at(a)} is {T_min:.4g} … {T_max:.4g} N·m, asked {a.T_target:.4g}"
    found = a.torque_intervals
    listed = " or ".join(f"{low:.4g} … {high:.4g}" for low, high in found[~np.isnan(found[:, 0])])
    return f"torque at {_at(a)} and {number(a.K)} N·m/rad is {listed} N·m, asked {a.T_target:.4g}"


def _stiffness(a: "PairAllocation") -> str:
    K_min, K_max = a.stiffness_interval
    name = a.stiffness_name
    return f"{name} at {_at(a)} and {number(a.T)} N·m is {K_min:.4g} … {K_max:.4g} N·m/rad, asked {a.K_target:.4g}"


def _both(a: "PairAllocation") -> str:
    return f"{_torque(a)}; stiffness given {a.K:.4g} N·m/rad, asked {a.K_target:.4g}"


def _pulled(a: "PairAllocation") -> str:
    asked = f"asked {a.T_target:.4g} N·m and {a.K_target:.4g} N·m/rad"
    return f"{asked}, given {number(a.T)} and {number(a.K)}"


def _slack(a: "PairAllocation") -> str:
    one, two = map(number, a.forces)
    return f"at {_at(a)} the forces are {one} N and {two} N"


def _outside(a: "PairAllocation") -> str:
    left, right = (f"{end / DEG:.4g}°" for end in a.joint.angle_range)
    return f"range {left} … {right}, asked {_at(a)}"


_DETAILS: dict[Status, Callable[["PairAllocation"], str]] = {
    Status.TORQUE_LIMITED: _torque,
    Status.STIFFNESS_LIMITED: _stiffness,
    Status.BOTH_LIMITED: _both,
    Status.PULLED: _pulled,
    Status.CONFLICT: lambda a: f"at {_at(a)}",
    Status.SLACK: _slack,
    Status.OUTSIDE_JOINT_RANGE: _outside,
    Status.OUTSIDE_LIMITS: lambda a: f"P1 = {a.P1 / BAR:.4g} bar, P2 = {a.P2 / BAR:.4g} bar",
    Status.NO_INVERSE: lambda a: why_no_inverse(a.joint, a.kind.isobaric),
}
