"""Muscle model proposed in Tondu's report."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.muscles.basis import Basis
from allocator.muscles.models.mckibben import BRAID, Braided, braid_constants
from allocator.muscles.recipe import Recipe
from allocator.units import BAR, DEG


@dataclass(frozen=True)
class Tondu2021(Braided):
    """The force is F = S [(a-b) P - ε (cP+e)/(P+d)]   (13) with (18)

    B. Tondu, "Towards an efficient inverse static model of a Festo actuator …", arXiv 2104.13167, 2021. Rational, not
    affine, in the pressure. Written with g = e - cd < 0 the braid's counter-force is ε (c + g/(P+d)), so that only the
    pole at P = -d > 0 matters. Domain: 0 ≤ P ≤ `max_pressure` (far below the pole), 0 ≤ ε ≤ ε_max(P).
    """

    citation = "Tondu, arXiv 2104.13167, 2021"
    strength: ClassVar[Mapping[str, float]] = BRAID

    c: float  # [Pa]
    d: float  # [Pa]
    e: float  # [Pa²]

    def __post_init__(self) -> None:
        """Refuse parameters for which more contraction or less pressure would pull more."""
        super().__post_init__()
        if not (self.d < 0 and self.e < 0 and self.g < 0):
            raise InvalidInput(
                f"Tondu2021 needs d < 0, e < 0 and e < c d (else [M] fails); got c = {self.c:g} Pa, "
                f"d = {self.d:g} Pa, e = {self.e:g} Pa²"
            )

    @classmethod
    def identify(
        cls, r0: float, alpha0: float, low: tuple[float, float], high: tuple[float, float], c: float = 0.0
    ) -> Self:
        """Fit the model to two readings (P [Pa], ε_max(P) [-]) of the contraction without load, by (19)."""
        a, b = braid_constants(alpha0)
        (P1, eps1), (P2, eps2) = low, high
        ratio = eps2 / eps1
        d = -(P2**2 - ratio * P1**2) / (P2 - ratio * P1)  # (19)
        d += c / (a - b) * (P2 - P1) * eps2 / (P2 - ratio * P1)
        e = (a - b) * P1 * (P1 + d) / eps1 - c * P1  # (19)
        return cls(r0, alpha0, c, d, e)

    @property
    def g(self) -> float:
        """g = e - cd [Pa²]: (cP+e)/(P+d) = c + g/(P+d)."""
        return self.e - self.c * self.d

    @property
    def max_pressure(self) -> float:
        """Where ε_max(P) turns back and [M] ends, taut: cP² + 2eP + ed = 0, i.e. -d/2 for c = 0 [Pa]."""
        return self.e * self.d / (-self.e + sqrt(self.e * self.g))

    @property
    def basis(self) -> Basis:
        """Basis functions of the pressure: 1, P and 1/(P+d)."""
        return Basis("rational", shape=self.d)

    def law(self, P: Value, eps: Value) -> Value:
        """Return F = S [(a-b) P - ε (cP+e)/(P+d)]   (13), (18)"""
        return self.S * ((self.a - self.b) * P - eps * (self.c * P + self.e) / (P + self.d))

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P = S [(a-b) + ε g/(P+d)²]"""
        return self.S * (self.a - self.b + eps * self.g / (P + self.d) ** 2)

    def slope(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂ε = -S (cP+e)/(P+d), the same at every contraction   (21)"""
        return -self.S * (self.c * P + self.e) / (P + self.d) + 0.0 * eps

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """Return ∂²F/∂P∂ε = S g/(P+d)²"""
        return self.S * self.g / (P + self.d) ** 2 + 0.0 * eps

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return ∫_0^ε F_P = S [(a-b) ε + ε² g/(2 (P+d)²)]"""
        return self.S * ((self.a - self.b) * eps + eps**2 * self.g / (2 * (P + self.d) ** 2))

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return its derivative by P, -S ε² g/(P+d)³"""
        return -self.S * eps**2 * self.g / (P + self.d) ** 3

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return the smaller root of (a-b)P² + ((a-b)d - cε - F/S)P - (eε + dF/S) = 0; inf above the greatest force."""
        F, eps = np.asarray(F, float), np.asarray(eps, float)
        q2 = self.a - self.b
        q1 = q2 * self.d - self.c * eps - F / self.S
        q0 = -(self.e * eps + self.d * F / self.S)
        with np.errstate(invalid="ignore"):
            root = np.sqrt(q1**2 - 4 * q2 * q0)
            # q1 < 0 on the domain: the sum below does not cancel, the smaller root follows from the product q0/q2
            P = 2 * q0 / (-q1 + root)
        return np.where(np.isnan(P) & ~np.isnan(F + eps), np.inf, P)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe linear in c and e.

        The pole -d is kept above the pressures measured, where it does not belong.

        Forces show only S(a-b), Sc, Se and d: hold r0 or α0 to learn the others.
        """
        highest = float(np.max(pressure))
        starts = tuple(cls(0.01, 25 * DEG, 0.0, -pole * highest, -(highest**2)) for pole in (1.3, 2.1, 4.0))
        bounds = {
            "r0": (1e-4, 0.5),
            "alpha0": (5 * DEG, 54 * DEG),
            "d": (-100 * highest, -1.05 * highest),
            "e": (-np.inf, -1e-6 * BAR**2),
        }
        return Recipe(starts, ("c", "e"), bounds=bounds)
