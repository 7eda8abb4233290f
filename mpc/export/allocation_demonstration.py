"""What the exported demonstration of the allocation does, and what it prints according to Python."""

from collections.abc import Iterator

import numpy as np

from allocator import allocate, stiffness_interval
from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from mpc.export import text

_PLACES = (0.2, 0.5, 0.8)  # of the joint range
_SHARES = ((0.0, 0.3), (0.1, 0.7), (50.0, 0.4))  # torque [N·m], the last too much; share of the stiffness interval


def targets(joint: AntagonistJoint) -> Array:
    """Return rows (θ, K, T) of targets to demonstrate the allocation with."""
    left, right = joint.angle_range
    rows = []
    for place in _PLACES:
        theta = round(left + place * (right - left), 4)
        low, high = (float(end) for end in stiffness_interval(theta, 0.0, joint=joint))
        rows += [(theta, round(low + share * (high - low), 4), T) for T, share in _SHARES]
    return np.array(rows)


def allocation_table(joint: AntagonistJoint, single: bool, skipped: bool = False) -> str:
    """Return the header with the targets of the demonstration, with none of them if it is `skipped`."""
    return text.demonstration("theta [rad], K [N*m/rad], T [N*m]", targets(joint), single, skipped)


def allocation_lines(joint: AntagonistJoint) -> Iterator[str]:
    """Yield the lines that main.c prints about the targets of the demonstration."""
    for theta, K, T in targets(joint).tolist():
        a = allocate(theta, K, T, joint=joint)
        yield (
            f"theta {theta:8.4f} rad, K {K:7.4f} N*m/rad, T {T:8.4f} N*m: "
            f"P1 {a.P1:8.1f} Pa, P2 {a.P2:8.1f} Pa, status {int(a.status)}, limits {int(a.limits)}"
        )
