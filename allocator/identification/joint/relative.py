"""Joint known up to its force scale, from equilibria without a weight.

Gradients are with respect to q = (parameters of the agonist, parameters of the antagonist), the order of
`AntagonistJoint.covariance`.
"""

from dataclasses import dataclass
from os import PathLike
from typing import NamedTuple, NoReturn

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.one_muscle import OneMuscle
from allocator.machine_file import save_machine
from allocator.muscles import parameter_sensitivities
from allocator.muscles.uncertainty import deviation
from allocator.units import BAR, DEG

WHY = (
    "needs the force scale, which equilibria without a weight cannot tell: pass torque= of a known weight to fit_joint"
)


class Quantity(NamedTuple):
    """Values and their gradients."""

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


def stiffness_with_gradient(joint: AntagonistJoint, theta: Array, P1: Array, P2: Array) -> Quantity:
    """Return K [N·m/rad] (n,) and ∂K/∂q."""
    one, two = joint.sides(theta)
    K = one.stiffness(P1) + two.stiffness(P2)
    return Quantity(K, np.hstack([_stiffness_gradient(one, P1), _stiffness_gradient(two, P2)]))


def _stiffness_gradient(side: OneMuscle, P: Array) -> Array:
    _, force, slope = parameter_sensitivities(side.muscle, P, side.contraction)
    arm, bend = np.asarray(side.arm)[:, None], np.asarray(side.bend)[:, None]
    return np.asarray(-(arm**2) / side.rest_length * slope + bend * force)


@dataclass(frozen=True)
class RelativeJoint:
    """Joint known up to a common factor of all forces; angles and ratios of stiffnesses are absolute.

    All other attributes of an `AntagonistJoint` raise an error.
    """

    shape: AntagonistJoint  # its forces are on a conventional scale, without a meaning of their own

    def equilibrium(self, P1: Value, P2: Value) -> Array:
        """Return the angle [rad] of the unloaded joint at these pressures; NaN if there is none in the joint range."""
        return self.shape.equilibrium(P1, P2)

    def relative_stiffness(self, theta: Value, P1: Value, P2: Value) -> Array:
        """Return K/K_ref [-] with K_ref at `reference`."""
        return self._ratio(theta, P1, P2).value

    def relative_stiffness_std(self, theta: Value, P1: Value, P2: Value) -> Array:
        """Return the standard deviation of K/K_ref [-] from the covariance of the fit.

        It excludes the law's own error.
        """
        if self.shape.covariance is None:
            raise InvalidInput("this joint has no covariance: it was not fitted")
        return self._ratio(theta, P1, P2).std(np.asarray(self.shape.covariance))

    def _ratio(self, theta: Value, P1: Value, P2: Value) -> Quantity:
        K = stiffness_with_gradient(self.shape, *_flat(theta, P1, P2))
        return K.ratio(stiffness_with_gradient(self.shape, *_flat(*self.reference)))

    @property
    def unseen(self) -> tuple[str, ...]:
        """Return the quantities that the data of the fit leave open, except the force scale."""
        return self.shape.unseen

    @property
    def slack_assumed(self) -> bool:
        """Return whether the pressures at which cables go slack are assumed rather than identified."""
        return self.shape.slack_assumed

    @property
    def reference(self) -> tuple[float, float, float]:
        """Return (θ, P1, P2) [rad, Pa, Pa] of K_ref: the middle of the joint, both pressures in the middle of the
        supply.
        """
        P = sum(self.shape.pressure_limits) / 2
        left, right = self.shape.angle_range
        return (0.0 if left < 0 < right else (left + right) / 2, P, P)

    def save(self, path: str | PathLike[str]) -> None:
        """Write it as TOML; commands that need stiffness refuse it until it has a scale."""
        save_machine(self.shape, path, scale_known=False)

    def __getattr__(self, name: str) -> NoReturn:
        """Raise an error for attributes of an `AntagonistJoint` that need the force scale."""
        if not name.startswith("_") and hasattr(AntagonistJoint, name):
            raise InvalidInput(f"{name} of this joint {WHY}")
        raise AttributeError(f"a RelativeJoint has no {name!r}")


def _flat(theta: Value, P1: Value, P2: Value) -> tuple[Array, Array, Array]:
    P1, P2 = checks.pressures_or_symbols(P1, P2)
    arrays = checks.broadcast(theta=checks.angle("theta", theta), P1=P1, P2=P2)
    theta, P1, P2 = (np.atleast_1d(a).ravel().astype(float) for a in arrays)
    return theta, P1, P2


def describe_reference(joint: RelativeJoint) -> str:
    """Return the reference of K_ref in words."""
    theta, P1, P2 = joint.reference
    return f"θ = {theta / DEG:.3g}°, P1 = {P1 / BAR:.3g} bar, P2 = {P2 / BAR:.3g} bar"
