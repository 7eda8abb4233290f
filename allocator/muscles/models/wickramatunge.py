"""Muscle as a spring whose stiffness depends on pressure and stretch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Value, is_symbol
from allocator.errors import InvalidInput
from allocator.muscles.base import Muscle
from allocator.muscles.basis import Basis
from allocator.muscles.measured import continued, continued_integral
from allocator.muscles.recipe import Recipe
from allocator.units import BAR


@dataclass(frozen=True)
class Wickramatunge2010(Muscle):
    """The force is F = K_M ls, K_M = c3 P² + c2 P ls + c1 ls² + c0, ls = l - l_min   (20)

    K. C. Wickramatunge and T. Leephakpreeda, "Study on mechanical behaviors of pneumatic artificial muscle", Int. J.
    Engineering Science 48:188-198, 2010; Tondu 2021, equation (20). Coefficients were not found in print for a muscle
    of this package: fit them.

    The paper fits (20) twice, below and above 2.5 bar, and says that the sets differ "especially in the term in P²";
    the force then jumps where they meet. Here the two ranges have their own c3, share c2 and c1, and c0 of the upper
    range follows from continuity, c0 + (c3_low - c3_high) P_switch²: the force has no jump at any contraction, only
    ∂F/∂P has one, of 2 (c3_high - c3_low) P_switch ls. (On the measured map of a DMSP-20-300 this costs 34 instead of
    31 N RMS over the taut samples, and spares jumps of -16 to +49 N.) Not affine in the pressure, but quadratic:
    `pressure` is in closed form. [M] holds where 2 c3 P + c2 ls > 0 and c3 P + c2 ls > 0. Domain: ls ≥ 0.
    """

    citation = "Wickramatunge & Leephakpreeda, Int. J. Engineering Science 48:188-198, 2010"
    strength: ClassVar[Mapping[str, float]] = dict.fromkeys(("c0", "c1", "c2", "c3_low", "c3_high"), 1.0)

    rest_length: float  # l0 [m]
    min_length: float  # l_min, at which no pressure gives a force [m]
    c0: float  # [N/m], of the lower range
    c1: float  # [N/m³]
    c2: float  # [N/(Pa·m²)]
    c3_low: float  # below P_switch [N/(Pa²·m)]
    c3_high: float  # above P_switch [N/(Pa²·m)]
    P_switch: float  # where the ranges meet, 2.5 bar in the paper [Pa]

    def __post_init__(self) -> None:
        """Check the lengths."""
        super().__post_init__()
        if not 0 < self.min_length < self.rest_length:
            raise InvalidInput(
                f"Wickramatunge2010 needs 0 < min_length < rest_length; got min_length = {self.min_length:g} m, "
                f"rest_length = {self.rest_length:g} m"
            )

    @property
    def max_contraction(self) -> float:
        """Contraction 1 - l_min/l0 [-] where the stretched length vanishes."""
        return 1 - self.min_length / self.rest_length

    def stretched_length(self, eps: Value) -> Value:
        """Return ls = l0(1-ε) - l_min [m]   (20)"""
        return self.rest_length * (1 - eps) - self.min_length

    @property
    def basis(self) -> Basis:
        """Basis functions: quadratics below and above P_switch."""
        return Basis("quadratic", kinks=(self.P_switch,))

    def law(self, P: Value, eps: Value) -> Value:
        """Return F = (c3 P² + c2 P ls + c1 ls² + c0) ls   (20), continuous at P_switch, continued by (R1)"""
        return continued(lambda e: self._force(P, e), eps, self.edges)

    def _force(self, P: Value, eps: Value) -> Value:
        ls = self.stretched_length(eps)
        quadratic = self._low(P) * self.c3_low + self._high(P) * self.c3_high
        return (quadratic + self.c2 * P * ls + self.c1 * ls**2 + self.c0) * ls

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P = (2 c3 P + c2 ls) ls"""
        return continued(lambda e: self._gain(P, e), eps, self.edges)

    def _gain(self, P: Value, eps: Value) -> Value:
        ls = self.stretched_length(eps)
        return (2 * self._c3(P) * P + self.c2 * ls) * ls

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return ∫_0^ε F_P = 2 c3 P ∫ls + c2 ∫ls²; it jumps at P_switch as F_P does."""
        formulas = (lambda e: self._gain(P, e)), (lambda e: self._gain_integral(P, e))
        return continued_integral(*formulas, eps, self.edges)

    def _gain_integral(self, P: Value, eps: Value) -> Value:
        once, square = self._length_integrals(eps)
        return 2 * self._c3(P) * P * once + self.c2 * square

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return its derivative by P, 2 c3 ∫ls, of which (R1) changes nothing: ls is linear."""
        return 2 * self._c3(P) * self._length_integrals(eps)[0]

    def _length_integrals(self, eps: Value) -> tuple[Value, Value]:
        """Return ∫_0^ε ls dε' [m] and ∫_0^ε ls² dε' [m²]."""
        start, l0 = self.rest_length - self.min_length, self.rest_length
        return (start - l0 * eps / 2) * eps, (start**2 - start * l0 * eps + l0**2 * eps**2 / 3) * eps

    def _c3(self, P: Value) -> Value:
        return _choose(P, self.P_switch, self.c3_low, self.c3_high)

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return the rising root of the quadratic (20) in the range that F falls into.

        It is inf where c3 < 0 and F is out of reach.
        """
        F, eps = np.broadcast_arrays(np.asarray(F, float), np.asarray(eps, float))
        if self.edges is None:
            return self._root(F, eps)
        within = (eps >= self.edges[0]) & (eps <= self.edges[1])
        return np.where(within, self._root(F, eps), super().pressure(F, eps))

    def _root(self, F: Array, eps: Array) -> Array:
        ls = self.stretched_length(eps)
        high = self.law(self.P_switch, eps) < F
        c3 = np.where(high, self.c3_high, self.c3_low)
        c0 = self.c0 + np.where(high, (self.c3_low - self.c3_high) * self.P_switch**2, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            q1, q0 = self.c2 * ls, self.c1 * ls**2 + c0 - F / ls
            root = np.sqrt(q1**2 - 4 * c3 * q0)
            P = np.where(q1 > 0, -2 * q0 / (q1 + root), (root - q1) / (2 * c3))  # without cancellation
        beyond = np.isnan(P) & ~np.isnan(F + eps)
        return np.where(beyond, np.where(c3 < 0, np.inf, -np.inf), P)

    def _low(self, P: Value) -> Value:
        """Return the part of P² below P_switch."""
        return _choose(P, self.P_switch, P**2, self.P_switch**2)

    def _high(self, P: Value) -> Value:
        """Return the part of P² above P_switch."""
        return P**2 - self._low(P)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe linear but for l_min; the rest length only scales, 2.5 bar is the paper's."""
        most = min(max(float(np.max(contraction)), 0.05), 0.6)
        starts = tuple(
            cls(0.3, 0.3 * (1 - reach), 0.0, 0.0, 0.0, 0.0, 0.0, 2.5 * BAR) for reach in (most + 0.02, most + 0.15)
        )
        linear = ("c0", "c1", "c2", "c3_low", "c3_high")
        bounds = {"min_length": (0.01, 0.3 * (1 - most * 0.9))}
        return Recipe(starts, linear, ("rest_length", "P_switch"), bounds)


def _choose(P: Value, switch: Value, below: Value, above: Value) -> Value:
    if is_symbol(P):
        import casadi

        return casadi.if_else(P < switch, below, above)
    value = np.asarray(np.where(np.real(P) < np.real(switch), below, above))
    return value if value.ndim else value.item()
