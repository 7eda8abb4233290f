"""One muscle held at a joint angle is half of the joint; everything static is said in terms of the two halves."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from allocator.calculus import Array, Value, derivative, increasing_root, is_symbol
from allocator.errors import InvalidInput
from allocator.joint.gas import AIR, Gas
from allocator.joint.limits import BINDS, Limit, Limits, PressureInterval
from allocator.muscles import AffineMuscle, Muscle

STABLE = 0.5  # of V: where V^eff is less the law's volume falls with the pressure too steeply to be a volume
_MOST_GROWTH = 100.0  # of a volume by contraction; that of a braided tube grows to seven times itself at most
_LOOKED_AT = 33  # pressures between which the first fall of V^eff below that is looked for


@dataclass(frozen=True)
class OneMuscle:
    """`OneMuscle` is a muscle held at a joint angle, which adds t(P) to the torque and k(P) to the stiffness.

    The stiffness is the isobaric one, or with a `share` of the trapped gas the one of (G5), see `allocator.joint.gas`.
    """

    muscle: Muscle
    sign: int  # +1 agonist, -1 antagonist
    rest_length: float  # l0 [m]
    contraction: Value  # ε [-]
    arm: Value  # a [m]
    arm_slope: Value  # da/dθ [m/rad]
    share: Value | None = None  # s of the trapped gas in the stiffness [-]; None: none, pressures are held
    gas: Gas = AIR

    @property
    def affine(self) -> bool:
        """Return whether t and k are affine in the pressure."""
        return isinstance(self.muscle, AffineMuscle)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """Return (contraction, arm, arm slope): what varies from angle to angle."""
        return self.contraction, self.arm, self.arm_slope

    def moved(self, contraction: Array, arm: Array, arm_slope: Array) -> Self:
        """Return the muscle at other angles, or at a selection of them; a share of the gas stays."""
        return replace(self, contraction=contraction, arm=arm, arm_slope=arm_slope)

    @property
    def isobaric(self) -> Self:
        """Return the muscle at a held pressure."""
        return replace(self, share=None)

    def force(self, P: Value) -> Value:
        """Return the muscle's force [N]; negative where the cable would be slack."""
        return self.muscle.law(P, self.contraction)

    def torque(self, P: Value) -> Value:
        """Return the torque t = ±a F(P, ε) [N·m] that the muscle adds."""
        return self.sign * self.arm * self.force(P)

    def stiffness(self, P: Value) -> Value:
        """Return the stiffness k = -a² F_ε/l0 ∓ a' F [N·m/rad] that the muscle adds, and its gas."""
        elastic = -(self.arm**2) / self.rest_length * self.muscle.slope(P, self.contraction)
        isobaric = elastic - self.sign * self.arm_slope * self.force(P)
        return isobaric if self.share is None else isobaric + self.share * self.trapped(P)

    def torque_gain(self, P: Value) -> Value:
        """Return dt/dP = ±a F_P [N·m/Pa]."""
        return self.sign * self.arm * self.muscle.gain(P, self.contraction)

    def stiffness_gain(self, P: Value) -> Value:
        """Return dk/dP = -a² F_Pε/l0 ∓ a' F_P [N·m/rad/Pa], and that of the gas."""
        elastic, geometric, *gas = self.stiffness_gain_terms(P)
        return elastic + geometric + gas[0] if gas else elastic + geometric

    def stiffness_gain_terms(self, P: Value) -> tuple[Value, ...]:
        """Return the two terms of dk/dP, elastic and geometric, and the gas's if there is any."""
        gain = self.muscle.gain(P, self.contraction)
        elastic = -(self.arm**2) / self.rest_length * self.muscle.gain_slope(P, self.contraction)
        isobaric = elastic, -self.sign * self.arm_slope * gain
        return isobaric if self.share is None else (*isobaric, self.share * self._trapped_gain(P))

    # --- the gas ----------------------------------------------------------------------------------------------------

    def trapped(self, P: Value) -> Value:
        """Return what all of the trapped gas adds to the stiffness, κ (P + p_a) g²/V^eff [N·m/rad]   (G2)"""
        return self.gas.kappa * (P + self.gas.atmosphere) * self.torque_gain(P) ** 2 / self.effective_volume(P)

    def volume(self, P: Value) -> Value:
        """Return the volume V of the gas [m³], unchecked   (G1)"""
        return self.muscle.volume(P, self.contraction, self.rest_length)

    def check_volume(self, P: Value) -> None:
        """Raise InvalidInput where the law leaves no volume, or one out of proportion; symbols pass (P: [Pa])."""
        if is_symbol(P) or is_symbol(self.contraction):
            return
        V = np.asarray(self.volume(P))
        if (least := float(np.min(V, initial=np.inf))) <= 0:
            raise InvalidInput(f"rest_volume and tube_volume leave the {self.name} a volume of {least:.3g} m³ here")
        at_rest = float(self.muscle.volume_at_rest(self.rest_length))
        if (most := float(np.max(V, initial=0.0))) > _MOST_GROWTH * at_rest:
            raise InvalidInput(
                f"with {at_rest:.3g} m³ at rest length the gas of the {self.name} would grow to {most:.3g} m³ here, "
                f"over {_MOST_GROWTH:g} times as much: if rest_volume was meant in litres, pass {at_rest * 1e3:.3g}"
            )

    def check_effective_volume(self, P: Value) -> None:
        """Raise InvalidInput where the law leaves no V, or a V^eff ≤ 0, at these pressures [Pa]; symbols pass."""
        self.check_volume(P)
        numbers = not (is_symbol(P) or is_symbol(self.contraction))
        if numbers and (least := float(np.min(P, initial=np.inf))) <= -self.gas.atmosphere:
            raise InvalidInput(f"the gauge pressure {least:g} Pa of the {self.name} is below a vacuum")
        if numbers and not self.affine and np.any(self.effective_volume(P) <= 0):
            raise InvalidInput(
                f"this {type(self.muscle).__name__} and its rest_volume have no shut stiffness here: the volume of "
                f"the {self.name} would fall with the pressure faster than its gas is compressed (V^eff <= 0)"
            )

    def effective_volume(self, P: Value) -> Value:
        """Return V^eff = V + κ (P + p_a) ∂V/∂P |ε [m³]; V where the law is affine in the pressure   (G2)"""
        if self.affine:
            return self.volume(P)
        return self.volume(P) + self.gas.kappa * (P + self.gas.atmosphere) * self._volume_gain(P)

    @property
    def name(self) -> str:
        """Return "agonist" or "antagonist"."""
        return "agonist" if self.sign > 0 else "antagonist"

    def _volume_gain(self, P: Value) -> Value:
        return self.rest_length * self.muscle.gain_integral_slope(P, self.contraction)

    def _trapped_gain(self, P: Value) -> Value:
        """Return the derivative of `trapped` by the pressure: as of a product of powers."""
        kappa, absolute = self.gas.kappa, P + self.gas.atmosphere
        if self.affine:
            return kappa * self.torque_gain(P) ** 2 / self.volume(P)
        gain, effective = self.torque_gain(P), self.effective_volume(P)
        gain_slope = derivative(self.torque_gain, P)
        effective_slope = (1 + kappa) * self._volume_gain(P) + kappa * absolute * derivative(self._volume_gain, P)
        return kappa / effective * (gain**2 + 2 * absolute * gain * gain_slope) - (
            self.trapped(P) * effective_slope / effective
        )

    def _gas_ceiling(self, lo: float, most: float) -> Array:
        """Return the pressure [Pa] up to which V^eff is `STABLE` of V or more, inf where it is up to `most`.

        The law and a V_0 that does not depend on the pressure may say that the volume falls as the pressure grows; a
        gas would make such a muscle ever stiffer, and unstable in the end. It is looked for where the muscle is taut,
        since the law says nothing elsewhere; where it is so from there on the ceiling lies below, and no pressure is
        left.
        """
        eps = np.asarray(self.contraction, float)
        if self.affine or self.share is None:
            return np.full(eps.shape, np.inf)

        def lacking(P: Array, eps: Array) -> Array:
            V, slope = self.muscle.volume(P, eps, self.rest_length), self.muscle.gain_integral_slope(P, eps)
            taken = self.gas.kappa * (P + self.gas.atmosphere) * self.rest_length * slope  # V^eff - V
            return np.asarray((STABLE - 1) * V - taken)

        start = np.clip(self.muscle.pressure(0.0, eps), lo, most)
        P = start + (most - start) * np.linspace(0.0, 1.0, _LOOKED_AT).reshape(-1, *[1] * eps.ndim)
        missed = lacking(P, eps) > 0
        first = missed.argmax(axis=0)
        before, after = (np.take_along_axis(P, i[None], 0)[0] for i in (np.maximum(first - 1, 0), first))
        root = increasing_root(lacking, before, after, eps)
        none = start - 1e-6 * (most - lo)
        ceiling = np.where(missed.any(axis=0), np.where(first > 0, root, none), np.inf)
        return np.where(np.asarray(self.share) > 0, ceiling, np.inf)

    def pressure_for_torque(self, torque: Array) -> Array:
        """Return the pressure [Pa] that makes this muscle add `torque`; ∓inf where it has none."""
        return self.muscle.pressure(self.sign * torque / self.arm, self.contraction)

    def interval(self, supply: tuple[float, float], limits: Limits) -> PressureInterval:
        """Intersect supply [Pa], validity of the model and `limits`, remembering which of them sets each end.

        Every limit counts by itself: where two lie at the same pressure both set the end. Only supply and validity of
        the model count as one, the lower, and the supply where they are equal. With a share of the gas the model is
        valid as far as its volume makes sense, too: V^eff ≥ V/2.
        """
        lower, upper, slack, rate, validity, ceiling = _FLAGS[self.sign]
        everywhere = np.ones(np.shape(self.contraction))
        most = (self.muscle.max_pressure, validity) if self.muscle.max_pressure < supply[1] else (supply[1], upper)
        floors, ceilings = [(supply[0] * everywhere, lower)], [(most[0] * everywhere, most[1])]
        if limits.min_force is not None:
            floors.append((self.muscle.pressure(limits.min_force, self.contraction), slack))
        if limits.max_force is not None:
            ceilings.append((self.muscle.pressure(limits.max_force, self.contraction), ceiling))
        if self.share is not None:
            self.check_volume(floors[-1][0].clip(supply[0], most[0]))
            ceilings.append((self._gas_ceiling(supply[0], most[0]), validity))
        nearest, farthest = limits.reach(0 if self.sign > 0 else 1)
        reach = (nearest, rate), (farthest, rate)
        return PressureInterval.between(floors, ceilings, reach, BINDS * (supply[1] - supply[0]))


_FLAGS = {
    +1: (
        Limit.P1_LOWER,
        Limit.P1_UPPER,
        Limit.AGONIST_SLACK,
        Limit.P1_RATE,
        Limit.AGONIST_VALIDITY,
        Limit.AGONIST_FORCE,
    ),
    -1: (
        Limit.P2_LOWER,
        Limit.P2_UPPER,
        Limit.ANTAGONIST_SLACK,
        Limit.P2_RATE,
        Limit.ANTAGONIST_VALIDITY,
        Limit.ANTAGONIST_FORCE,
    ),
}

__all__ = ["STABLE", "OneMuscle"]
