"""McKibben muscle with a polynomial counter-force."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.muscles.base import AffineMuscle
from allocator.muscles.models.mckibben import BRAID, Braided, braid_constants
from allocator.muscles.recipe import Recipe
from allocator.units import BAR, DEG


@dataclass(frozen=True)
class PolynomialMcKibben(Braided, AffineMuscle):
    """The force is F = S [(a-b) P - ε (a0 + a1 ε + a2 ε² + …)]   (13), (14)

    Proposed and left aside in B. Tondu, arXiv 2104.13167, 2021, equations (13)-(15). Any number of coefficients
    [Pa]. The counter-force does not see the pressure: the force isobars are parallel, F_Pε = 0, and so [M] fails by
    equality: the stiffness of a joint does not depend on its pressures and cannot be commanded. Forces show only
    S(a-b) and S a_i, so hold r0 or α0 when fitting.
    """

    citation = "Tondu, arXiv 2104.13167, 2021"
    strength: ClassVar[Mapping[str, float]] = BRAID

    coefficients: tuple[float, ...]  # a_i, rising powers of ε [Pa]

    @classmethod
    def identify(cls, r0: float, alpha0: float, pressure: Sequence[float], max_contraction: Sequence[float]) -> Self:
        """Fit the model through n readings (P_i [Pa], ε_max(P_i) [-]) of the contraction without load, by (15)."""
        P, eps = np.asarray(pressure, float), np.asarray(max_contraction, float)
        if P.ndim != 1 or P.shape != eps.shape or P.size < 1:
            raise InvalidInput(f"pressure and max_contraction need one shape (n,), got {P.shape} and {eps.shape}")
        if np.unique(eps).size < eps.size or not (eps > 0).all():
            raise InvalidInput(f"max_contraction = {eps} has to be positive and all different")
        a, b = braid_constants(alpha0)
        powers = eps[:, None] ** np.arange(1, eps.size + 1)  # (n, n)
        return cls(r0, alpha0, tuple(np.linalg.solve(powers, (a - b) * P)))  # (15)

    @property
    def limitation(self) -> str:
        """[M] fails everywhere, by equality."""
        return "F_Pε = 0 everywhere: stiffness does not depend on pressure and cannot be commanded"

    def A(self, eps: Value) -> Value:
        """Return A(ε) = S (a-b)   (13)"""
        return self.S * (self.a - self.b) + 0.0 * eps

    def B(self, eps: Value) -> Value:
        """Return B(ε) = -S ε (a0 + a1 ε + …)   (14)"""
        counter = 0.0 * eps
        for a_i in reversed(self.coefficients):
            counter = (counter + a_i) * eps
        return -self.S * counter

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A = S (a-b) ε"""
        return self.S * (self.a - self.b) * eps

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe of three coefficients, which the report found best; pass `start` for another number."""
        start = cls(0.01, 25 * DEG, (10 * BAR, 0.0, 0.0))
        return Recipe((start,), ("coefficients",), bounds={"r0": (1e-4, 0.5), "alpha0": (5 * DEG, 54 * DEG)})
