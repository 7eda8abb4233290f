"""What every muscle model has in common.

A muscle is a static force law F(P, ε): contraction force [N] from gauge pressure P [Pa] and contraction ratio
ε = (l0 - l)/l0 [-]. It pulls only: where F < 0 the cable is slack and the law does not hold, so the taut region F ≥ 0
is its domain. A model worth using satisfies on it

    ∂F/∂P > 0  and  ∂²F/∂P∂ε < 0        (more pressure pulls more, and stiffens)        [M]

from which the uniqueness of the inverse follows (see `allocator.inverse`).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from allocator.calculus import Array, Value, derivative, increasing_root
from allocator.errors import InvalidInput


@dataclass(frozen=True)
class Muscle(ABC):
    """A static force law F(P, ε); immutable, its fields are the model's parameters in SI units.

    Every method takes floats, arrays (broadcast) or CasADi symbols, except `pressure`, which is numeric.
    """

    citation: ClassVar[str]
    """Where the formula was published."""

    def __post_init__(self) -> None:
        """Turn every parameter into a plain float (NumPy scalars upset CasADi) and refuse what is not finite."""
        for field in fields(self):
            value = getattr(self, field.name)
            try:
                number = float(value)
            except (TypeError, ValueError):
                number = float("nan")
            if not np.isfinite(number):
                raise InvalidInput(f"{type(self).__name__}: {field.name} = {value!r} is not a finite number")
            object.__setattr__(self, field.name, number)

    @property
    def max_pressure(self) -> float:
        """Gauge pressure [Pa] up to which the law satisfies [M] on its taut region."""
        return np.inf

    @property
    def max_contraction(self) -> float:
        """Contraction ratio [-] up to which the law is meant to be used."""
        return 0.35

    @abstractmethod
    def force(self, P: Value, eps: Value) -> Value:
        """Contraction force F(P, ε) [N]; negative where the cable would be slack."""

    @abstractmethod
    def gain(self, P: Value, eps: Value) -> Value:
        """∂F/∂P [N/Pa], at constant contraction."""

    def slope(self, P: Value, eps: Value) -> Value:
        """∂F/∂ε [N], at constant pressure."""
        return derivative(lambda e: self.force(P, e), eps)

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """∂²F/∂P∂ε [N/Pa]."""
        return derivative(lambda e: self.gain(P, e), eps)

    def pressure(self, F: Value, eps: Value) -> Array:
        """Pressure [Pa] that gives the force `F` at `eps`; ∓inf where F is below or above all that the law can give."""
        ceiling = min(self.max_pressure, _SEARCH_CEILING)
        F, eps = np.asarray(F, float), np.asarray(eps, float)
        return increasing_root(lambda P, F, e: self.force(P, e) - F, np.zeros(()), np.asarray(ceiling), F, eps)


_SEARCH_CEILING = 20e5  # [Pa] far above any pneumatic muscle's burst pressure


class AffineMuscle(Muscle):
    """A law affine in pressure, F(P, ε) = P·A(ε) + B(ε): two one-line functions make a model.

    Most published laws are of this kind. Torque and stiffness are then affine in the two pressures, and every inverse
    is in closed form.
    """

    @abstractmethod
    def A(self, eps: Value) -> Value:
        """Force per pressure A(ε) [N/Pa], the effective area."""

    def B(self, eps: Value) -> Value:
        """Force at zero pressure B(ε) [N]; none unless the model has a passive part."""
        return 0.0 * eps

    def force(self, P: Value, eps: Value) -> Value:
        """F = P·A(ε) + B(ε) [N]."""
        return P * self.A(eps) + self.B(eps)

    def gain(self, P: Value, eps: Value) -> Value:
        """∂F/∂P = A(ε) [N/Pa]."""
        return self.A(eps) + 0.0 * P

    def slope(self, P: Value, eps: Value) -> Value:
        """∂F/∂ε = P·A'(ε) + B'(ε) [N]."""
        return P * derivative(self.A, eps) + derivative(self.B, eps)

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """∂²F/∂P∂ε = A'(ε) [N/Pa]."""
        return derivative(self.A, eps) + 0.0 * P

    def pressure(self, F: Value, eps: Value) -> Array:
        """P = (F - B(ε))/A(ε) [Pa]."""
        return np.asarray((F - self.B(eps)) / self.A(eps))


__all__ = ["AffineMuscle", "Muscle"]
