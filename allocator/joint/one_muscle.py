"""One muscle at a posture; static torques and stiffnesses of joints and mechanisms are sums over these."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from allocator.calculus import Array, Value, derivative, increasing_root, is_symbol
from allocator.errors import InvalidInput
from allocator.joint.gas import AIR, Gas
from allocator.joint.geometry import Routing
from allocator.joint.limits import BINDS, Limit, Limits, PressureInterval
from allocator.muscles import AffineMuscle, Muscle
from allocator.units import BAR

STABLE = 0.5  # of V: with a smaller V^eff the law's volume falls implausibly fast with the pressure
_MOST_GROWTH = 100.0  # of a volume by contraction; a braided tube grows sevenfold at most
_NEARLY = 1e-6  # of a force: the same
_LOOKED_AT = 33  # pressures in the search for the first V^eff below that


@dataclass(frozen=True)
class OneMuscle:
    """Muscle at a posture, which adds a torque r F(P) and a stiffness k(P) r rᵀ + F(P) H.

    Its arm r = -∇l and bend H = ∇²l are numbers at a joint (r = ±a, H = ∓a' of its moment arm a), or with `vector` a
    vector and a matrix at a mechanism. Its own stiffness k is -F_ε/L, plus a `share` of the trapped gas by (G5), see
    `allocator.joint.gas`. Contraction, pressures and dependent values have the shape (…).
    """

    muscle: Muscle
    name: str  # "agonist", "antagonist", or its name in a mechanism
    rest_length: float  # L [m]
    contraction: Value  # ε (…) [-]
    arm: Value  # r [m]: (…), or (…, n)
    bend: Value  # H [m/rad]: (…), or (…, n, n)
    share: Value | None = None  # s of the trapped gas in the stiffness [-]; None: constant pressure
    gas: Gas = AIR
    push: tuple[float, float] | None = (
        None  # (α, drag) of hysteresis in the stiffness of a joint, see `Secant.separable`
    )
    vector: bool = False  # whether arm and bend are a vector and a matrix

    @classmethod
    def at_joint(
        cls, muscle: Muscle, agonist: bool, rest_length: float, routing: Routing, share: Value = None, gas: Gas = AIR
    ) -> Self:
        """Return the agonist or the antagonist of a joint, routed by its `Geometry`."""
        eps, a, slope = routing
        if agonist:
            return cls(muscle, "agonist", rest_length, eps, a, -slope, share, gas)
        return cls(muscle, "antagonist", rest_length, eps, -a, slope, share, gas)

    @property
    def moment_arm(self) -> Value:
        """= |r| [m] of a joint's muscle, positive."""
        return -self.arm if self.name == "antagonist" else self.arm

    @property
    def affine(self) -> bool:
        """Whether torque and stiffness are affine in the pressure."""
        return isinstance(self.muscle, AffineMuscle)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """(contraction, arm, bend), which depend on the posture."""
        return self.contraction, self.arm, self.bend

    def moved(self, contraction: Array, arm: Array, bend: Array) -> Self:
        """Return the muscle at other postures, or at a selection of them, with the same share of the gas."""
        return replace(self, contraction=contraction, arm=arm, bend=bend)

    @property
    def isobaric(self) -> Self:
        """Muscle at constant pressure."""
        return replace(self, share=None, push=None)

    def force(self, P: Value) -> Value:
        """Return the muscle's force F [N]; negative for a slack cable."""
        return self.muscle.law(P, self.contraction)

    def own_stiffness(self, P: Value) -> Value:
        """Return k = -F_ε/L [N/m], plus the share of its gas."""
        k = -self.muscle.slope(P, self.contraction) / self.rest_length
        return k if self.share is None else k + self.share * self._gas_stiffness(P)

    def torque(self, P: Value) -> Value:
        """Return the torque r F(P) [N·m] that the muscle adds   (M1)"""
        return self._along(self.force(P))

    def stiffness(self, P: Value) -> Value:
        """Return the stiffness k r rᵀ + F H [N·m/rad] that the muscle adds   (M2)"""
        K = self._squared(self.own_stiffness(P)) + self._bent(self.force(P))
        return K if self.push is None else K + self.met(self.isobaric.stiffness(P), self.force(P))

    def added(self, F: Value, k: Value) -> tuple[Value, Value]:
        """Return (r F, k r rᵀ + F H), the torque and stiffness of a force [N] and an own stiffness [N/m]."""
        return self._along(F), self._squared(k) + self._bent(F)

    def force_gain(self, P: Value) -> Value:
        """Return dF/dP [N/Pa]."""
        return self.muscle.gain(P, self.contraction)

    def own_stiffness_gain(self, P: Value) -> Value:
        """Return dk/dP = -F_Pε/L [N/m/Pa], plus that of the gas."""
        gain = -self.muscle.gain_slope(P, self.contraction) / self.rest_length
        return gain if self.share is None else gain + self.share * self._gas_stiffness_gain(P)

    def torque_gain(self, P: Value) -> Value:
        """Return r F_P [N·m/Pa], the derivative of `torque` by P."""
        return self._along(self.force_gain(P))

    def stiffness_gain(self, P: Value) -> Value:
        """Return k' r rᵀ + F_P H [N·m/rad/Pa], the derivative of `stiffness` by P."""
        gain = self._squared(self.own_stiffness_gain(P)) + self._bent(self.force_gain(P))
        return gain if self.push is None else gain + self.met(self.isobaric.stiffness_gain(P), self.force_gain(P))

    def met(self, K: Value, F: Value) -> Value:
        """Return α K + drag a F, the hysteresis for the isobaric K [N·m/rad] and force F [N]; or for their slopes."""
        alpha, drag = (0.0, 0.0) if self.push is None else self.push
        return alpha * K + drag * self.moment_arm * F

    def stiffness_gain_terms(self, P: Value) -> tuple[Value, ...]:
        """Return the terms of `stiffness_gain`: elastic, geometric, and that of the gas, if any."""
        elastic = self._squared(-self.muscle.gain_slope(P, self.contraction) / self.rest_length)
        isobaric = elastic, self._bent(self.force_gain(P))
        gas = () if self.share is None else (self._squared(self.share * self._gas_stiffness_gain(P)),)
        if self.push is None:
            return (*isobaric, *gas)
        return (*isobaric, *gas, self.met(elastic + isobaric[1], self.force_gain(P)))

    def _along(self, F: Value) -> Value:
        """Return r F."""
        return self.arm * (np.asarray(F)[..., None] if self.vector else F)

    def _bent(self, F: Value) -> Value:
        """Return F H."""
        return self.bend * (np.asarray(F)[..., None, None] if self.vector else F)

    def _squared(self, k: Value) -> Value:
        """Return k r rᵀ."""
        if not self.vector:
            return k * self.arm**2
        return np.asarray(k)[..., None, None] * (self.arm[..., :, None] * self.arm[..., None, :])

    # --- the gas ----------------------------------------------------------------------------------------------------

    def trapped(self, P: Value, kappa: Value = None) -> Value:
        """Return the stiffness of all trapped gas, κ (P + p_a)/V^eff g gᵀ with g = r F_P   (G2)

        `kappa` is by default the gas's; it may be the complex one at a frequency.
        """
        return self._squared(self._gas_stiffness(P, kappa))

    def _gas_stiffness(self, P: Value, kappa: Value = None) -> Value:
        """Return the own stiffness of all trapped gas, κ (P + p_a) F_P²/V^eff [N/m]."""
        kappa = self.gas.kappa if kappa is None else kappa
        return kappa * (P + self.gas.atmosphere) * self.force_gain(P) ** 2 / self.effective_volume(P, kappa)

    def volume(self, P: Value) -> Value:
        """Return the volume V of the gas [m³], unchecked   (G1)"""
        return self.muscle.volume(P, self.contraction, self.rest_length)

    def check_volume(self, P: Value) -> None:
        """Raise InvalidInput if the law gives no volume, or an implausible one; symbols pass (P: [Pa])."""
        if is_symbol(P) or is_symbol(self.contraction):
            return
        V = np.asarray(self.volume(P))
        if (none := V <= 0).any():
            eps = np.broadcast_to(self.contraction, V.shape)[none][0]
            raise InvalidInput(
                f"the gas of the {self.name} has no volume ({V[none][0]:.3g} m³) at the contraction ratio {eps:.4g}: "
                "narrow the angle limits, or correct rest_length, rest_volume or tube_volume"
            )
        at_rest = float(self.muscle.volume_at_rest(self.rest_length))
        if (most := float(np.max(V, initial=0.0))) > _MOST_GROWTH * at_rest:
            raise InvalidInput(
                f"with {at_rest:.3g} m³ at rest length the gas of the {self.name} would grow to {most:.3g} m³ here, "
                f"over {_MOST_GROWTH:g} times as much: if rest_volume was meant in litres, pass {at_rest * 1e3:.3g}"
            )

    def check_effective_volume(self, P: Value) -> None:
        """Raise InvalidInput if the law gives no V, or V^eff ≤ 0, at these pressures [Pa]; symbols pass."""
        self.check_volume(P)
        numbers = not (is_symbol(P) or is_symbol(self.contraction))
        if numbers and (least := float(np.min(P, initial=np.inf))) <= -self.gas.atmosphere:
            raise InvalidInput(f"the gauge pressure {least:g} Pa of the {self.name} is below a vacuum")
        if numbers and not self.affine and np.any(self.effective_volume(P) <= 0):
            raise InvalidInput(
                f"this {type(self.muscle).__name__} and its rest_volume have no shut stiffness here: the volume of "
                f"the {self.name} would fall with the pressure faster than its gas is compressed (V^eff <= 0)"
            )

    def effective_volume(self, P: Value, kappa: Value = None) -> Value:
        """Return V^eff = V + κ (P + p_a) ∂V/∂P |ε [m³]; V if the law is affine in the pressure   (G2)"""
        if self.affine:
            return self.volume(P)
        kappa = self.gas.kappa if kappa is None else kappa
        return self.volume(P) + kappa * (P + self.gas.atmosphere) * self._volume_gain(P)

    def _volume_gain(self, P: Value) -> Value:
        return self.rest_length * self.muscle.gain_integral_slope(P, self.contraction)

    def _gas_stiffness_gain(self, P: Value) -> Value:
        """Return the derivative of `_gas_stiffness` by the pressure, as for a product of powers."""
        kappa, absolute, gain = self.gas.kappa, P + self.gas.atmosphere, self.force_gain(P)
        if self.affine:
            return kappa * gain**2 / self.volume(P)
        effective, gain_slope = self.effective_volume(P), derivative(self.force_gain, P)
        effective_slope = (1 + kappa) * self._volume_gain(P) + kappa * absolute * derivative(self._volume_gain, P)
        return kappa / effective * (gain**2 + 2 * absolute * gain * gain_slope) - (
            self._gas_stiffness(P) * effective_slope / effective
        )

    def _gas_ceiling(self, lo: float, most: float) -> Array:
        """Return the pressure [Pa] up to which V^eff is at least `STABLE` of V; inf if that holds up to `most`.

        The law with a V_0 independent of the pressure may give a volume that falls as the pressure grows; gas would
        make such a muscle ever stiffer, and finally unstable. The search covers taut muscles, where the law applies. If
        the condition fails already at the slack pressure, the ceiling lies below it, and no pressure is left.
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
        """Return the pressure [Pa] at which this muscle of a joint adds `torque`; ∓inf if there is none."""
        return self.muscle.pressure(torque / self.arm, self.contraction)

    def interval(self, supply: tuple[float, float], limits: Limits) -> PressureInterval:
        """Intersect supply [Pa], validity of the model and `limits`, and record which of them sets each end.

        Every limit counts separately: if two are at the same pressure, both set the end. Only supply and validity of
        the model count as one, the lower, and the supply if they are equal. With a share of the gas the model also
        requires a plausible volume: V^eff ≥ V/2. The slew limit and the flags are those of the first muscle, an
        agonist, unless this is an antagonist.
        """
        antagonist = self.name == "antagonist" and not self.vector
        lower, upper, slack, rate, validity, ceiling = _FLAGS[antagonist]
        everywhere = np.ones(np.shape(self.contraction))
        most = (self.muscle.max_pressure, validity) if self.muscle.max_pressure < supply[1] else (supply[1], upper)
        floors, ceilings = [(supply[0] * everywhere, lower)], [(most[0] * everywhere, most[1])]
        ends = supply[0], most[0]
        forces = self._forces_at(*ends)
        if self.affine:
            ceilings.append((np.where(forces[1] > forces[0], np.inf, supply[0]), validity))
        if limits.min_force is not None:
            floors.append((self._pressure_of(limits.min_force, ends, forces), slack))
        if limits.max_force is not None:
            ceilings.append((self._pressure_of(limits.max_force, ends, forces), ceiling))
        if self.share is not None:
            self.check_volume(floors[-1][0].clip(supply[0], most[0]))
            ceilings.append((self._gas_ceiling(supply[0], most[0]), validity))
        nearest, farthest = limits.reach(int(antagonist))
        reach = (nearest, rate), (farthest, rate)
        return PressureInterval.between(floors, ceilings, reach, BINDS * (supply[1] - supply[0]))

    def _forces_at(self, low: float, high: float) -> tuple[Array, Array]:
        """Return the forces [N] at two pressures [Pa]. Raises InvalidInput where the law gives no number."""
        eps = np.asarray(self.contraction, float)
        with np.errstate(all="ignore"):
            first, last = (np.asarray(self.muscle.law(P, eps)) for P in (low, high))
        if (wrong := ~np.isfinite(first + last)).any():
            raise InvalidInput(
                f"the force law of {self.name} ({type(self.muscle).__name__}) gives no number at the contraction ratio "
                f"{eps[wrong][0]:.4g}, which the angle limits allow: narrow them (--stops)"
            )
        return first, last

    def _pressure_of(self, F: float, ends: tuple[float, float], forces: tuple[Array, Array]) -> Array:
        """Return the pressure [Pa] from which on the force is `F` [N] or more, by the `forces` at the `ends`.

        ∓inf if it is so everywhere or nowhere. Raises InvalidInput if both ends show that the force falls again.
        """
        (low, high), (first, last), P = ends, forces, self.muscle.pressure(F, self.contraction)
        if self.affine:  # beyond the contraction where its area vanishes a muscle has no use for pressure
            return np.where(last > first, P, np.where(first < F, np.inf, -np.inf))
        near = _NEARLY * (np.abs(first) + np.abs(last) + abs(F))
        wrong = (P < high) & (last < F - near) | (P > high) & (last > F + near) | (P > low) & (first > F + near)
        if wrong.any():
            raise InvalidInput(
                f"the force of {self.name} ({type(self.muscle).__name__}) falls between {low / BAR:.4g} and "
                f"{high / BAR:.4g} bar at the contraction ratio {np.asarray(self.contraction)[wrong][0]:.4g}: keep to "
                "where it rises, by narrower angle limits (--stops), a lower supply, or the law's max_pressure"
            )
        return P


_FLAGS = {
    False: (
        Limit.P1_LOWER,
        Limit.P1_UPPER,
        Limit.AGONIST_SLACK,
        Limit.P1_RATE,
        Limit.AGONIST_VALIDITY,
        Limit.AGONIST_FORCE,
    ),
    True: (
        Limit.P2_LOWER,
        Limit.P2_UPPER,
        Limit.ANTAGONIST_SLACK,
        Limit.P2_RATE,
        Limit.ANTAGONIST_VALIDITY,
        Limit.ANTAGONIST_FORCE,
    ),
}
