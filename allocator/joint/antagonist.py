"""Antagonistic joint: a geometry and two muscles.

With moment arms a_i(θ) and contractions ε_i(θ) the joint's torque and isobaric stiffness are

    T = a1 F1 - a2 F2                                                                   (2)
    K = -∂T/∂θ |P = -(a1² F1_ε + a2² F2_ε)/l0 - (a1' F1 - a2' F2)                       (5), [G]

At a fixed angle each muscle adds a term, t(P) and k(P), to both: the joint is two curves in the (T, K) plane. All
static functions of this package are expressed by these two, each an `OneMuscle`.
"""

from dataclasses import dataclass, field
from functools import cache, cached_property
from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint import gas as trapped
from allocator.joint.felt import Loop, Secant, loss_factor
from allocator.joint.gas import AIR, Gas, Shares, StiffnessKind, Valves, checked_gas
from allocator.joint.geometry import Geometry, Pulley, check_routes
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.joint.hysteresis import PrandtlIshlinskii, after_history, nearest_equilibrium
from allocator.joint.limits import (
    COMMON_FORCE,
    PRIOR_FORCE,
    TAUT,
    UNSEEN,
    Limit,
    Limits,
    PressureBox,
    checked_contraction,
    checked_supply,
)
from allocator.joint.one_muscle import OneMuscle
from allocator.joint.tondu_pulley import TonduPulley
from allocator.muscles import AffineMuscle, Muscle, Tondu2021
from allocator.muscles.base import Covariance
from allocator.muscles.cabled import checked_cables
from allocator.muscles.catalogue import TONDU_DMSP_20_400N
from allocator.units import BAR, DEG


