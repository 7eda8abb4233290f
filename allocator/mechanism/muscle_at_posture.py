"""One muscle held at a posture is what everything static of a mechanism is a sum of.

It is `allocator.joint.one_muscle.OneMuscle` with the moment arm as a vector and its slope as a matrix: what stands
there as ±a is r here, ∓a' is H, a² is r rᵀ.
"""

from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.joint.limits import Limits, PressureInterval
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import AffineMuscle, Muscle


@dataclass(frozen=True)
class MuscleAtPosture:
    """A `MuscleAtPosture` has a torque r F(P) and a stiffness k(P) r rᵀ + F(P) H; pressures are (…)."""

    muscle: Muscle
    rest_length: float  # L [m]
    contraction: Array  # ε (…) [-]
    arm: Array  # r (…, n) [m]
    bend: Array  # H (…, n, n) [m]

    @property
    def affine(self) -> bool:
        """Return whether torque and stiffness are affine in the pressure."""
        return isinstance(self.muscle, AffineMuscle)

    def force(self, P: Array) -> Array:
        """Return the muscle's force F (…) [N]; negative where it would be slack."""
        return np.asarray(self.muscle.law(P, self.contraction))

    def own_stiffness(self, P: Array) -> Array:
        """Return k = -F_ε/L (…) [N/m]."""
        return np.asarray(-self.muscle.slope(P, self.contraction) / self.rest_length)

    def torque(self, P: Array) -> Array:
        """Return r F (…, n) [N·m]   (M1)"""
        return np.asarray(self.arm * self.force(P)[..., None])

    def stiffness(self, P: Array) -> Array:
        """Return k r rᵀ + F H (…, n, n) [N·m/rad]   (M2)"""
        return self._matrix(self.own_stiffness(P), self.force(P))

    def torque_gain(self, P: Array) -> Array:
        """Return the derivative of `torque` by P, r F_P (…, n) [N·m/Pa]."""
        return np.asarray(self.arm * np.asarray(self.muscle.gain(P, self.contraction))[..., None])

    def stiffness_gain(self, P: Array) -> Array:
        """Return the derivative of `stiffness` by P, -F_Pε/L r rᵀ + F_P H (…, n, n) [N·m/rad/Pa]."""
        own = -np.asarray(self.muscle.gain_slope(P, self.contraction)) / self.rest_length
        return self._matrix(own, np.asarray(self.muscle.gain(P, self.contraction)))

    def _matrix(self, along: Array, across: Array) -> Array:
        outer = self.arm[..., :, None] * self.arm[..., None, :]
        return np.asarray(along[..., None, None] * outer + across[..., None, None] * self.bend)

    def interval(self, supply: tuple[float, float], limits: Limits) -> PressureInterval:
        """Intersect supply [Pa], validity of the model and `limits`, of which slew is that of the first muscle.

        The flags of the ends are those of an agonist.
        """
        alone = OneMuscle(self.muscle, +1, self.rest_length, self.contraction, self.arm, self.bend)
        return alone.interval(supply, limits)


__all__ = ["MuscleAtPosture"]
