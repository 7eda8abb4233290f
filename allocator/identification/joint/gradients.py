"""Stiffness and torque per pressure of a joint depend on the parameters of both its muscles as worked out here.

Gradients are with respect to q = (parameters of the agonist, parameters of the antagonist), the order of
`AntagonistJoint.covariance`.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import parameter_sensitivities
from allocator.muscles.uncertainty import deviation, parameter_gradient


class Quantity(NamedTuple):
    """A quantity has values and their gradients."""

    value: Array  # (n,)
    gradient: Array  # (n, m) per parameter

    def std(self, covariance: Array) -> Array:
        """Return the standard deviation (n,)."""
        return deviation(self.gradient, covariance)

    def relative_std(self, covariance: Array) -> Array:
        """Return the standard deviation of the logarithm (n,)."""
        return deviation(self.gradient / self.value[:, None], covariance)

    def ratio(self, other: "Quantity") -> "Quantity":
        """Return the value divided by the other, element by element or by one value for all."""
        value = self.value / other.value
        logarithm = self.gradient / self.value[:, None] - other.gradient / other.value[:, None]
        return Quantity(value, value[:, None] * logarithm)


def stiffness(joint: AntagonistJoint, theta: Array, P1: Array, P2: Array) -> Quantity:
    """Return K [N·m/rad] (n,) and ∂K/∂q."""
    one, two = joint.sides(theta)
    K = one.stiffness(P1) + two.stiffness(P2)
    return Quantity(K, np.hstack([_stiffness_gradient(one, P1), _stiffness_gradient(two, P2)]))


def _stiffness_gradient(side: OneMuscle, P: Array) -> Array:
    _, force, slope = parameter_sensitivities(side.muscle, P, side.contraction)
    arm, bend = np.asarray(side.arm)[:, None], np.asarray(side.bend)[:, None]
    return np.asarray(-(arm**2) / side.rest_length * slope + bend * force)


def torque_gain(joint: AntagonistJoint, theta: Array, P1: Array, P2: Array) -> Quantity:
    """Return ∂T/∂P1 [N·m/Pa] (n,) and its gradient in q."""
    one, two = joint.sides(theta)
    of_agonist = parameter_gradient(one.muscle, lambda m: one.arm * m.gain(P1, one.contraction), theta.shape)
    of_antagonist = np.zeros((theta.size, len(two.muscle.parameters)))
    return Quantity(np.asarray(one.torque_gain(P1)), np.hstack([of_agonist, of_antagonist]))
