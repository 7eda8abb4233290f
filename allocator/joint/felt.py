"""Stiffness of a joint against pushes by ±A: backbone and hysteresis.

The isobaric K is the slope of the backbone. A steady loop of amplitude A [rad] of a stop operator (Maxwell slip,
Prandtl–Ishlinskii) with springs k_i and half widths ρ_i = r_i (s_0 + (1 - s_0) (P1 + P2)/5 bar) adds the secant
stiffness and the work per cycle

    K_h(A) = Σ k_i min(1, ρ_i/A),         W(A) = Σ 4 k_i ρ_i max(A - ρ_i, 0)                                   (S1)

and Dahl's friction T_max z with the presliding δ, whose symmetric loop ends at z = ±tanh(A/δ),

    K_h(A) = T_max tanh(A/δ)/A,           W(A) = 4 T_max (A - δ tanh(A/δ))                                     (S2)

Springs of an elastic operator are shares κ_i of K: k_i = κ_i K. Together

    K_felt(A) = K (isobaric, shut, or at a frequency) + K_h(A; P1, P2)                                         (S3)

The loss factor is the energy lost per radian of the cycle over that stored, η = W/(π K_felt A²).

Work of Dahl's loop: on the branch with s = +1, z = 1 - (1 + z_A) exp(-(θ + A)/δ), z_A = tanh(A/δ), so that
∫ z dθ over a cycle is 2 [2A - δ (1 + z_A)(1 - exp(-2A/δ))] = 4 (A - δ z_A).

Between the pressures P1 + P2 at which a width equals the amplitude, the terms are affine in P1 + P2 (`Region`).
"""

from dataclasses import dataclass
from itertools import pairwise
from math import inf, pi
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask, Value, is_symbol, least, tanh
from allocator.errors import InvalidInput
from allocator.joint.hysteresis import FILLED, PRESLIDING, Slip
from allocator.units import DEG

_LEAST, _MOST = 1e-6, 1.6  # [rad] of a push


@dataclass(frozen=True)
class Loop:
    """Hysteresis of a joint in steady loops: springs with sliders, and Dahl's friction."""

    slip: Slip | None = None  # separate springs [N·m/rad], or shares of K [-]
    mu: float = 0.0  # μ of Dahl's friction [-], share of a1 F1 + a2 F2
    coulomb: float = 0.0  # [N·m]
    presliding: float = PRESLIDING  # δ of Dahl's friction [rad]

    @property
    def absent(self) -> bool:
        """Whether there is none."""
        return self.slip is None and self.mu == 0 and self.coulomb == 0

    def secant(self, amplitude: Value) -> "Secant":
        """Return its secant against a push by ±`amplitude` [rad]. Raises `InvalidInput` for an invalid amplitude."""
        return Secant(self, checked_amplitude(amplitude))


class Region(NamedTuple):
    """Pressures P1 + P2 between which the secant is affine in P1 + P2, and its coefficients."""

    low: float  # of P1 + P2 [Pa]
    high: float
    share: float  # of K at P1 + P2 = 0 [-]
    share_slope: float  # [1/Pa]
    own: float  # stiffness at P1 + P2 = 0 [N·m/rad]
    own_slope: float  # [N·m/rad/Pa]


