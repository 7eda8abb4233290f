"""Padé force law shared by several kinds of artificial muscle."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value, log
from allocator.errors import InvalidInput
from allocator.muscles.base import AffineMuscle
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class KazemipourKatzschmann2025(AffineMuscle):
    """The force is F = u (c0 + c1 ε + c2 ε²)/(1 + d1 ε),  u = P/P_max

    A. Kazemipour and R. Katzschmann, arXiv 2511.09104, 2025 (not in the report). The same law serves electrohydraulic
    and dielectric muscles with u = (V/V_max)²: write V² for P and V_max² for P_max. The coefficients depend on the
    muscle: fit them; P_max only sets a scale and is held at the highest pressure of the data. All isobars meet in
    one ε_max. [M] holds where the fraction is positive and falls. Domain: 1 + d1 ε > 0.
    """

    citation = "Kazemipour & Katzschmann, arXiv 2511.09104, 2025"
    strength: ClassVar[Mapping[str, float]] = dict.fromkeys(("c0", "c1", "c2"), 1.0)

    c0: float  # force at u = 1 without contraction [N]
    c1: float  # [N]
    c2: float  # [N]
    d1: float  # [-]
    P_max: float  # pressure that stands for full activation [Pa]

    def __post_init__(self) -> None:
        """Check the scale."""
        super().__post_init__()
        if not self.P_max > 0:
            raise InvalidInput(f"KazemipourKatzschmann2025: P_max = {self.P_max:g} Pa has to be positive")

    @property
    def min_contraction(self) -> float:
        """Where the denominator vanishes, if that is on the stretched side [-]."""
        return -1 / self.d1 if self.d1 > 0 else -np.inf

    def A(self, eps: Value) -> Value:
        """Return A(ε) = (c0 + c1 ε + c2 ε²)/(1 + d1 ε)/P_max"""
        return (self.c0 + (self.c1 + self.c2 * eps) * eps) / (1 + self.d1 * eps) / self.P_max

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A by partial fractions; by quadrature where d1 is small and their differences cancel."""
        if abs(self.d1) < _CANCELS:
            return super().A_integral(eps)
        zeroth = log(1 + self.d1 * eps) / self.d1  # ∫ dε/(1 + d1 ε)
        first = (eps - zeroth) / self.d1
        second = (eps**2 / 2 - first) / self.d1
        return (self.c0 * zeroth + self.c1 * first + self.c2 * second) / self.P_max

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe linear but for d1, whose pole is kept out of the data."""
        P_max = float(np.max(pressure))
        starts = tuple(cls(0.0, 0.0, 0.0, d1, P_max) for d1 in (2.0, 20.0))
        most, least = max(float(np.max(contraction)), 0.01), min(float(np.min(contraction)), 0.0)
        pole = 0.9 / -least if least < 0 else 1e3
        bounds = {"d1": (-0.9 / most, min(pole, 1e3))}
        return Recipe(starts, ("c0", "c1", "c2"), ("P_max",), bounds)


_CANCELS = 1.0
