"""The allocation problem.

At a joint angle θ, with targets T* and K*, over the pressures P = (P1, P2):

    minimise    w_T (T(θ, P) - T*)² + w_K (K(θ, P) - K*)²
    subject to  lo_i(θ) ≤ P_i ≤ hi_i(θ),  i = 1, 2                                                              [A]

Supply limits, taut muscles (F_i ≥ min_force, a bound on P_i alone since force grows with pressure), the validity of the
muscle models and the slew limits all are bounds on a single pressure: the feasible set is the box [lo, hi], see
`allocator.joint.AntagonistJoint.pressure_box`. Angles beyond the joint range are replaced by the nearest one inside.

`priority` says what is given up where both targets cannot be met: "weighted" is [A] itself; "torque" is the limit
w_T/w_K → ∞ (first the nearest torque, then among all pressures that give it the nearest stiffness) and "stiffness" the
opposite limit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.joint import AntagonistJoint
from allocator.levels import Pair, Sides
from allocator.limits import PressureBox

Priority = Literal["torque", "stiffness", "weighted"]
PRIORITIES: tuple[Priority, ...] = get_args(Priority)


@dataclass(frozen=True)
class Problem:
    """n allocation problems [A] of one joint. All arrays have the shape (n,)."""

    joint: AntagonistJoint
    theta: Array  # joint angle within the joint range [rad]
    K: Array  # stiffness target [N·m/rad]
    T: Array  # torque target [N·m]
    priority: Priority = "torque"
    weights: tuple[float, float] = (1.0, 1.0)  # (w_T [cost]/[N·m]², w_K [cost]/[N·m/rad]²), for "weighted"
    min_force: float | None = 0.0  # least muscle force [N]; None: cables may be slack
    slew: tuple[Array, ...] | None = None  # (P1 now, P2 now, greatest step) [Pa]

    @cached_property
    def sides(self) -> Sides:
        """The joint held at the angles."""
        return self.joint.sides(self.theta)

    @cached_property
    def box(self) -> PressureBox:
        """All limits together."""
        previous, max_step = (self.slew[:2], self.slew[2]) if self.slew else (None, None)
        return self.joint.pressure_box(self.theta, min_force=self.min_force, previous=previous, max_step=max_step)

    def errors(self, P1: Array, P2: Array) -> Pair:
        """(T - T*, K - K*) at pressures (…, n)."""
        one, two = self.sides
        return one.torque(P1) + two.torque(P2) - self.T, one.stiffness(P1) + two.stiffness(P2) - self.K

    @cached_property
    def scales(self) -> Pair:
        """What counts as large: both muscles' torque and stiffness at their upper bounds, in absolute value."""
        one, two = self.sides
        hi1, hi2 = self.box.agonist.hi, self.box.antagonist.hi
        return (
            np.abs(one.torque(hi1)) + np.abs(two.torque(hi2)) + np.abs(self.T),
            np.abs(one.stiffness(hi1)) + np.abs(two.stiffness(hi2)) + np.abs(self.K),
        )

    def take(self, where: NDArray[np.bool_]) -> Self:
        """The problems at which the mask `where` (n,) is true."""
        slew = tuple(array[where] for array in self.slew) if self.slew else None
        return replace(self, theta=self.theta[where], K=self.K[where], T=self.T[where], slew=slew)

    def at(self, theta: Array) -> Self:
        """The same targets at other angles (n,)."""
        return replace(self, theta=theta)


Solver = Callable[[Problem], Pair]
"""A back-end: from n problems to their pressures (P1, P2), each (n,)."""

__all__ = ["PRIORITIES", "Priority", "Problem", "Solver"]
