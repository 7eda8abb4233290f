"""The polynomial force function of Festo's engineers is affine in the pressure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

from allocator.calculus import Array, Value
from allocator.muscles.base import AffineMuscle
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class Hildebrandt2005(AffineMuscle):
    """The force is F = (c0 + c1 ε + c2 ε²) P - (d0 + d1 ε + d2 ε² + d3 ε³ + d4 ε^{2/3})   (16)

    A. Hildebrandt, O. Sawodny, R. Neumann and A. Hartmann, "Cascaded control concept of a robot with two degrees of
    freedom driven by four artificial pneumatic muscle actuators", American Control Conference 2005; Tondu 2021,
    equation (16). The coefficients were not found in print: fit them. Domain ε ≥ 0; for d4 ≠ 0 the stiffness is
    infinite at ε = 0, keep away from it. [M] holds where c0 + c1 ε + c2 ε² > 0 and c1 + 2 c2 ε < 0.
    """

    citation = "Hildebrandt, Sawodny, Neumann & Hartmann, American Control Conference, 680-685, 2005"
    strength: ClassVar[Mapping[str, float]] = dict.fromkeys(("c0", "c1", "c2", "d0", "d1", "d2", "d3", "d4"), 1.0)

    c0: float  # [N/Pa]
    c1: float  # [N/Pa]
    c2: float  # [N/Pa]
    d0: float  # [N]
    d1: float  # [N]
    d2: float  # [N]
    d3: float  # [N]
    d4: float  # [N]

    @property
    def min_contraction(self) -> float:
        """Return 0: ε^{2/3} has no slope there and no real value below."""
        return 0.0

    def A(self, eps: Value) -> Value:
        """Return A(ε) = c0 + c1 ε + c2 ε²   (16)"""
        return self.c0 + (self.c1 + self.c2 * eps) * eps

    def B(self, eps: Value) -> Value:
        """Return B(ε) = -(d0 + d1 ε + d2 ε² + d3 ε³ + d4 ε^{2/3})   (16)"""
        return -(self.d0 + (self.d1 + (self.d2 + self.d3 * eps) * eps) * eps + self.d4 * eps ** (2 / 3))

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A = c0 ε + c1 ε²/2 + c2 ε³/3"""
        return (self.c0 + (self.c1 / 2 + self.c2 / 3 * eps) * eps) * eps

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe in which all eight are linear."""
        start = cls(*[0.0] * 8)
        return Recipe((start,), tuple(start.parameters))
