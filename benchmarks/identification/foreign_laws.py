"""Force laws of braided muscles that are not in the catalogue, as truths for benchmarks of identification.

Each is built from a published effect that is absent from the laws of `allocator.muscles` in this form:

| law | F(P, ε) |
|---|---|
| `ThresholdMuscle` | (P - P_t (1 - e^(-P/P_t))) A(ε) - rubber: the bladder touches the braid above P_t |
| `PowerMuscle` | P A0 (1 - ε/ε_m)^n with ε_m growing with the pressure: a convex fall that ends at a point |
| `EndCapMuscle` | P A((1 + k(P)) ε) - c (e^(κ ε) - 1), conical ends that vanish with the pressure, stiffening rubber |
| `SaturatingMuscle` | P/(1 + P/P_s) A(ε) + B0 - B1 ε + B3 ε³: braid that stretches, cubic rubber |

A(ε) = π r² (a (1 - ε)² - b), a = 3/tan²α, b = 1/sin²α (Chou and Hannaford 1996).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from allocator.calculus import Value
from allocator.muscles import Muscle
from allocator.units import BAR


def _exp(x: Value) -> Value:
    return np.exp(x)


@dataclass(frozen=True)
class ForeignMuscle(Muscle):
    """Muscle with a braid of known radius and angle."""

    citation: ClassVar[str] = "for benchmarks only"
    strength: ClassVar[Mapping[str, float]] = {"radius": 0.5, "rubber": 1.0, "offset": 1.0}
    radius: float  # at rest [m]
    angle: float  # of the braid at rest [rad]

    def area(self, eps: Value) -> Value:
        """Return A(ε) [m²]."""
        a, b = 3 / np.tan(self.angle) ** 2, 1 / np.sin(self.angle) ** 2
        return np.pi * self.radius**2 * (a * (1 - eps) ** 2 - b)


@dataclass(frozen=True)
class ThresholdMuscle(ForeignMuscle):
    """Home-made muscle with a gap between bladder and braid."""

    threshold: float  # P_t [Pa]
    rubber: float  # [N] per contraction

    def law(self, P: Value, eps: Value) -> Value:
        """Return F [N]."""
        acting = P - self.threshold * (1 - _exp(-P / self.threshold))
        return acting * self.area(eps) - self.rubber * eps

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P [N/Pa]."""
        return (1 - _exp(-P / self.threshold)) * self.area(eps)


@dataclass(frozen=True)
class PowerMuscle(ForeignMuscle):
    """Muscle with a force that falls to zero as a power of the remaining contraction."""

    longest: float  # ε_m at high pressure [-]
    power: float  # n [-]

    def law(self, P: Value, eps: Value) -> Value:
        """Return F [N]."""
        left, _ = self._left(P, eps)
        return P * self.area(0.0) * _exp(self.power * np.log(left))

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P [N/Pa]."""
        left, slope = self._left(P, eps)
        return self.area(0.0) * _exp(self.power * np.log(left)) * (1 + P * self.power * slope / left)

    def _left(self, P: Value, eps: Value) -> tuple[Value, Value]:
        """Return 1 - ε/ε_m(P), and its derivative in P [1/Pa]."""
        early = 0.25 * _exp(-P / (2 * BAR))
        most = self.longest * (1 - early)
        return 1 - eps / most, eps / most**2 * self.longest * early / (2 * BAR)


@dataclass(frozen=True)
class EndCapMuscle(ForeignMuscle):
    """Muscle with conical ends and rubber that stiffens exponentially."""

    ends: float  # k at low pressure [-]
    rubber: float  # c [N]
    stiffening: float  # κ [-]

    def law(self, P: Value, eps: Value) -> Value:
        """Return F [N]."""
        k = self.ends * _exp(-P / (1.5 * BAR))
        return P * self.area((1 + k) * eps) - self.rubber * (_exp(self.stiffening * eps) - 1)

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P [N/Pa]."""
        k = self.ends * _exp(-P / (1.5 * BAR))
        a = 3 / np.tan(self.angle) ** 2
        slope = -2 * a * np.pi * self.radius**2 * (1 - (1 + k) * eps)  # A'
        return self.area((1 + k) * eps) - P * slope * eps * k / (1.5 * BAR)


@dataclass(frozen=True)
class SaturatingMuscle(ForeignMuscle):
    """Muscle with a braid that stretches under pressure, and cubic rubber."""

    saturation: float  # P_s [Pa]
    offset: float  # B0 [N]
    rubber: float  # B1 [N]

    def law(self, P: Value, eps: Value) -> Value:
        """Return F [N]."""
        passive = self.offset - self.rubber * eps + 8 * self.rubber * eps**3
        return P / (1 + P / self.saturation) * self.area(eps) + passive

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P [N/Pa]."""
        return self.area(eps) / (1 + P / self.saturation) ** 2


def drawn(rng: np.random.Generator) -> Muscle:
    """Return a random muscle that pulls with about 0.4 to 1.2 kN at 5 bar and ε = 0.05."""
    shape = {"radius": rng.uniform(0.006, 0.010), "angle": np.radians(rng.uniform(20, 28))}
    makers: tuple[Callable[[], Muscle], ...] = (
        lambda: ThresholdMuscle(**shape, threshold=rng.uniform(0.1, 0.5) * BAR, rubber=rng.uniform(0, 600)),
        lambda: PowerMuscle(**shape, longest=rng.uniform(0.26, 0.34), power=rng.uniform(1.1, 1.8)),
        lambda: EndCapMuscle(
            **shape, ends=rng.uniform(0.1, 0.6), rubber=rng.uniform(5, 30), stiffening=rng.uniform(6, 12)
        ),
        lambda: SaturatingMuscle(
            **shape, saturation=rng.uniform(10, 30) * BAR, offset=rng.uniform(0, 60), rubber=rng.uniform(100, 800)
        ),
    )
    return makers[int(rng.integers(len(makers)))]()
