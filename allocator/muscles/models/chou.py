"""McKibben muscle by virtual work, with the thickness of its wall."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import ClassVar, Self

from allocator.calculus import Array, Value, sqrt
from allocator.errors import InvalidInput
from allocator.muscles.base import AffineMuscle
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class ChouHannaford1996(AffineMuscle):
    """The force is F = P π D0²/4 (3cos²θ - 1) + P π [D0 t (2 sin θ - 1/sin θ) - t²],  cos θ = L/b,  D0 = b/(nπ)

    C.-P. Chou and B. Hannaford, "Measurement and modeling of McKibben pneumatic artificial muscles", IEEE Trans.
    Robotics and Automation 12(1):90-102, 1996: virtual work -P dV/dL of the cylinder of length L = L0(1-ε) and outer
    diameter D0 sin θ, inside a wall of constant thickness t; t = 0 is their simple model, the same law as
    TonduLopez1995 with r0 = D0 sin(θ0)/2. The paper's P is absolute minus environment, i.e. gauge, as here. The rest
    length only scales b and n. Domain: 0 ≤ ε ≤ 1 - b/(√3 L0) for t = 0.
    """

    citation = "Chou & Hannaford, IEEE Trans. Robotics and Automation 12(1):90-102, 1996"
    strength: ClassVar[Mapping[str, float]] = {"n": -0.5, "t": 0.5}  # D0 = b/(nπ) and t are the lengths across

    rest_length: float  # L0 [m]
    b: float  # length of a thread [m]
    n: float  # turns of a thread [-]
    t: float  # thickness of the wall [m]

    def __post_init__(self) -> None:
        """Check that the thread is longer than the muscle."""
        super().__post_init__()
        if not (0 < self.rest_length < self.b and self.n > 0 and self.t >= 0):
            raise InvalidInput(
                f"ChouHannaford1996 needs 0 < rest_length < b, n > 0 and t >= 0; got rest_length = "
                f"{self.rest_length:g} m, b = {self.b:g} m, n = {self.n:g}, t = {self.t:g} m"
            )

    @property
    def max_contraction(self) -> float:
        """Contraction 1 - b/(√3 L0) [-] where 3cos²θ = 1."""
        return float(1 - self.b / (3**0.5 * self.rest_length))

    @property
    def min_contraction(self) -> float:
        """1 - b/L0 [-], where the threads are straight."""
        return 1 - self.b / self.rest_length

    @property
    def D0(self) -> Value:
        """Diameter b/(nπ) at θ = 90° [m]."""
        return self.b / (self.n * pi)

    def A(self, eps: Value) -> Value:
        """Return A(ε) = π D0²/4 (3cos²θ - 1) + π [D0 t (2 sin θ - 1/sin θ) - t²]"""
        cosine = self.rest_length * (1 - eps) / self.b
        sine = sqrt(1 - cosine**2)
        wall = self.D0 * self.t * (2 * sine - 1 / sine) - self.t**2
        return pi * (self.D0**2 / 4 * (3 * cosine**2 - 1) + wall)

    @property
    def own_radius(self) -> Value:
        """D0 sin(θ0)/2 [m], outside of the wall less its thickness."""
        return self.D0 * sqrt(1 - (self.rest_length / self.b) ** 2) / 2 - self.t

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A: of the cylinder, c - c³ for cos θ = c, and of the wall, c sin θ, as L0 dε = -b dc."""
        start = self.rest_length / self.b
        end = start * (1 - eps)
        cylinder = self.D0**2 / 4 * ((end - end**3) - (start - start**3))
        wall = self.D0 * self.t * (start * sqrt(1 - start**2) - end * sqrt(1 - end**2))
        return pi * ((cylinder + wall) / start - self.t**2 * eps)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Search b, n and t for a muscle of 0.3 m."""
        starts = (cls(0.3, 0.34, 1.6, 5e-4), cls(0.3, 0.38, 3.0, 1e-4))
        longest = 0.3 * max(1.0, 1.0 - 1.01 * float(contraction.min()))
        return Recipe(starts, (), ("rest_length",), {"b": (longest * 1.002, 0.6), "n": (0.01, 1e3), "t": (0.0, 0.05)})
