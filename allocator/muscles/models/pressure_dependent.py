"""McKibben muscles whose greatest contraction depends on the pressure."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Mask, Value, exp, increasing_root
from allocator.errors import InvalidInput
from allocator.muscles.base import SEARCH_CEILING
from allocator.muscles.basis import Basis
from allocator.muscles.measured import continued, continued_integral
from allocator.muscles.models.mckibben import BRAID, Braided
from allocator.muscles.recipe import Recipe
from allocator.units import BAR, DEG


@dataclass(frozen=True)
class PressureDependent(Braided):
    """The force is F = S q P [a(1 - k(P)ε)² - b], k(P) = k_inf + k_1 e^{-P/P_k}. Not a law by itself.

    The papers read k(P) = (1-√(b/a))/ε_max(P) off measured curves and give no formula. Here it falls exponentially to
    k_inf: three numbers follow the readings of Festo muscles, k_1 = 0 is a constant k, and the formula is analytic.
    For k_1 ≥ 0 [M] holds on the taut region while P k(P) rises, that is everywhere if k_1 ≤ e² k_inf. Domain:
    0 ≤ ε ≤ ε_max(P); the formula turns positive again beyond k(P) ε = 1, where it means nothing.
    """

    k_inf: float  # k at high pressure [-]
    k_1: float  # how much greater k is at zero pressure [-]
    P_k: float  # pressure over which k falls [Pa]

    def __post_init__(self) -> None:
        """Refuse a k(P) that blows up, changes its sign or rises."""
        super().__post_init__()
        if not (self.k_inf > 0 and self.k_1 >= 0 and self.P_k > 0):
            raise InvalidInput(
                f"{type(self).__name__} needs k_inf > 0, k_1 >= 0 and P_k > 0 Pa; got k_inf = {self.k_inf:g}, "
                f"k_1 = {self.k_1:g}, P_k = {self.P_k:g} Pa"
            )

    @property
    @abstractmethod
    def efficiency(self) -> Value:
        """Share q of the ideal force that is left [-]."""

    @property
    def max_contraction(self) -> float:
        """ε_max at infinite pressure, (1-√(b/a))/k_inf [-]."""
        return float((1 - sqrt(self.b / self.a)) / self.k_inf)

    def k(self, P: Value) -> Value:
        """Return k(P) = k_inf + k_1 e^{-P/P_k} [-]."""
        return self.k_inf + self.k_1 * exp(-P / self.P_k)

    def contraction_limit(self, P: Value) -> Value:
        """Return the contraction ratio ε_max(P) = (1-√(b/a))/k(P) at which the force is zero [-]."""
        return (1 - sqrt(self.b / self.a)) / self.k(P)

    def covers(self, P: Array, eps: Array) -> Mask:
        """Return whether k(P) ε is below 1, where the parabola turns."""
        return np.asarray(super().covers(P, eps) & (self.k(P) * eps <= 1))

    @property
    def basis(self) -> Basis:
        """Basis functions P, P E and P E², E = e^{-P/P_k}; P alone where k is constant."""
        return Basis("exponential", shape=self.P_k) if self.k_1 else Basis("quadratic")

    def law(self, P: Value, eps: Value) -> Value:
        """Return F = S q P [a(1 - k(P)ε)² - b]   (11), (12), beyond the measured range by (R1)"""
        return continued(lambda e: self._force(P, e), eps, self.edges)

    def _force(self, P: Value, eps: Value) -> Value:
        return self.efficiency * self.S * P * (self.a * (1 - self.k(P) * eps) ** 2 - self.b)

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P = S q [a(1-kε)² - b - 2a(1-kε) ε P k'(P)]"""
        return continued(lambda e: self._gain(P, e), eps, self.edges)

    def _gain(self, P: Value, eps: Value) -> Value:
        short, fall = 1 - self.k(P) * eps, self._k_slope(P)
        return self.efficiency * self.S * (self.a * short**2 - self.b - 2 * self.a * short * eps * P * fall)

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return ∫_0^ε F_P = S q [a(ε - kε² + k²ε³/3) - bε - a P k'(P) (ε² - 2kε³/3)]"""
        formulas = (lambda e: self._gain(P, e)), (lambda e: self._gain_integral(P, e))
        return continued_integral(*formulas, eps, self.edges)

    def _gain_integral(self, P: Value, eps: Value) -> Value:
        k, fall = self.k(P), self._k_slope(P)
        steady = self.a * (eps - k * eps**2 + k**2 * eps**3 / 3) - self.b * eps
        return self.efficiency * self.S * (steady - self.a * P * fall * (eps**2 - 2 * k * eps**3 / 3))

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return its derivative by P, S q a [-(2k' + P k'')(ε² - 2kε³/3) + 2 P k'² ε³/3]; (R1) is linear in F."""
        formulas = (lambda e: self._gain_slope(P, e)), (lambda e: self._gain_integral_slope(P, e))
        return continued_integral(*formulas, eps, self.edges)

    def _gain_slope(self, P: Value, eps: Value) -> Value:
        """Return ∂²F/∂P² = -2 S q a ε [(1 - kε)(2k' + P k'') - ε P k'²]"""
        fall, bend = self._k_slope(P), self._bend(P)
        bent = (1 - self.k(P) * eps) * bend - eps * P * fall**2
        return -2 * self.efficiency * self.S * self.a * eps * bent

    def _gain_integral_slope(self, P: Value, eps: Value) -> Value:
        k, fall, bend = self.k(P), self._k_slope(P), self._bend(P)
        bent = bend * (eps**2 - 2 * k * eps**3 / 3)
        return self.efficiency * self.S * self.a * (2 * P * fall**2 * eps**3 / 3 - bent)

    def _bend(self, P: Value) -> Value:
        """Return 2k' + P k'' with k'' = -k'/P_k."""
        return (2 - P / self.P_k) * self._k_slope(P)

    def _k_slope(self, P: Value) -> Value:
        return -self.k_1 / self.P_k * exp(-P / self.P_k)

    def taut_pressure(self, eps: Value) -> Array:
        """Return the pressure [Pa] from which on the muscle pulls at `eps`: ε_max(P) = ε; inf if it never does."""
        eps = np.asarray(eps, float)
        k = (1 - sqrt(self.b / self.a)) / np.maximum(eps, 1e-9)  # k(P) has to fall to this
        return np.asarray(np.maximum(self._pressure_for_k(k), 0.0))

    def _pressure_for_k(self, k: Array) -> Array:
        """Return where k(P) falls to `k` [Pa]: -inf where it always is below, inf where it never is."""
        if self.k_1 == 0:
            return np.where(k >= self.k_inf, -np.inf, np.inf)
        rest = np.maximum(k - self.k_inf, 1e-300) / self.k_1
        return np.where(k <= self.k_inf, np.inf, -self.P_k * np.log(rest))

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return the pressure [Pa] at which the force, rising with it, is `F`.

        It is ∓inf where F is below or above all such forces.

        Below `taut_pressure` the law first falls and then rises to zero; the rising part alone is searched.
        """
        F, eps = np.broadcast_arrays(np.asarray(F, float), np.asarray(eps, float))
        if self.edges is None:
            return self._pressure(F, eps)
        within = (eps >= self.edges[0]) & (eps <= self.edges[1])
        return np.where(within, self._pressure(F, eps), self._last_rise(F, eps))

    def _last_rise(self, F: Array, eps: Array) -> Array:
        """Return the greatest pressure [Pa] through which the continued law rises to `F`; ∓inf as `pressure`."""
        grid = np.linspace(0.0, SEARCH_CEILING, _GRID).reshape(-1, *[1] * eps.ndim)
        below = self.law(grid, eps) < F
        last = _GRID - 1 - below[::-1].argmax(axis=0)  # the last pressure with too small a force
        lo, hi = (np.take_along_axis(grid, np.minimum(i, _GRID - 1)[None], 0)[0] for i in (last, last + 1))
        P = increasing_root(lambda P, F, e: self.law(P, e) - F, lo, hi, F, eps)
        never = np.where(np.isnan(F + eps), np.nan, -np.inf)
        return np.where(below.any(axis=0), np.where(below[-1], np.inf, P), never)

    def _pressure(self, F: Array, eps: Array) -> Array:
        taut = self.taut_pressure(eps)
        reached = taut < SEARCH_CEILING
        if not F.any():
            return np.where(np.isnan(F + eps), np.nan, np.where(reached, taut, np.inf))
        top = np.where(reached, taut, 0.0)
        bottom = np.maximum(top - 2 * self.P_k, self._pressure_for_k(1 / np.maximum(eps, 1e-9)))
        turn = increasing_root(lambda P, e: self.gain(P, e), bottom, top, eps)
        start = np.where(np.isfinite(turn), turn, bottom)
        P = increasing_root(lambda P, F, e: self.law(P, e) - F, start, np.asarray(SEARCH_CEILING), F, eps)
        return np.where(np.isnan(F + eps), np.nan, np.where(reached, np.where(F == 0, taut, P), np.inf))

    @classmethod
    def _recipe(cls, *more: float) -> Recipe[Self]:
        starts = tuple(cls(0.01, 25 * DEG, k_inf, k_1, P_k, *more) for k_inf, k_1, P_k in _STARTS)
        bounds = {
            "r0": (1e-4, 0.5),
            "alpha0": (5 * DEG, 54 * DEG),
            "k_inf": (0.2, 10.0),
            "k_1": (0.0, 50.0),
            "P_k": (0.05 * BAR, 20 * BAR),
        }
        return Recipe(starts, bounds=bounds)


_GRID = 401  # pressures, 0.05 bar apart, between which the continued law is taken to rise or fall
_STARTS = ((1.2, 0.5, 1 * BAR), (1.5, 2.0, 1 * BAR), (1.0, 2.0, 2 * BAR), (1.2, 0.1, 3 * BAR))


@dataclass(frozen=True)
class TonduLopez2000(PressureDependent):
    """The force is F = S P [a(1 - k(P)ε)² - b], k(P) = (1-√(b/a))/ε_max(P)   (11)

    B. Tondu and P. Lopez, "Modeling and control of McKibben artificial muscle robot actuators", IEEE Control Systems
    Magazine 20(2):15-38, 2000; Tondu 2021, equation (11). k(P) as in `PressureDependent`. k_1 = 0, k_inf = 1 is
    TonduLopez1995. Parameters: r0 [m], α0 [rad], k_inf [-], k_1 [-], P_k [Pa].
    """

    citation = "Tondu & Lopez, IEEE Control Systems Magazine 20(2):15-38, 2000"
    strength: ClassVar[Mapping[str, float]] = BRAID

    @property
    def efficiency(self) -> Value:
        """1: nothing is lost."""
        return 1.0

    @classmethod
    def with_constant_k(cls, r0: float, alpha0: float, k: float) -> Self:
        """Return the model with the same k at every pressure, as for the LAAS arm."""
        return cls(r0, alpha0, k_inf=k, k_1=0.0, P_k=BAR)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Search all five from a few falls of k(P)."""
        return cls._recipe()


@dataclass(frozen=True)
class Andrikopoulos2016(PressureDependent):
    """The force is F = S q P [a(1 - k(P)ε)² - b], q ∈ (0, 1]   (12)

    G. Andrikopoulos, G. Nikolakopoulos and S. Manesis, "Novel considerations on static force modeling of pneumatic
    muscle actuators", IEEE/ASME Trans. Mechatronics 21, 2016; Tondu 2021, equation (12). q = 1 is TonduLopez2000. The
    value of q was not found in print: fit it. Only r0² q is visible in forces, so hold r0 (measured) to learn q.
    """

    citation = "Andrikopoulos, Nikolakopoulos & Manesis, IEEE/ASME Trans. Mechatronics 21:2647-2659, 2016"
    strength: ClassVar[Mapping[str, float]] = BRAID

    q: float  # share of the ideal force that is left [-]

    def __post_init__(self) -> None:
        """Check q."""
        super().__post_init__()
        if not 0 < self.q <= 1:
            raise InvalidInput(f"Andrikopoulos2016: q = {self.q:g} has to lie in (0, 1]")

    @property
    def efficiency(self) -> Value:
        """q   (12)"""
        return self.q

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Search all six; q and r0 are collinear unless one is held."""
        search = cls._recipe(0.8)
        return Recipe(search.starts, bounds={**search.bounds, "q": (0.01, 1.0)})