@dataclass(frozen=True)
class Secant:
    """Secant stiffness of the loops of one amplitude, as a function of K, P1 + P2 and the pull a1 F1 + a2 F2."""

    loop: Loop
    amplitude: Value  # A [rad]

    @property
    def drag(self) -> Value:
        """Secant of Dahl's friction by the pull, μ tanh(A/δ)/A [1/rad]   (S2)"""
        return self.loop.mu * self._dahl

    @property
    def _dahl(self) -> Value:
        return tanh(self.amplitude / self.loop.presliding) / self.amplitude

    def added(self, K: Value, pull: Value, filled: Value) -> Value:
        """Return K_h(A) [N·m/rad]   (S1), (S2)

        `K` is the isobaric stiffness [N·m/rad], `pull` a1 F1 + a2 F2 [N·m] and `filled` P1 + P2 [Pa]. Takes numbers,
        arrays and symbols.
        """
        slipping = self._springs(K, [least(1.0, rho / self.amplitude) for rho in self._widths(filled)])
        return slipping + self.drag * pull + self.loop.coulomb * self._dahl

    def work(self, K: Value, pull: Value, filled: Value) -> Value:
        """Return the work per cycle W(A) [J], arguments as of `added`   (S1), (S2)"""
        A, delta = self.amplitude, self.loop.presliding
        slipping = self._springs(K, [4 * rho * (A - least(A, rho)) for rho in self._finite(filled)])
        return slipping + 4 * (self.loop.mu * pull + self.loop.coulomb) * (A - delta * tanh(A / delta))

    def _springs(self, K: Value, terms: list[Value]) -> Value:
        """Return Σ k_i times each element's term."""
        slip = self.loop.slip
        total = 0.0 if slip is None else sum(k * term for k, term in zip(slip.springs, terms, strict=True))
        return total * (K if slip is not None and slip.elastic else 1.0) + 0.0 * K

    def _finite(self, filled: Value) -> list[Value]:
        """Return the ρ_i [rad], 0 of elements that never slip: they lose nothing."""
        slip = self.loop.slip
        return [] if slip is None else [0.0 if r == inf else r * _scale(slip, filled) for r in slip.widths]

    def _widths(self, filled: Value) -> list[Value]:
        """Return the ρ_i [rad] where P1 + P2 = `filled` [Pa]."""
        slip = self.loop.slip
        return [] if slip is None else [r if r == inf else r * _scale(slip, filled) for r in slip.widths]

    @property
    def separable(self) -> tuple[float, float, float] | None:
        """(α, drag, own) if it is α K + drag · (a1 F1 + a2 F2) + own for all pressures, uncoupled; else None."""
        region, *others = self.regions
        if others or region.share_slope or region.own_slope:
            return None
        return region.share, self.drag, region.own

    @property
    def regions(self) -> tuple[Region, ...]:
        """Ranges of P1 + P2 in their order, over all pressures: within each the secant is affine in P1 + P2."""
        slip, constant = self.loop.slip, self.loop.coulomb * self._dahl
        if slip is None:
            return (Region(-inf, inf, 0.0, 0.0, constant, 0.0),)
        kinks = sorted({kink for r in slip.widths if -inf < (kink := self._kink(r)) < inf})
        ends = [-inf, *kinks, inf]
        return tuple(self._region(slip, low, high, constant) for low, high in pairwise(ends))

    def affine_at(self, filled: Array) -> tuple[Array, Array, Array]:
        """Return share [-], its slope [1/Pa] and that of the own stiffness [N·m/rad/Pa] at P1 + P2 = `filled` [Pa]."""
        regions = self.regions
        at = np.searchsorted([r.high for r in regions[:-1]], filled, side="left")
        rows = np.array([(r.share, r.share_slope, r.own_slope) for r in regions])[at]
        return rows[..., 0] + rows[..., 1] * filled, rows[..., 1], rows[..., 2]

    def on_kink(self, filled: Array, near: float) -> Mask:
        """Return whether P1 + P2 = `filled` [Pa] lies within `near` [Pa] of a kink."""
        kinks = np.array([r.high for r in self.regions[:-1]])
        return np.asarray((np.abs(np.asarray(filled)[..., None] - kinks) <= near).any(axis=-1))

    def _kink(self, r: float) -> float:
        """Return the P1 + P2 [Pa] at which a width r s equals the amplitude; ±inf if it never does."""
        slip = self.loop.slip
        assert slip is not None
        if r == inf or slip.base == 1:
            return -inf if r >= self.amplitude else inf
        return float(FILLED * (self.amplitude / r - slip.base) / (1 - slip.base))

    def _region(self, slip: Slip, low: float, high: float, constant: float) -> Region:
        level = slope = 0.0
        for k, r in zip(slip.springs, slip.widths, strict=True):
            if self._kink(r) <= low:  # does not slip
                level += k
            else:
                level += k * r * slip.base / self.amplitude
                slope += k * r * (1 - slip.base) / FILLED / self.amplitude
        if slip.elastic:
            return Region(low, high, level, slope, constant, 0.0)
        return Region(low, high, 0.0, 0.0, level + constant, slope)


def _scale(slip: Slip, filled: Value) -> Value:
    return slip.base + (1 - slip.base) * filled / FILLED


def loss_factor(work: Value, felt: Value, amplitude: float) -> Value:
    """Return η = W/(π K_felt A²) [-] of loops of an `amplitude` [rad] with the work per cycle `work` [J]."""
    return work / (pi * felt * amplitude**2)


def checked_amplitude(amplitude: Value) -> Value:
    """Return the amplitude of a push [rad]; a symbol passes. Raises `InvalidInput` for an invalid one."""
    if is_symbol(amplitude):
        return amplitude
    A = checks.number("amplitude", amplitude, "rad")
    if not _LEAST <= A <= _MOST:
        raise InvalidInput(
            f"amplitude = {A:g} rad has to lie between {_LEAST:g} and {_MOST:g} rad; for degrees multiply by {DEG:.5g}"
        )
    return A
