"""Gas trapped in the muscles, and its contribution to the joint's stiffness.

While a valve is shut, (P + p_a) V^κ is constant. With the torque gain g_i = ∂T/∂P_i of muscle i and its volume V_i
(`Muscle.volume`) the joint then has, beyond the isobaric stiffness K = -∂T/∂θ |P,

    K_shut = K + Σ_i shut κ (P_i + p_a) g_i²/V_i^eff,    V^eff = V + κ (P + p_a) ∂V/∂P |ε                         (G2)

A regulator with a first-order lag τ_i keeps its pressure in slow motions and traps the gas in quick ones. The complex
stiffness against small motions at the frequency f, s = 2πi f, is

    K(s) = K + Σ_i κ (P_i + p_a) g_i²/V_i^eff · s τ_i/(1 + s τ_i)                                                 (G4)

Its real part, the *storage* stiffness, has the shares s_i of the trapped gas,

    K_f = K + Σ_i s_i κ (P_i + p_a) g_i²/V_i^eff,    s_i = (2πfτ_i)²/(1 + (2πfτ_i)²)                              (G5)

s_i = 0 is an open valve, s_i = 1 a shut one. Proof of (G2): by V_ε = L F_P a turn dθ changes the volume of muscle i by
g_i dθ; with dP/(P + p_a) = -κ dV/V its pressure changes by -κ (P + p_a) g_i dθ/V^eff, and the torque by g_i times that.

Slow motions leave the gas time to exchange heat with the muscle's wall: it is isothermal far below a corner frequency
f_c, and adiabatic far above. With the thermal time constant t = 1/(2π f_c) the exponent of small motions is

    κ(s) = (1 + κ s t)/(1 + s t)                                                                                  (G6)

(heat balance m c_v T' = -P V' - (m c_v/t)(T - T_wall), linearised; A. Pourmovahed & D. R. Otis, "An experimental
thermal time-constant correlation for hydraulic accumulators", J. Dyn. Syst. Meas. Control 112 (1990) 116-121). In a
tube of radius r the slowest mode of diffusion, with the diffusivity α = 2.1e-5 m²/s at 1 bar (absolute), falling with
the pressure, gives f_c = κ (2.405/r)² α/(2π): `thermal_corner`, 0.03 … 0.08 Hz for 26 mm at 1 … 4 bar.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.felt import Loop, Secant, checked_amplitude
from allocator.units import BAR, DEG

if TYPE_CHECKING:
    from allocator.mechanism.endpoint import Endpoint

_KAPPA = 1.0, 1.67  # isothermal, and adiabatic of a monatomic gas
_ATMOSPHERE = 1e3, 2e6  # [Pa] around a joint
_HIGHEST_CORNER = 100.0  # [Hz], of a tube of less than 1 mm
_AIR_KAPPA = 1.4
_DIFFUSIVITY, _MODE = 2.1e-5, 2.4048  # α of air at 1 bar absolute, 20 °C [m²/s]; first zero of J_0
_FASTEST = 1e9  # [Hz] higher frequencies are refused
_SLOWEST = 100.0  # [s] a longer lag is in milliseconds

Shares = tuple[Value, ...]
"""How much of the trapped gas of each muscle a stiffness has in it, s_i of (G5) [-]: of (agonist, antagonist), …"""

Valves = Literal["open", "shut", "free"] | tuple[bool, ...]
"""The valves of all muscles, or whether each is shut, such as (agonist, antagonist); "free": whichever are best."""

PAIR = ("agonist", "antagonist")


@dataclass(frozen=True)
class Gas:
    """Gas in the muscles: (P + p_a) V^κ is constant while it is trapped."""

    kappa: float = 1.3  # κ [-]: 1 isothermal (slow), 1.4 adiabatic (air, fast), 1.3 usual for motions of a second
    atmosphere: float = 101_325.0  # p_a, absolute pressure around the joint [Pa]
    corner: float | None = None  # f_c [Hz] below which motions are isothermal; None: κ at all frequencies   (G6)

    def __post_init__(self) -> None:
        """Check the numbers."""
        kappa = checks.number("Gas: kappa", self.kappa, "-")
        if not _KAPPA[0] <= kappa <= _KAPPA[1]:
            raise InvalidInput(
                f"Gas: kappa = {kappa:g} has to lie between 1 (isothermal) and 1.67; for air 1.4 is adiabatic"
            )
        atmosphere = float(checks.pressure("Gas: atmosphere", checks.number("Gas: atmosphere", self.atmosphere, "Pa")))
        if not _ATMOSPHERE[0] <= atmosphere <= _ATMOSPHERE[1]:
            raise InvalidInput(
                f"Gas: atmosphere = {atmosphere:g} Pa has to be the absolute pressure around the joint, such as 101325"
            )
        object.__setattr__(self, "kappa", kappa)
        object.__setattr__(self, "atmosphere", atmosphere)
        if self.corner is not None:
            corner = checks.number("Gas: corner", self.corner, "Hz")
            if not 0 < corner <= _HIGHEST_CORNER:
                raise InvalidInput(
                    f"Gas: corner = {corner:g} Hz has to be positive and at most {_HIGHEST_CORNER:g} Hz, such as 0.04"
                )
            object.__setattr__(self, "corner", corner)

    def exponent(self, frequency: Value) -> Value:
        """Return the complex exponent κ(s) [-] of small motions at the frequencies [Hz]; κ without a corner   (G6)"""
        if self.corner is None:
            return self.kappa
        s = 1j * frequency / self.corner
        return (1 + self.kappa * s) / (1 + s)


def thermal_corner(radius: float, pressure: ArrayLike) -> Value:
    """Return the corner f_c [Hz] of air in a tube of `radius` [m] at a gauge `pressure` [Pa]   (G6)

    At sea level, with κ = 1.4, the exponent to use with a corner. It includes only the slowest mode of diffusion: κ(s)
    is within 0.12 of that of all modes. Raises `InvalidInput`.
    """
    r = checks.number("radius", radius, "m")
    if not 0 < r < 1:
        raise InvalidInput(f"radius = {r:g} m is no muscle's radius")
    diffusivity = _DIFFUSIVITY * BAR / (checks.pressure("pressure", pressure) + AIR.atmosphere)
    return _AIR_KAPPA * (_MODE / r) ** 2 * diffusivity / (2 * pi)


AIR = Gas()
"""Air between isothermal and adiabatic, at sea level."""


@dataclass(frozen=True)
class StiffnessKind:
    """Kind of stiffness: isobaric, shut, or at a frequency, each with or without the hysteresis of a push."""

    name: str  # the adjective: "isobaric", "shut", …
    shares: tuple[float, ...] | None  # s_i of (G5), one per muscle; None: those of the best state of the valves
    frequency: float | None = None  # [Hz] of motions against regulators; None: valves are open or shut
    amplitude: float | None = None  # A [rad] of a push, which adds hysteresis (S3); None: without hysteresis
    loop: Loop | tuple[Loop, ...] | None = None  # the hysteresis, of a mechanism that of each joint; None: the joint's
    lags: tuple[float, ...] = ()  # τ_i of the regulators [s], with a frequency
    free: ClassVar[tuple[tuple[float, float], ...]] = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))
    """The four states that two free valves may have; the open ones come first."""

    @classmethod
    def of(
        cls, valves: object = "open", frequency: object = None, lag: object = None, muscles: Sequence[str] = PAIR
    ) -> Self:
        """Return the kind of these arguments of `allocate`, for `muscles` of these names.

        Only the valves of a pair may be "free". Raises InvalidInput for invalid arguments.
        """
        if frequency is None and lag is None:
            if not isinstance(valves, cls):
                return cls._of_valves(valves, tuple(muscles))
            if valves.shares is not None and len(valves.shares) != len(muscles):
                raise InvalidInput(
                    f"valves = {checks.brief(valves)} are of {len(valves.shares)} muscles, not {len(muscles)}"
                )
            return valves
        if frequency is None or lag is None:
            raise InvalidInput("frequency [Hz] and lag [s] go together; one came without the other")
        if not (isinstance(valves, str) and valves == "open"):
            raise InvalidInput(
                "valves and frequency exclude each other: a regulator with a lag is neither open nor shut"
            )
        taus = lags(lag, len(muscles))
        f = float(frequencies(checks.number("frequency", frequency, "Hz")))
        if f == 0:
            return cls("isobaric", (0.0,) * len(taus))
        return cls("dynamic", tuple(float(storage_share(f, tau)) for tau in taus), f, lags=taus)

    def of_gas(self, gas: Gas | None, affine: bool) -> Self:
        """Return the kind with the shares of this `gas`, Re[κ(s)/κ s τ/(1 + s τ)], if it has a corner   (G6)

        Raises InvalidInput if muscles are not `affine` in the pressure: their V^eff depends on κ.
        """
        if gas is None or gas.corner is None or self.frequency is None or not self.lags:
            return self
        if not affine:
            raise InvalidInput(
                "the corner of the gas is known to stiffnesses at a frequency of muscles affine in the pressure only; "
                "leave out corner and say kappa at this frequency, or read the joint's dynamic_stiffness"
            )
        warmed = gas.exponent(self.frequency) / gas.kappa
        shares = tuple(float((warmed * complex_share(self.frequency, tau)).real) for tau in self.lags)
        return replace(self, shares=shares)

    @classmethod
    def _of_valves(cls, valves: object, muscles: tuple[str, ...]) -> Self:
        m = len(muscles)
        known = {"open": cls("isobaric", (0.0,) * m), "shut": cls("shut", (1.0,) * m)}
        known |= {"free": cls("free-valve", None)} if muscles == PAIR else {}
        if isinstance(valves, str) and valves in known:
            return known[valves]
        if (
            isinstance(valves, tuple | list)
            and len(valves) == m
            and all(isinstance(v, bool | np.bool_) for v in valves)
        ):
            if len(set(map(bool, valves))) == 1:
                return known["shut" if valves[0] else "open"]
            shut = [muscle for muscle, v in zip(muscles, valves, strict=True) if v]
            return cls(f"{' and '.join(shut)}-shut", tuple(map(float, valves)))
        each = (
            "'free' or (True, False): whether the agonist's, the antagonist's valve is shut"
            if muscles == PAIR
            else f"or m = {m} truth values: whether the valve of each muscle is shut"
        )
        raise InvalidInput(f"valves = {checks.brief(valves)} is unknown; choose 'open', 'shut', {each}")

    @property
    def text(self) -> str:
        """Name: "isobaric stiffness", "shut stiffness", "dynamic stiffness at 2 Hz", …"""
        at = "" if self.frequency is None else f" at {self.frequency:g} Hz"
        by = "" if self.amplitude is None else f" felt by ±{self.amplitude / DEG:.4g}°"
        return f"{self.name} stiffness{at}{by}"

    @property
    def held(self) -> bool:
        """Whether it excludes gas: pressures are constant."""
        return self.shares is not None and not any(self.shares)

    @property
    def isobaric(self) -> bool:
        """Whether it excludes gas and hysteresis."""
        return self.held and self.amplitude is None

    def secant(self, own: Loop) -> Secant | None:
        """Return its hysteresis, for a joint with the `own` loop; None if it excludes hysteresis."""
        loops = self.loop if isinstance(self.loop, tuple) else (own if self.loop is None else self.loop,)
        if len(loops) != 1:
            raise InvalidInput(f"a joint of two muscles has one loop of hysteresis, not {len(loops)}")
        return None if self.amplitude is None else loops[0].secant(self.amplitude)

    def added(self, n: int) -> Array | None:
        """Return the K_h(A) [N·m/rad] of each of the `n` joints of a mechanism; None if it excludes hysteresis.

        Raises `InvalidInput` without a loop, for another number of them, and if one depends on pressures or K.
        """
        if self.amplitude is None:
            return None
        if self.loop is None:
            raise InvalidInput(
                "a mechanism has no hysteresis of its own; give loop with the amplitude, one for each joint"
            )
        loops = self.loop if isinstance(self.loop, tuple) else (self.loop,)
        loops = loops * n if len(loops) == 1 else loops
        if len(loops) != n:
            raise InvalidInput(f"{len(loops)} loops of hysteresis for n = {n} joints; give one for each")
        terms = [loop.secant(self.amplitude).separable for loop in loops]
        if any(term is None or term[0] or term[1] for term in terms):
            raise InvalidInput(
                "the hysteresis of a mechanism's joints must not depend on the pressures: `coulomb` without `mu`, or "
                "separate springs with widths of base = 1"
            )
        return np.array([own for term in terms if term is not None for own in term[2:]])

    @property
    def states(self) -> "tuple[StiffnessKind, ...]":
        """Kinds of stiffness to choose from: four for free valves, else this one."""
        if self.shares is not None:
            return (self,)
        return tuple(
            replace(StiffnessKind.of((one == 1, two == 1)), amplitude=self.amplitude, loop=self.loop)
            for one, two in self.free
        )

    @property
    def fixed(self) -> Shares | None:
        """Shares, None for isobaric stiffness. Raises InvalidInput for free valves."""
        if self.shares is None:
            raise InvalidInput("valves='free' is for `allocate`, maps and intervals only; give a state of the valves")
        return None if self.held else self.shares


HELD = StiffnessKind.of()
"""The isobaric stiffness: pressures are held."""


@dataclass(frozen=True)
class Stiffness:
    """Kind of stiffness that a target K refers to: constant pressures unless `valves` or `frequency` are given.

    With an `amplitude` it is the stiffness against a push by it, with the joint's hysteresis (S3); of a mechanism
    against pushes that move every joint by it. For a mechanism it may be that of a hand, K_x [N/m], while the hand
    exerts a force.
    """

    valves: object = "open"  # "open", "shut", whether each is shut, "free" (for a pair: the best state), or a kind
    frequency: float | None = None  # [Hz] of small motions against regulators: the real part of the dynamic stiffness
    lag: ArrayLike | None = None  # τ of the regulators [s], a number or one for each muscle; goes with the frequency
    tolerance: float = 0.0  # stiffnesses within this of K are equally good [N·m/rad]; for a pair
    endpoint: "Endpoint | None" = None  # the hand of the stiffness, instead of the joints
    force: ArrayLike = 0.0  # force of the hand (…, dim) [N]
    amplitude: float | None = None  # A [rad] of pushes by ±A, which adds hysteresis
    loop: Loop | Sequence[Loop] | None = None  # the hysteresis, of a mechanism that of each joint; None: the joint's

    def kind(self, muscles: Sequence[str] = PAIR) -> StiffnessKind:
        """Return the kind of stiffness of a machine with muscles of these names. Raises InvalidInput."""
        kind = StiffnessKind.of(self.valves, self.frequency, self.lag, muscles)
        if self.amplitude is not None:
            kind = replace(kind, amplitude=checked_amplitude(self.amplitude), loop=_checked(self.loop))
        elif self.loop is not None:
            raise InvalidInput("a loop of hysteresis goes with the amplitude of a push; one came without the other")
        return HELD if kind.isobaric and len(muscles) == 2 else kind


ISOBARIC = Stiffness()


def _checked(loop: object) -> Loop | tuple[Loop, ...] | None:
    """Return a loop, or a row of them. Raises `InvalidInput` for anything else."""
    loops = tuple(loop) if isinstance(loop, list | tuple) else (loop,)
    if loop is not None and not all(isinstance(one, Loop) for one in loops):
        raise InvalidInput(f"loop = {checks.brief(loop)} has to be a Loop, such as Loop(coulomb=0.5), or one per joint")
    return loops if isinstance(loop, list | tuple) else loop  # type: ignore[return-value]


def checked_gas(gas: object) -> None:
    """Raise InvalidInput unless this is a `Gas`."""
    if not isinstance(gas, Gas):
        raise InvalidInput(f"gas = {checks.brief(gas)} has to be a Gas, such as Gas(kappa=1.4)")


def checked_stiffness(stiffness: object) -> Stiffness:
    """Return `stiffness`. Raises InvalidInput unless it is a `Stiffness`."""
    if not isinstance(stiffness, Stiffness):
        raise InvalidInput(f"stiffness = {checks.brief(stiffness)} has to be a Stiffness, such as Stiffness('shut')")
    return stiffness


def of_a_joint(stiffness: object, gas: Gas, affine: bool) -> StiffnessKind:
    """Return the kind of stiffness of a joint with this gas. Raises InvalidInput, also for an endpoint."""
    given = checked_stiffness(stiffness)
    if given.endpoint is not None or np.any(given.force):
        raise InvalidInput("endpoint and force are of a Mechanism; a joint has no hand")
    return given.kind().of_gas(gas, affine)


def frequencies(frequency: object) -> Array:
    """Return checked frequencies [Hz], zero or more."""
    found = checks.real("frequency", frequency, "Hz")
    if (wrong := found < 0).any():
        raise InvalidInput(f"frequency{checks.at(found, wrong)} Hz is negative")
    if (wrong := found > _FASTEST).any():
        raise InvalidInput(f"frequency{checks.at(found, wrong)} Hz is none at which a joint moves, in hertz")
    return found


def lags(lag: object, muscles: int = 2) -> tuple[float, ...]:
    """Return the checked lags τ_i [s] of the regulators of all muscles, from one number or one each."""
    found = checks.real("lag", lag, "s")
    if found.shape not in ((), (muscles,)):
        each = "a pair" if muscles == 2 else f"m = {muscles}"
        raise InvalidInput(f"lag = {checks.brief(lag)} has to be one time constant or {each} of them [s]")
    if (wrong := found < 0).any():
        raise InvalidInput(f"lag{checks.at(found, wrong)} s is negative")
    if (wrong := found > _SLOWEST).any():
        raise InvalidInput(
            f"lag{checks.at(found, wrong)} s is no regulator's; if milliseconds were meant, divide by 1000"
        )
    return tuple(np.broadcast_to(found, muscles).tolist())


def storage_share(frequency: Value, lag: Value) -> Value:
    """Return s = (2πfτ)²/(1 + (2πfτ)²)   (G5)"""
    square = (2 * pi * frequency * lag) ** 2
    return square / (1 + square)


def complex_share(frequency: Value, lag: Value) -> Value:
    """Return s τ/(1 + s τ) at s = 2πi f   (G4)"""
    s = 2j * pi * frequency * lag
    return s / (1 + s)
