"""Energy-based model of a Festo muscle with a measured rubber law."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import ClassVar, Self

from allocator.calculus import Array, Value, cos, sin, sqrt
from allocator.errors import InvalidInput
from allocator.muscles.base import AffineMuscle
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class MartensBoblan2017(AffineMuscle):
    """The force is F = -P dV/dL + F_pe dD/dL - F_l: work of the gas, and of the rubber in circumference and length

    M. Martens and I. Boblan, "Modeling the static force of a Festo pneumatic muscle actuator: a new approach and a
    comparison to existing models", Actuators 6(4):33, 2017, with the erratum 7(1):9, 2018. With L = L0(1-ε):

        Lf = L0/cos θ0,  n = L0 tan θ0/(π D0),  D = √(Lf² - L²)/(nπ)
        dV/dL = (Lf² - 3L²)/(4π n²),  dD/dL = -L/(nπ √(Lf² - L²))
        E(L) = c3 L³ + c2 L² + c1 L + c0 [Pa]
        F_l = E (L-L0)/L0 · H0 π D,   F_pe = E (D-D0)/D0 · H0 π L

    Domain: 0–6 bar, ε ≤ 0.26. Forces show H0 E(L) only, and no length alone: L0 and H0 are held when fitting.
    """

    citation = "Martens & Boblan, Actuators 6(4):33, 2017; erratum 7(1):9, 2018"
    assumed_contraction: ClassVar[float] = 0.26  # of the shortest length measured
    strength: ClassVar[Mapping[str, float]] = dict.fromkeys(("D0", "c0", "c1", "c2", "c3"), 0.5)  # A ~ D0², B ~ D0 E

    L0: float  # rest length [m]
    D0: float  # diameter at rest [m]
    H0: float  # thickness of the wall [m]
    theta0: float  # fibre angle at rest, from the axis [rad]
    c0: float  # [Pa]
    c1: float  # [Pa/m]
    c2: float  # [Pa/m²]
    c3: float  # [Pa/m³]

    def __post_init__(self) -> None:
        """Check the geometry."""
        super().__post_init__()
        if not (self.L0 > 0 and self.D0 > 0 and self.H0 > 0 and 0 < self.theta0 < pi / 2):
            raise InvalidInput(
                f"MartensBoblan2017 needs positive L0, D0, H0 [m] and theta0 between 0 and π/2 rad; got "
                f"{self.L0:g}, {self.D0:g}, {self.H0:g} and {self.theta0:g}"
            )

    @cached_property
    def fibre_length(self) -> Value:
        """Lf = L0/cos θ0 [m]."""
        return self.L0 / cos(self.theta0)

    @cached_property
    def turns(self) -> Value:
        """n = L0 tan θ0/(π D0), turns of a fibre [-]."""
        return self.L0 * sin(self.theta0) / cos(self.theta0) / (pi * self.D0)

    def A(self, eps: Value) -> Value:
        """Return A(ε) = -dV/dL = (3L² - Lf²)/(4π n²) [m²]"""
        L = self.L0 * (1 - eps)
        return (3 * L**2 - self.fibre_length**2) / (4 * pi * self.turns**2)

    def B(self, eps: Value) -> Value:
        """Return B(ε) = F_pe dD/dL - F_l [N]"""
        L, n = self.L0 * (1 - eps), self.turns
        width = sqrt(self.fibre_length**2 - L**2)  # of a fibre unrolled
        D = width / (n * pi)
        E = self.c0 + (self.c1 + (self.c2 + self.c3 * L) * L) * L
        F_pe = E * (D - self.D0) / self.D0 * self.H0 * pi * L
        F_l = E * (L - self.L0) / self.L0 * self.H0 * pi * D
        return -F_pe * L / (n * pi * width) - F_l

    @property
    def own_radius(self) -> Value:
        """D0/2 [m]."""
        return self.D0 / 2

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A = [V(L) - V(L0)]/L0 with V = L (Lf² - L²)/(4π n²), the cylinder's volume"""
        L, Lf = self.L0 * (1 - eps), self.fibre_length
        return (L * (Lf**2 - L**2) - self.L0 * (Lf**2 - self.L0**2)) / (4 * pi * self.turns**2 * self.L0)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe linear in the rubber law; the geometry is searched from the published one."""
        start = cls(0.300, 0.020, 0.0018, 0.42, 0.0, 0.0, 0.0, 0.0)
        bounds = {"D0": (1e-3, 0.5), "theta0": (0.1, 0.9)}
        return Recipe((start,), ("c0", "c1", "c2", "c3"), ("L0", "H0"), bounds)
