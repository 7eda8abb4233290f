"""One muscle held at a joint angle is half of the joint; everything static is said in terms of the two halves."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from allocator.calculus import Array, Value
from allocator.joint.limits import BINDS, Limit, Limits, PressureInterval
from allocator.muscles import AffineMuscle, Muscle


@dataclass(frozen=True)
class OneMuscle:
    """`OneMuscle` is a muscle held at a joint angle, which adds t(P) to the torque and k(P) to the stiffness."""

    muscle: Muscle
    sign: int  # +1 agonist, -1 antagonist
    rest_length: float  # l0 [m]
    contraction: Value  # ε [-]
    arm: Value  # a [m]
    arm_slope: Value  # da/dθ [m/rad]

    @property
    def affine(self) -> bool:
        """Return whether t and k are affine in the pressure."""
        return isinstance(self.muscle, AffineMuscle)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """Return (contraction, arm, arm slope): what varies from angle to angle."""
        return self.contraction, self.arm, self.arm_slope

    def moved(self, contraction: Array, arm: Array, arm_slope: Array) -> Self:
        """Return the muscle at other angles, or at a selection of them."""
        return replace(self, contraction=contraction, arm=arm, arm_slope=arm_slope)

    def force(self, P: Value) -> Value:
        """Return the muscle's force [N]; negative where the cable would be slack."""
        return self.muscle.law(P, self.contraction)

    def torque(self, P: Value) -> Value:
        """Return the torque t = ±a F(P, ε) [N·m] that the muscle adds."""
        return self.sign * self.arm * self.force(P)

    def stiffness(self, P: Value) -> Value:
        """Return the stiffness k = -a² F_ε/l0 ∓ a' F [N·m/rad] that the muscle adds."""
        elastic = -(self.arm**2) / self.rest_length * self.muscle.slope(P, self.contraction)
        return elastic - self.sign * self.arm_slope * self.force(P)

    def torque_gain(self, P: Value) -> Value:
        """Return dt/dP = ±a F_P [N·m/Pa]."""
        return self.sign * self.arm * self.muscle.gain(P, self.contraction)

    def stiffness_gain(self, P: Value) -> Value:
        """Return dk/dP = -a² F_Pε/l0 ∓ a' F_P [N·m/rad/Pa]."""
        elastic = -(self.arm**2) / self.rest_length * self.muscle.gain_slope(P, self.contraction)
        return elastic - self.sign * self.arm_slope * self.muscle.gain(P, self.contraction)

    def pressure_for_torque(self, torque: Array) -> Array:
        """Return the pressure [Pa] that makes this muscle add `torque`; ∓inf where it has none."""
        return self.muscle.pressure(self.sign * torque / self.arm, self.contraction)

    def interval(self, supply: tuple[float, float], limits: Limits) -> PressureInterval:
        """Intersect supply [Pa], validity of the model and `limits`, remembering which of them sets each end.

        Every limit counts by itself: where two lie at the same pressure both set the end. Only supply and validity of
        the model count as one, the lower, and the supply where they are equal.
        """
        lower, upper, slack, rate, validity, ceiling = _FLAGS[self.sign]
        everywhere = np.ones(np.shape(self.contraction))
        most = (self.muscle.max_pressure, validity) if self.muscle.max_pressure < supply[1] else (supply[1], upper)
        floors, ceilings = [(supply[0] * everywhere, lower)], [(most[0] * everywhere, most[1])]
        if limits.min_force is not None:
            floors.append((self.muscle.pressure(limits.min_force, self.contraction), slack))
        if limits.max_force is not None:
            ceilings.append((self.muscle.pressure(limits.max_force, self.contraction), ceiling))
        nearest, farthest = limits.reach(0 if self.sign > 0 else 1)
        reach = (nearest, rate), (farthest, rate)
        return PressureInterval.between(floors, ceilings, reach, BINDS * (supply[1] - supply[0]))


_FLAGS = {
    +1: (
        Limit.P1_LOWER,
        Limit.P1_UPPER,
        Limit.AGONIST_SLACK,
        Limit.P1_RATE,
        Limit.AGONIST_VALIDITY,
        Limit.AGONIST_FORCE,
    ),
    -1: (
        Limit.P2_LOWER,
        Limit.P2_UPPER,
        Limit.ANTAGONIST_SLACK,
        Limit.P2_RATE,
        Limit.ANTAGONIST_VALIDITY,
        Limit.ANTAGONIST_FORCE,
    ),
}

__all__ = ["OneMuscle"]
