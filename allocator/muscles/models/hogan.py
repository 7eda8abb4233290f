"""Hogan's simplified skeletal muscle pulls in proportion to its activation and to the contraction that is left."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value
from allocator.muscles.base import AffineMuscle
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class Hogan1984(AffineMuscle):
    """The force is F = u F_max (1 - ε/ε_max), u = P/P_max ∈ [0, 1]   (1)

    N. Hogan, "Adaptive Control of Mechanical Impedance by Coactivation of Antagonist Muscles", IEEE Trans. Automatic
    Control 29(8), 1984; Tondu 2021, equation (1). Domain: 0 ≤ ε ≤ ε_max, 0 ≤ P ≤ P_max.
    """

    citation = "Hogan, IEEE Trans. Automatic Control 29(8):681-690, 1984"
    strength: ClassVar[Mapping[str, float]] = {"F_max": 1.0}

    F_max: float  # greatest isometric force [N]
    eps_max: float  # contraction ratio without load [-]
    P_max: float  # pressure that stands for full activation [Pa]

    @property
    def max_contraction(self) -> float:
        """Return ε_max [-]."""
        return self.eps_max

    def A(self, eps: Value) -> Value:
        """Return A(ε) = F_max/P_max (1 - ε/ε_max)   (1)"""
        return self.F_max / self.P_max * (1 - eps / self.eps_max)

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A = F_max/P_max (ε - ε²/(2 ε_max))"""
        return self.F_max / self.P_max * (eps - eps**2 / (2 * self.eps_max))

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe linear in F_max; P_max only sets a scale and is held at the highest pressure of the data."""
        start = cls(0.0, 0.25, float(np.max(pressure)))
        return Recipe((start,), ("F_max",), ("P_max",), {"eps_max": (0.01, 1.0)})
