"""Ideal McKibben muscle, described by the geometry of its braid, also with a polynomial counter-force."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi, sqrt
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value, cos, sin
from allocator.errors import InvalidInput
from allocator.muscles.base import AffineMuscle, Muscle
from allocator.muscles.recipe import Recipe
from allocator.units import BAR, DEG

BRAID: Mapping[str, float] = {"r0": 0.5}
"""`Muscle.strength` of braided muscles: S = π r0² stands before everything."""


def braid_constants(alpha0: float) -> tuple[float, float]:
    """Return a = 3/tan²α0 and b = 1/sin²α0 of a braid with the initial angle `alpha0` [rad]   (7)"""
    return 3 * (cos(alpha0) / sin(alpha0)) ** 2, 1 / sin(alpha0) ** 2


@dataclass(frozen=True)
class Braided(Muscle):
    """A braided muscle is described by its braid: radius r0 and braid angle α0 at rest. Not a law by itself."""

    r0: float  # initial radius [m]
    alpha0: float  # initial braid angle [rad]

    def __post_init__(self) -> None:
        """Check the braid."""
        super().__post_init__()
        if not 0 < self.r0 < 1:
            raise InvalidInput(f"{type(self).__name__}: r0 = {self.r0:g} m is not a muscle's radius")
        if not 0 < self.alpha0 < pi / 2:
            raise InvalidInput(
                f"{type(self).__name__}: alpha0 = {self.alpha0:g} rad is not between 0 and π/2; degrees?"
            )

    # computed once: a copy with other parameters (numbers or CasADi symbols) has constants of its own

    @cached_property
    def S(self) -> float:
        """Initial cross-section S = π r0² [m²]."""
        return pi * self.r0**2

    @property
    def own_radius(self) -> Value:
        """r0 [m]."""
        return self.r0

    @cached_property
    def _constants(self) -> tuple[float, float]:
        return braid_constants(self.alpha0)

    @cached_property
    def a(self) -> float:
        """= 3/tan²α0 [-]   (7)"""
        return self._constants[0]

    @cached_property
    def b(self) -> float:
        """b = 1/sin²α0 [-]   (7)"""
        return self._constants[1]


@dataclass(frozen=True)
class TonduLopez1995(Braided, AffineMuscle):
    """The ideal (cylindrical, frictionless) McKibben muscle pulls with F = S P [a(1-ε)² - b]   (7)

    B. Tondu and P. Lopez, "Theory of an artificial pneumatic muscle …", C. R. Acad. Sci. IIb 320, 1995; Tondu 2021,
    equation (7). Domain: 0 ≤ ε ≤ ε_max = 1 - √(b/a), whatever the pressure.
    """

    citation = "Tondu & Lopez, C. R. Acad. Sci. Paris IIb 320:105-114, 1995"
    strength: ClassVar[Mapping[str, float]] = BRAID

    @property
    def max_contraction(self) -> float:
        """ε_max = 1 - √(b/a) [-]   (7)"""
        return 1 - sqrt(self.b / self.a)

    def A(self, eps: Value) -> Value:
        """Return A(ε) = S [a(1-ε)² - b]   (7)"""
        return self.S * (self.a * (1 - eps) ** 2 - self.b)

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A = S [a (1 - (1-ε)³)/3 - b ε]: V_0 + L times this is the textbook volume of the braid."""
        return self.S * (self.a * (eps - eps**2 + eps**3 / 3) - self.b * eps)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Search the braid from that of a muscle of ordinary size."""
        return Recipe((cls(0.01, 25 * DEG),), bounds={"r0": (1e-4, 0.5), "alpha0": (5 * DEG, 54 * DEG)})


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
