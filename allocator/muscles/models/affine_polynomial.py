"""The plainest affine muscle is made of polynomials in the contraction."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.muscles.base import AffineMuscle
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class AffinePolynomial(AffineMuscle):
    """The force is F = P (a0 + a1 ε + a2 ε² + …) + b0 + b1 ε + …

    Not from a paper. With a quadratic area and a linear passive force, the default of a fit, five numbers that have
    no bend to overfit: on a joint with three muscle lengths it predicts a length left out better than laws with more
    curvature. [M] holds where the area is positive and falls.
    """

    citation = "polynomials in the contraction, of the user's degrees"
    strength: ClassVar[Mapping[str, float]] = {"area": 1.0, "passive": 1.0}

    area: tuple[float, ...]  # a_i, rising powers of ε [N/Pa]
    passive: tuple[float, ...]  # b_i, rising powers of ε [N]

    def __post_init__(self) -> None:
        """Insist on a force that depends on the pressure."""
        super().__post_init__()
        if not self.area:
            raise InvalidInput("AffinePolynomial needs at least one coefficient of the area [N/Pa]")

    def A(self, eps: Value) -> Value:
        """Return A(ε) = a0 + a1 ε + a2 ε² + …"""
        return _horner(self.area, eps)

    def B(self, eps: Value) -> Value:
        """Return B(ε) = b0 + b1 ε + …"""
        return _horner(self.passive, eps)

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A = a0 ε + a1 ε²/2 + a2 ε³/3 + …"""
        return eps * _horner(tuple(a / (i + 1) for i, a in enumerate(self.area)), eps)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a quadratic area and a linear passive force, all linear; pass `start` for other degrees."""
        return Recipe((cls((0.0,) * 3, (0.0,) * 2),), ("area", "passive"))


def _horner(coefficients: tuple[Value, ...], eps: Value) -> Value:
    value = 0.0 * eps
    for coefficient in reversed(coefficients):
        value = value * eps + coefficient
    return value
