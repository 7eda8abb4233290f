"""Muscle that pulls by an elastic cable.

A cable of stiffness k_c [N/m] gives by F/k_c, so that a muscle of length L contracts by more than its path shortens:

    F = f(P, ε + c F),    c = 1/(k_c L)

with the muscle's law f and the contraction ε of the path. By Newton's method from F = 0; with q = 1/(1 - c f_ε)

    F_P = q f_P,   F_ε = q f_ε,   F_Pε = q² f_Pε + c q³ f_εε f_P

taken at ε + c F. The muscle's own stiffness k = -f_ε/L and the cable's are in series, -F_ε/L = k k_c/(k + k_c): some
per cent less than k with steel wires and Dyneema, over a tenth less with soft cords. The gas fills the volume that the
muscle has at ε + c F, whose slope by ε is L F_P as (G1) asks.

Such a law is not affine in the pressure, although the muscle's may be. A slack cable (F < 0) is extended as the law is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask, Value, five_point, is_symbol
from allocator.errors import InvalidInput
from allocator.muscles.base import NOT_A_NUMBER, Muscle
from allocator.muscles.basis import Basis
from allocator.muscles.measured import MeasuredRegion, TabledRegion

_STEPS = 5  # of Newton's method; for cables of 1e4 N/m or more four, and one for derivatives by complex steps
_DIFFERENCE = 1e-3  # [-] of contraction, for derivatives without a formula
_SOFTEST, _STIFFEST = 1e3, 1e9  # [N/m]: 10 cm by a load of 100 N, and stiffer than any cable
_OF_THE_GAS: dict[str, float | None] = {"inner_radius": None, "rest_volume": None, "tube_volume": 0.0}


@dataclass(frozen=True)
class Cabled(Muscle):
    """Muscle in series with an elastic cable; its parameters and the volume of its gas are those of the muscle."""

    citation = "Hill, Proc. R. Soc. Lond. B 126:136-195, 1938 (the elastic component in series)"

    muscle: Muscle = field(metadata=NOT_A_NUMBER)
    cable_stiffness: float = field(metadata=NOT_A_NUMBER)  # k_c [N/m]
    rest_length: float = field(metadata=NOT_A_NUMBER)  # L of the muscle [m]

    def __post_init__(self) -> None:
        """Take covariance and volumes of the muscle as its own. Raises `InvalidInput`."""
        if not isinstance(self.muscle, Muscle) or isinstance(self.muscle, Cabled):
            raise InvalidInput(f"muscle = {checks.brief(self.muscle)} has to be a muscle without a cable")
        stiffness = checks.number("cable_stiffness", self.cable_stiffness, "N/m")
        if not _SOFTEST <= stiffness <= _STIFFEST:
            raise InvalidInput(
                f"cable_stiffness = {stiffness:g} N/m has to lie between {_SOFTEST:g} and {_STIFFEST:g} N/m; "
                "if N/mm was meant, multiply by 1000"
            )
        length = checks.positive("rest_length", self.rest_length, "m")
        given: dict[str, object] = {"cable_stiffness": stiffness, "rest_length": length}
        for name, nothing in ({"covariance": None} | _OF_THE_GAS).items():
            if getattr(self, name) == nothing:
                given[name] = getattr(self.muscle, name)
        given["measured"] = self.muscle.measured
        given["muscle"] = replace(self.muscle, covariance=None, **_OF_THE_GAS)  # type: ignore[arg-type]
        for name, value in given.items():
            object.__setattr__(self, name, value)
        super().__post_init__()

    @property
    def compliance(self) -> float:
        """c = 1/(k_c L) [1/N], contraction per force."""
        return 1 / (self.cable_stiffness * self.rest_length)

    # --- the law ----------------------------------------------------------------------------------------------------

    def law(self, P: Value, eps: Value) -> Value:
        """Return the F [N] of F = f(P, ε + c F)."""
        c, F = self.compliance, 0.0 * (P + eps)
        for _ in range(_STEPS):
            at = eps + c * F
            F = F + (self.muscle.law(P, at) - F) / (1 - c * self._slope(_real(P), _real(at)))
        return F

    def _stretched(self, P: Value, eps: Value) -> Value:
        """Return the muscle's contraction ε + c F [-]."""
        return eps + self.compliance * self.law(P, eps)

    def _slope(self, P: Value, at: Value) -> Value:
        """Return f_ε [N]; by differences of complex numbers, whose imaginary part a complex step would lose."""
        if any(np.iscomplexobj(x) for x in (P, at, *self.parameters.values()) if not is_symbol(x)):
            return five_point(lambda e: self.muscle.law(P, e), at, _DIFFERENCE)
        return self.muscle.slope(P, at)

    def _given(self, P: Value, at: Value) -> Value:
        """Return q = 1/(1 - c f_ε) at the muscle's contraction: how much of a motion reaches it."""
        return 1 / (1 - self.compliance * self._slope(P, at))

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P = q f_P [N/Pa]."""
        at = self._stretched(P, eps)
        return self._given(P, at) * self.muscle.gain(P, at)

    def slope(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂ε = q f_ε [N]."""
        at = self._stretched(P, eps)
        return self._given(P, at) * self._slope(P, at)

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """Return ∂²F/∂P∂ε = q² f_Pε + c q³ f_εε f_P [N/Pa]."""
        at = self._stretched(P, eps)
        q, bent = self._given(P, at), five_point(lambda e: self.muscle.slope(P, e), at, _DIFFERENCE)
        return q**2 * (self.muscle.gain_slope(P, at) + self.compliance * q * bent * self.muscle.gain(P, at))

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return the pressure [Pa] at which the stretched muscle gives the force `F`; ∓inf as the muscle's."""
        return self.muscle.pressure(F, eps + self.compliance * np.asarray(F, float))

    # --- its domain -------------------------------------------------------------------------------------------------

    @property
    def max_pressure(self) -> float:
        """The muscle's."""
        return self.muscle.max_pressure

    @property
    def min_contraction(self) -> float:
        """The muscle's: a taut cable only lets it contract further."""
        return self.muscle.min_contraction

    @property
    def max_contraction(self) -> float:
        """The muscle's, at which it pulls no cable."""
        return self.muscle.max_contraction

    @property
    def region(self) -> MeasuredRegion | TabledRegion | None:
        """The muscle's."""
        return self.muscle.region

    def covers(self, P: Array, eps: Array) -> Mask:
        """Return whether the muscle's law is meant for the contractions that it has behind its cable."""
        return self.muscle.covers(P, np.asarray(self._stretched(P, eps)))

    @property
    def basis(self) -> Basis:
        """Smooth functions of the pressure between the kinks of the muscle's law."""
        return Basis("smooth", kinks=self.muscle.basis.kinks)

    @property
    def limitation(self) -> str:
        """The muscle's."""
        return self.muscle.limitation

    # --- its gas and its parameters ---------------------------------------------------------------------------------

    @property
    def own_radius(self) -> Value | None:
        """The muscle's."""
        return self.muscle.own_radius

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return the volume beyond V_0 per length [m²], that of the muscle at ε + c F."""
        return self.muscle.gain_integral(P, self._stretched(P, eps))

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return its slope by the pressure [m²/Pa]: at a constant contraction, and as the cable gives."""
        at = self._stretched(P, eps)
        gain = self.muscle.gain(P, at)
        return self.muscle.gain_integral_slope(P, at) + self.compliance * self._given(P, at) * gain**2

    @property
    def parameters(self) -> dict[str, float]:
        """The muscle's."""
        return self.muscle.parameters

    @property
    def strength(self) -> Mapping[str, float]:  # type: ignore[override]  # a class variable of laws
        """The muscle's: a stronger muscle pulls by the same cable."""
        return self.muscle.strength

    @property
    def has_threshold(self) -> bool:  # type: ignore[override]
        """Whether the muscle's law has a threshold pressure."""
        return self.muscle.has_threshold

    def _grouped(self, values: Sequence[Value]) -> dict[str, Value]:
        return {"muscle": self.muscle.unchecked(values)}


def _real(x: Value) -> Value:
    """Return the real part of numbers: the slope of Newton's method need not be exact."""
    return x if is_symbol(x) else np.real(x)


def checked_cables(muscles: Sequence[Muscle], lengths: Sequence[float]) -> None:
    """Insist that cables were made for muscles of these lengths [m]. Raises `InvalidInput`."""
    for muscle, length in zip(muscles, lengths, strict=True):
        if isinstance(muscle, Cabled) and not np.isclose(muscle.rest_length, length, rtol=1e-9):
            raise InvalidInput(
                f"the cable is of a muscle with rest_length = {muscle.rest_length:g} m, which is {length:g} m long here"
            )