@dataclass(frozen=True)
class AntagonistJoint:
    """Joint with a geometry, an agonist (muscle 1), an antagonist (muscle 2) and limits. Immutable.

    The muscles need not be identical. Angles in rad, pressures in Pa (gauge), torque in N·m, stiffness in N·m/rad;
    numeric arguments broadcast, and `torque`, `stiffness` and `jacobian` also take CasADi symbols.
    """

    geometry: Geometry
    agonist: Muscle
    antagonist: Muscle
    pressure_limits: tuple[float, float] = (0.0, 5 * BAR)  # of the supply [Pa]
    min_contraction: float = 0.025  # ε_threshold [-], below it no model is valid   (25)
    angle_limits: tuple[float, float] | None = None  # mechanical end stops [rad]
    friction: float = field(default=0.0, kw_only=True)  # μ of `friction_torque` [-]
    hysteresis: PrandtlIshlinskii | None = field(default=None, kw_only=True)  # of the angle, if it was identified
    covariance: Covariance | None = field(default=None, kw_only=True, repr=False)
    """Of all parameters of agonist and antagonist together, in this order, if the joint was fitted as a whole."""
    unseen: tuple[str, ...] = field(default=(), kw_only=True)
    """Quantities that the data of its fit could not identify, each one of `allocator.joint.limits.UNSEEN`."""
    gas: Gas = field(default=AIR, kw_only=True)  # in the muscles, which define their volumes

    def __post_init__(self) -> None:
        """Check the parts and the limits against each other."""
        for name, kind in (("geometry", Geometry), ("agonist", Muscle), ("antagonist", Muscle)):
            if not isinstance(part := getattr(self, name), kind):
                how = ", such as named_muscle(name)" if kind is Muscle else ", such as Pulley(…)"
                raise InvalidInput(f"{name} = {checks.brief(part)} has to be a {kind.__name__}{how}")
        object.__setattr__(self, "pressure_limits", checked_supply(self.pressure_limits))
        object.__setattr__(self, "min_contraction", checked_contraction(self.min_contraction))
        if self.angle_limits is not None:
            checks.angle("angle_limits", self.angle_limits)
            left, right = checks.limits("angle_limits", self.angle_limits, "rad")
            if not left < right:
                raise InvalidInput(f"angle_limits = ({left:g}, {right:g}) rad have to increase")
            object.__setattr__(self, "angle_limits", (left, right))
        object.__setattr__(self, "friction", checks.not_negative("friction", self.friction, "share of the forces"))
        if self.friction > 1:
            raise InvalidInput(f"friction = {self.friction:g} has to be a share of the muscle forces, 0 to 1")
        if not isinstance(self.hysteresis, PrandtlIshlinskii | None):
            raise InvalidInput(f"hysteresis = {checks.brief(self.hysteresis)} has to be a PrandtlIshlinskii, or None")
        checked_gas(self.gas)
        checked_cables((self.agonist, self.antagonist), (self.geometry.rest_length,) * 2)
        if self.covariance is not None:
            n = len(self.agonist.parameters) + len(self.antagonist.parameters)
            object.__setattr__(self, "covariance", checks.covariance("covariance of a joint", self.covariance, n))
        object.__setattr__(self, "unseen", _known(self.unseen))
        left, right = self.angle_range
        if not left < right:
            raise InvalidInput(
                f"no joint angle keeps both contractions above min_contraction = {self.min_contraction:g} "
                "within the angle limits"
            )
        check_routes(self.geometry, left, right)

    def __repr__(self) -> str:
        laws = " and ".join(dict.fromkeys(type(muscle).__name__ for muscle in (self.agonist, self.antagonist)))
        left, right = (end / DEG for end in self.angle_limits or (-pi, pi))
        low, high = (P / BAR for P in self.pressure_limits)
        return f"AntagonistJoint: {laws} on {self.geometry}, {left:.4g}° … {right:.4g}°, {low:g} … {high:g} bar"

    # --- at a fixed angle -------------------------------------------------------------------------------------------

    def sides(self, theta: Value, shares: Shares | None = None) -> tuple[OneMuscle, OneMuscle]:
        """Return agonist and antagonist at the joint angle `theta` [rad].

        Their stiffness is isobaric, or includes these `shares` (s1, s2) of the trapped gas   (G5)
        """
        l0 = self.geometry.rest_length
        one, two = self.geometry.agonist(theta), self.geometry.antagonist(theta)
        s1, s2 = (None, None) if shares is None else shares
        return (
            OneMuscle.at_joint(self.agonist, True, l0, one, s1, self.gas),
            OneMuscle.at_joint(self.antagonist, False, l0, two, s2, self.gas),
        )

    def torque(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> Value:
        """Return the model's torque T = a1 F1 - a2 F2 [N·m]   (2); at a negative force the real cable is slack."""
        theta, P1, P2 = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(theta)
        return agonist.torque(P1) + antagonist.torque(P2)

    def stiffness(
        self,
        theta: ArrayLike,
        P1: ArrayLike,
        P2: ArrayLike,
        valves: Valves = "open",
        *,
        amplitude: Value | None = None,
        loop: Loop | None = None,
    ) -> Value:
        """Return the joint's stiffness [N·m/rad]: the isobaric K = -∂T/∂θ at constant pressures, or with shut valves.

        `valves` "open" is isobaric (5), [G]; "shut", or a pair of truth values for agonist and antagonist, adds the
        stiffness of the trapped gas (G2). With an `amplitude` A [rad] it is the secant against pushes by ±A, with the
        hysteresis of the joint or of a `loop` (S3). Raises InvalidInput for invalid valves or amplitudes, for a muscle
        of unknown volume, and if the law gives no volume, V^eff ≤ 0.
        """
        if amplitude is not None:
            return self._secant(amplitude, loop).added(*self._loaded(theta, P1, P2)) + self.stiffness(
                theta, P1, P2, valves
            )
        theta, P1, P2 = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(theta)
        isobaric = agonist.stiffness(P1) + antagonist.stiffness(P2)
        if isinstance(valves, str) and valves == "open":  # the usual case
            return isobaric
        shares = StiffnessKind.of(valves).fixed
        if shares is None:
            return isobaric
        return isobaric + sum(s * k for s, k in zip(shares, self._trapped(theta, P1, P2, shares), strict=True) if s)

    def dynamic_stiffness(
        self,
        theta: ArrayLike,
        P1: ArrayLike,
        P2: ArrayLike,
        frequency: ArrayLike,
        lag: float | tuple[float, float],
        *,
        amplitude: float | None = None,
        loop: Loop | None = None,
        damping: float = 0.0,
    ) -> Value:
        """Return the complex stiffness [N·m/rad] against motions at a `frequency` [Hz]   (G4)

        Its real part stores energy, its imaginary part dissipates it. At 0 Hz it is the isobaric stiffness, far above
        1/(2π lag) the shut one. `lag` [s] is the regulators' time constant, or a pair of them; 0 keeps a pressure
        constant. An `amplitude` A [rad] adds the hysteresis K_h and i W/(π A²) (S1), a viscous `damping` D [N·m·s/rad]
        adds i 2π f D. Arguments broadcast. Raises InvalidInput as `stiffness`, and for a negative frequency, lag or
        damping.
        """
        if amplitude is not None:
            secant, state = self._secant(amplitude, loop), self._loaded(theta, P1, P2)
            hysteresis = secant.added(*state) + 1j * secant.work(*state) / (pi * secant.amplitude**2)
            return hysteresis + self.dynamic_stiffness(theta, P1, P2, frequency, lag, damping=damping)
        viscous = checks.not_negative("damping", damping, "N·m·s/rad")
        theta, P1, P2 = self._checked(theta, P1, P2)
        f, taus = trapped.frequencies(frequency), trapped.lags(lag)
        agonist, antagonist = self.sides(theta)
        K = agonist.stiffness(P1) + antagonist.stiffness(P2)
        gas = self._trapped(theta, P1, P2, (taus[0] > 0, taus[1] > 0), self.gas.exponent(f))
        return (
            K
            + sum(k * trapped.complex_share(f, tau) for k, tau in zip(gas, taus, strict=True))
            + (2j * pi * f * viscous)
        )

    def loop_work(
        self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, amplitude: Value, loop: Loop | None = None
    ) -> Value:
        """Return the work [J] dissipated by hysteresis per cycle of ±`amplitude` [rad]   (S1), (S2)

        `loop` is that of the joint by default. Raises InvalidInput as `stiffness`.
        """
        return self._secant(amplitude, loop).work(*self._loaded(theta, P1, P2))

    def loss_factor(
        self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, amplitude: float, loop: Loop | None = None
    ) -> Value:
        """Return η = W/(π K_felt A²) [-] of slow cycles of ±`amplitude` [rad] at constant pressures.

        `loop` is that of the joint by default. Raises InvalidInput as `stiffness`.
        """
        work = self.loop_work(theta, P1, P2, amplitude, loop)
        return loss_factor(work, self.stiffness(theta, P1, P2, amplitude=amplitude, loop=loop), amplitude)

    def _secant(self, amplitude: Value, loop: Loop | None) -> Secant:
        return (self.loop if loop is None else loop).secant(amplitude)

    def _loaded(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> tuple[Value, Value, Value]:
        """Return the arguments of the hysteresis: K [N·m/rad], a1 F1 + a2 F2 [N·m], P1 + P2 [Pa]."""
        at, one, two = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(at)
        K = agonist.stiffness(one) + antagonist.stiffness(two)
        return K, agonist.torque(one) - antagonist.torque(two), one + two

    def volumes(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> tuple[Value, Value]:
        """Return the volumes (V1, V2) [m³] of the gas in both muscles and their tubing   (G1)"""
        theta, P1, P2 = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(theta)
        return agonist.volume(P1), antagonist.volume(P2)

    def _trapped(self, theta: Value, P1: Value, P2: Value, shares: Shares, kappa: Value = None) -> tuple[Value, Value]:
        """Return the stiffness of both muscles' gas [N·m/rad], 0 for open valves   (G2)"""
        found = []
        for side, P, share in zip(self.sides(theta, (1.0, 1.0)), (P1, P2), shares, strict=True):
            if share:
                side.check_effective_volume(P)
            found.append(side.trapped(P, kappa) if share else 0.0)
        return found[0], found[1]

    def forces(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> tuple[Value, Value]:
        """Return the muscle forces (F1, F2) [N]; negative means slack."""
        theta, P1, P2 = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(theta)
        return agonist.force(P1), antagonist.force(P2)

    def jacobian(
        self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike
    ) -> tuple[tuple[Value, Value], tuple[Value, Value]]:
        """Return ((∂T/∂P1, ∂T/∂P2), (∂K/∂P1, ∂K/∂P2)) in [N·m/Pa] and [N·m/rad/Pa]; K is the isobaric stiffness."""
        theta, P1, P2 = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(theta)
        return (
            (agonist.torque_gain(P1), antagonist.torque_gain(P2)),
            (agonist.stiffness_gain(P1), antagonist.stiffness_gain(P2)),
        )

    def friction_torque(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, direction: Value) -> Value:
        """Return μ (a1 F1 + a2 F2) sign [N·m], the muscles' loss when θ rises (`direction` +1) or falls (-1).

        0 at rest. Quasi-static: it does not vanish at low speed. The link receives `torque` minus this.
        """
        theta, P1, P2 = self._checked(theta, P1, P2)
        agonist, antagonist = self.sides(theta)
        return self.friction * direction * (agonist.torque(P1) - antagonist.torque(P2))

    def _checked(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> tuple[Value, Value, Value]:
        P1, P2 = checks.pressures_or_symbols(P1, P2)
        return checks.fitting(theta=checks.angle_or_symbol("theta", theta), P1=P1, P2=P2)

    @property
    def loop(self) -> Loop:
        """Hysteresis of steady loops: the identified one, else Dahl's of `friction`."""
        if self.hysteresis is not None:
            slip = self.hysteresis.slip.with_gain
            return Loop(slip if slip.springs else None)
        return Loop(mu=self.friction)

    # --- limits -----------------------------------------------------------------------------------------------------

    @cached_property
    def angle_range(self) -> tuple[float, float]:
        """Angles [rad] allowed by end stops, mechanism and ε_i ≥ min_contraction; for a pulley by (25)."""
        ends = self.geometry.reach, self._threshold_angles, *([self.angle_limits] if self.angle_limits else ())
        return max(left for left, _ in ends), min(right for _, right in ends)

    @cached_property
    def _threshold_angles(self) -> tuple[float, float]:
        """Angles at which a muscle is stretched to min_contraction: agonist left, antagonist right   (25)"""
        return self.geometry.angles_at(self.min_contraction)

    def angle_limit(self, upper: bool) -> Limit:
        """Return which limit ends the angle range on the upper or lower side."""
        binds = self.angle_range[upper] == self._threshold_angles[upper]
        return Limit.CONTRACTION_THRESHOLD if binds else Limit.JOINT_RANGE

    def outside_range(self, theta: Array) -> NDArray[np.int32]:
        """Return the `Limit` of the joint range that `theta` [rad] exceeds, else 0, in the shape of `theta`."""
        left, right = self.angle_range
        below, above = (np.int32(self.angle_limit(upper)) for upper in (False, True))
        return np.where(theta < left, below, np.where(theta > right, above, np.int32(0)))

    @property
    def slack_assumed(self) -> bool:
        """Whether the forces, hence the pressures at which cables go slack, are assumed rather than identified.

        Quantities that equilibria do not reveal change neither torque nor stiffness at any angle.
        """
        return bool({COMMON_FORCE, PRIOR_FORCE} & set(self.unseen))

    @property
    def pressure_span(self) -> float:
        """Width of the supply range [Pa]; tolerances are given in fractions of it."""
        return self.pressure_limits[1] - self.pressure_limits[0]

    def pressure_box(self, theta: ArrayLike, limits: Limits = TAUT) -> PressureBox:
        """Return the pressures allowed at `theta` by supply, validity of the model and `limits`.

        Since force grows with pressure every limit bounds one pressure: the feasible set is a box. A slew limit is
        hard: from outside the other limits the box shrinks to the nearest pressure within reach.
        """
        return self.box(np.asarray(theta, float), limits)

    def box(self, theta: Array, limits: Limits = TAUT, shares: Shares | None = None) -> PressureBox:
        """Return the pressures allowed at `theta` (n,) by supply, model and `limits`, see `pressure_box`.

        With `shares` of the trapped gas the model is valid while its volume is plausible, see `OneMuscle.interval`.
        """
        agonist, antagonist = (side.interval(self.pressure_limits, limits) for side in self.sides(theta, shares))
        box = PressureBox(agonist, antagonist)
        if limits.min_cocontraction is None:
            return box
        return box.with_least_sum(np.full(theta.shape, 2 * limits.min_cocontraction))

    # --- equilibrium ------------------------------------------------------------------------------------------------

    def equilibrium(
        self,
        P1: ArrayLike,
        P2: ArrayLike,
        T: ArrayLike = 0.0,
        *,
        history: tuple[ArrayLike, ArrayLike] | None = None,
        gravity: Gravity = NO_GRAVITY,
    ) -> Array:
        """Return the stable (K > 0) angle [rad] with the torque `T` [N·m], and `gravity`, at these pressures.

        NaN if there is none in the joint range; the one nearest to θ = 0 if a mechanism has several. Closed form (23),
        generalised to c ≠ 0 and T ≠ 0, for two equal Tondu2021 on a pulley; root finding otherwise.

        With a `history` of earlier pressures (P1, P2) [Pa], rows (n,) in order, it is the angle after them, with the
        joint's `hysteresis`, or else its `friction` μ (Dahl's, see `allocator.joint.hysteresis`). The history starts at
        rest, without memory. P1 and P2, numbers or rows (m,), continue it in order; `T` is one number. With empty rows
        it begins with P1, P2. Gravity does not go with a history.
        """
        if history is not None:
            if gravity.torque:
                raise InvalidInput("equilibrium: gravity does not go with a history")
            return after_history(self, history, P1, P2, checks.number("T", T, "N·m"))
        one, two = checks.pressures_or_symbols(P1, P2)
        flat = checks.broadcast(P1=one, P2=two, T=checks.real("T", T, "N·m"))
        closed = None if gravity.torque else self.tondu_pulley
        theta = closed.equilibrium(*flat) if closed else nearest_equilibrium(self, gravity, *flat)
        left, right = self.angle_range
        return np.asarray(np.where((theta >= left) & (theta <= right), theta, np.nan))

    @property
    def affine(self) -> bool:
        """Whether both muscles, hence torque and stiffness in any geometry, are affine in pressure."""
        return isinstance(self.agonist, AffineMuscle) and isinstance(self.antagonist, AffineMuscle)

    @cached_property
    def tondu_pulley(self) -> TonduPulley | None:
        """Closed forms of the report's joint, two equal Tondu2021 on a pulley, if this is one."""
        muscle, geometry = self.agonist, self.geometry
        if not (isinstance(muscle, Tondu2021) and muscle.same_law(self.antagonist) and isinstance(geometry, Pulley)):
            return None
        return TonduPulley(muscle, geometry) if geometry.initial_contraction > 0 else None


def _known(unseen: object) -> tuple[str, ...]:
    """Return the unidentified quantities as a tuple. Raises InvalidInput unless all are in `UNSEEN`."""
    entries = tuple(unseen) if isinstance(unseen, tuple | list) else (unseen,)
    if wrong := [entry for entry in entries if entry not in UNSEEN]:
        raise InvalidInput(f"unseen has no {wrong[0]!r}; it may have {' or '.join(map(repr, UNSEEN))}")
    return entries


@cache
def report_joint(muscle: Muscle = TONDU_DMSP_20_400N) -> AntagonistJoint:
    """Return the report's joint, or one with other muscles: R = 2 cm, l0 = 40 cm, ε0 = .1375, 0–5 bar, ±125°

    Tondu 2021, (24) and (25); its muscles are Tondu2021 DMSP-20-400N.
    """
    pulley = Pulley(rest_length=0.40, radius=0.02, initial_contraction=0.1375)
    return AntagonistJoint(pulley, muscle, muscle, angle_limits=(-125 * DEG, 125 * DEG))


def joint_or_report(joint: object) -> AntagonistJoint:
    """Return `joint`, or the report's for None. Raises InvalidInput for a machine of another kind."""
    if joint is None:
        return report_joint()
    if not isinstance(joint, AntagonistJoint):
        getattr(joint, "sides", None)  # a joint without a force scale raises its own message
        raise InvalidInput(f"joint = {checks.brief(joint)} has to be an AntagonistJoint")
    return joint
