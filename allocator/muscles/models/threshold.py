"""Muscle of polynomials with a threshold pressure, below which its bladder does not touch the braid."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.muscles.base import Muscle
from allocator.muscles.basis import Basis
from allocator.muscles.measured import continued, continued_integral
from allocator.muscles.models.affine import AffinePolynomial
from allocator.muscles.recipe import Recipe
from allocator.units import BAR


@dataclass(frozen=True)
class ThresholdPolynomial(Muscle):
    """Polynomials in the contraction above a threshold pressure: F = p A(ε) + B(ε), p = P²/(P + P_t).

    A = a0 + a1 ε + a2 ε² + …, B = b0 + b1 ε + … Not from a paper: `AffinePolynomial` with the pressure p that the
    bladder's own tension leaves. p is 0 with zero slope at P = 0 and tends to P - P_t above the threshold. Home-made
    muscles have 0.1 to 0.3 bar, below which the bladder is stretched but does not press on the braid. P_t → 0 is
    `AffinePolynomial`. [M] holds for P > 0 where the area is positive and falls. Domain: P ≥ 0.
    """

    citation = "polynomials in the contraction, of the user's degrees, above a threshold pressure"
    strength: ClassVar[Mapping[str, float]] = {"area": 1.0, "passive": 1.0}
    has_threshold: ClassVar[bool] = True

    area: tuple[float, ...]  # a_i, rising powers of ε [N/Pa]
    passive: tuple[float, ...]  # b_i, rising powers of ε [N]
    P_t: float  # threshold pressure [Pa]

    def __post_init__(self) -> None:
        """Insist on an area and on a positive threshold."""
        super().__post_init__()
        if not self.area:
            raise InvalidInput("ThresholdPolynomial needs at least one coefficient of the area [N/Pa]")
        if not self.P_t > 0:
            raise InvalidInput(f"ThresholdPolynomial: P_t = {self.P_t:g} Pa has to be a positive pressure")

    @property
    def _above(self) -> AffinePolynomial:
        """Muscle whose pressure is p."""
        return _unchecked(self.area, self.passive)

    def effective_pressure(self, P: Value) -> Value:
        """Return p = P²/(P + P_t) [Pa]."""
        return P**2 / (P + self.P_t)

    @property
    def basis(self) -> Basis:
        """Basis functions 1, P and 1/(P + P_t), since p = P - P_t + P_t²/(P + P_t)."""
        return Basis("rational", self.P_t)

    def law(self, P: Value, eps: Value) -> Value:
        """Return F = p A(ε) + B(ε) [N]."""
        p, above = self.effective_pressure(P), self._above
        return p * continued(above.A, eps, self.edges) + continued(above.B, eps, self.edges)

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P = (1 - (P_t/(P + P_t))²) A(ε) [N/Pa]."""
        return self._effective_slope(P) * continued(self._above.A, eps, self.edges)

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return ∫_0^ε F_P = p'(P) ∫_0^ε A."""
        return self._effective_slope(P) * self._area_integral(eps)

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return its derivative by P, p''(P) ∫_0^ε A."""
        return 2 * self.P_t**2 / (P + self.P_t) ** 3 * self._area_integral(eps)

    def _effective_slope(self, P: Value) -> Value:
        """Return p' = 1 - (P_t/(P + P_t))² [-]."""
        return P * (P + 2 * self.P_t) / (P + self.P_t) ** 2

    def _area_integral(self, eps: Value) -> Value:
        return continued_integral(self._above.A, self._above.A_integral, eps, self.edges)

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return P = p/2 + √(p²/4 + p P_t) [Pa], p = (F - B)/A; -inf for p < 0."""
        above = self._above
        A, B = (np.asarray(continued(f, np.asarray(eps, float), self.edges)) for f in (above.A, above.B))
        with np.errstate(divide="ignore", invalid="ignore"):
            p = (np.asarray(F, float) - B) / A
            return np.where(p < 0, -np.inf, p / 2 + np.sqrt(p**2 / 4 + p * self.P_t))

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe linear but for P_t, with a quadratic area and a linear passive force."""
        starts = tuple(cls((0.0,) * 3, (0.0,) * 2, P_t * BAR) for P_t in (0.1, 0.4))
        return Recipe(starts, ("area", "passive"), bounds={"P_t": (0.05 * BAR, 1.5 * BAR)})


def _unchecked(area: tuple[Value, ...], passive: tuple[Value, ...]) -> AffinePolynomial:
    """Return the polynomials with coefficients that may be complex or symbols."""
    muscle = object.__new__(AffinePolynomial)
    object.__setattr__(muscle, "area", area)
    object.__setattr__(muscle, "passive", passive)
    return muscle
