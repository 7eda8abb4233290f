"""Hysteresis of a joint by Maxwell slip: friction with a memory of the angles at which the joint reversed.

    T_f = s Σ k_i e_i,   de_i = dθ while |e_i| < ρ_i, 0 while it slips,   ρ_i = r_i (s_0 + (1 - s_0) (P1 + P2)/5 bar)

Each element is a spring k_i in series with a slider: a stop operator of the angle (θ - e_i is a play operator), so that
Σ k_i e_i is a Prandtl–Ishlinskii operator. It depends on the angles of reversal, not on time, and remembers every
reversal that no greater one has erased; Dahl's single state remembers none. The widths are affine in the co-contraction
P1 + P2, which loads the sliding surfaces even if a muscle is slack; they do not depend on the pull of the muscles.

With springs of their own, s = 1, no change of pressure feeds energy into the joint: T_f is passive. With springs that
are shares of the muscles' stiffness, s = K(θ, P1, P2), it is hysteresis of the *angle* to first order: a joint at rest
at θ = H[θ_s], θ_s being the equilibrium of its muscles alone, has the torque T(θ) = T_f with

    T_f = T(θ) - T(H⁻¹[θ]) ≈ K (H⁻¹[θ] - θ),   H⁻¹[θ] = θ + Σ k_i e_i

because the inverse of a Prandtl–Ishlinskii operator H is such a sum of stops, in closed form. An element of infinite
width never slips; it is a gain, e = θ.

While θ turns in one direction, e_i = clip(e_i + Δθ, ±ρ_i) exactly, for any distance: no differential equation has to be
integrated, and the only error of a simulation is the motion within the fine step in which the joint reverses.

P. Krejčí & K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. Control Theory Appl. 148 (2001)
185–192; F. Al-Bender, V. Lampaert & J. Swevers, "The generalized Maxwell-slip model: a novel model for friction
simulation and compensation", IEEE Trans. Autom. Control 50 (2005) 1883–1887, without terms that depend on speed.
"""

from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value, is_symbol
from allocator.errors import InvalidInput
from allocator.joint.felt import Loop
from allocator.joint.hysteresis import NO_GAIN, PrandtlIshlinskii, Slip
from allocator.units import DEG
from mpc.model.friction.contact import Hysteresis, Loads
from mpc.model.friction.dahl import WIDTH_AT, Friction, torque_of_width
from mpc.model.machine import Machine
from mpc.model.plant import Plant

_PRESLIDING = tuple(r * DEG for r in (0.5, 1.0, 2.0, 4.0))  # r_i [rad], of elements that carry the same torque: they
# turn round on average within r_i as Dahl's model does within δ, which a measured lever joint of McKibben muscles puts
# at 0.5° in slow sweeps and at 3.2° in a log of random steps
_BASE = 0.2  # s_0 [-]: as K is nearly proportional to P1 + P2, loops stay about as wide in degrees, as measured ones do


@dataclass(frozen=True)
class MaxwellSlip:
    """Parameters of the elements of Maxwell slip."""

    springs: tuple[float, ...]  # k_i [N·m/rad]; `elastic`: [-] of the stiffness K
    widths: tuple[float, ...]  # r_i, half widths of the plays at P1 + P2 = 5 bar [rad]; inf: never slips
    base: float = _BASE  # s_0 [-], remaining share of the widths without pressure
    elastic: bool = False  # whether the springs are shares of the muscles' stiffness

    def __post_init__(self) -> None:
        """Check the parameters."""
        for name in ("springs", "widths"):
            object.__setattr__(self, name, tuple(float(v) for v in getattr(self, name)))
        if len(self.springs) != len(self.widths):
            raise InvalidInput(f"{len(self.springs)} springs and {len(self.widths)} widths: an element has one of each")
        if not (self.springs and all(isfinite(k) and k > (-1 if r == inf else 0) for k, r in self._elements)):
            unit = "-" if self.elastic else "N·m/rad"
            raise InvalidInput(f"springs = {self.springs} {unit} have to be positive and finite, one for each element")
        if not all(r > 0 and (r < inf or self.elastic) for r in self.widths):
            raise InvalidInput(f"widths = {self.widths} rad have to be positive and finite, one for each element")
        if not 0 < self.base <= 1:
            raise InvalidInput(f"base = {self.base!r} has to be above 0, and 1 at most")

    @classmethod
    def of_width(
        cls,
        plant: Machine,
        width: float,
        presliding: tuple[float, ...] = _PRESLIDING,
        base: float = _BASE,
        joint: int = 0,
    ) -> Self:
        """Return elements with a loop `width` [rad] in slow sweeps at θ = 0, P1 + P2 = 5 bar: 2 T_f = K width.

        The elements of half widths `presliding` [rad] carry equal shares of the torque there. The `joint` of an arm is
        that of `Friction.of_width`.
        """
        share = torque_of_width(plant, width, joint) / len(presliding)
        return cls(tuple(share / r for r in presliding), presliding, base)

    @classmethod
    def of(cls, operator: PrandtlIshlinskii) -> Self:
        """Return the elements for a joint with the hysteresis `operator`, with springs in proportion to the stiffness,
        or of their own if the operator has a stiffness.

        A gain of the operator other than 1 becomes an element that never slips. Raises `InvalidInput` if there are no
        elements, or if a weight is negative.
        """
        slip = operator.slip.with_gain
        if not slip.springs:
            raise InvalidInput("this PrandtlIshlinskii has neither plays nor a gain: use `Friction()` for no friction")
        return cls(slip.springs, slip.widths, slip.base, elastic=slip.elastic)

    @property
    def size(self) -> int:
        """Size of the memory: e_i [rad] of each element."""
        return len(self.widths)

    @property
    def _elements(self) -> list[tuple[float, float]]:
        return list(zip(self.springs, self.widths, strict=True))

    @property
    def absent(self) -> bool:
        """Whether there is no friction: never, `Friction()` stands for none."""
        return False

    @property
    def summary(self) -> str:
        """Short description."""
        what = "hysteresis of the angle" if self.elastic else "Maxwell slip"
        return f"{what} with {self.size} element{'s' * (self.size > 1)}"

    def begun(self, theta: float) -> Array:
        """Return the e_i (n,) [rad] of a joint that has not moved from `theta` [rad]."""
        return np.where(np.isinf(self.widths), theta, 0.0)

    def scale(self, filled: Value) -> Value:
        """Return ρ_i/r_i [-] where P1 + P2 = `filled` [Pa]."""
        return self.base + (1 - self.base) * filled / (2 * WIDTH_AT)

    def most(self, contact: Loads) -> Value:
        """Return s Σ k_i ρ_i [N·m], the torque when all elements of finite width slip."""
        slips = sum(k * r for k, r in self._elements if r < inf)
        return self.strength(contact) * slips * self.scale(contact.filled)

    def moved(self, memory: Value, motion: Value, contact: Loads) -> Value:
        """Return the e_i (n,) [rad] after turning by `motion` [rad] in one direction, numbers or CasADi symbols."""
        if is_symbol(motion):
            import casadi as ca

            width = self.scale(contact.filled) * ca.DM(self.widths)
            return ca.fmin(ca.fmax(memory + motion, -width), width)
        width = self.scale(contact.filled) * np.array(self.widths)
        return np.minimum(np.maximum(memory + motion, -width), width)

    def along(self, memory: Array, theta: Array, contact: Loads) -> Array:
        """Return the e_i (n, elements) [rad] at the angles `theta` (n,) [rad], from `memory` at the first."""
        motions = np.diff(theta).tolist()  # plain numbers are faster than arrays for a short preview
        states = []
        for e, width in zip(memory.tolist(), (self.scale(contact.filled) * r for r in self.widths), strict=True):
            way = [e]
            for motion in motions:
                e = min(max(e + motion, -width), width)
                way.append(e)
            states.append(way)
        return np.array(states).T

    def torque(self, memory: Value, contact: Loads) -> Value:
        """Return T_f [N·m] of the e_i, numbers (..., n) or CasADi symbols (n,)."""
        if is_symbol(memory):
            import casadi as ca

            return self.strength(contact) * ca.dot(ca.DM(self.springs), memory)
        return self.strength(contact) * (memory @ np.array(self.springs))

    def share(self, share: float) -> Self:
        """Return the same model with a `share` [-] of its torque. Raises `InvalidInput`."""
        share = checks.not_negative("share", share, "-")
        return replace(self, springs=tuple(share * k for k in self.springs))

    def strength(self, contact: Loads) -> Value:
        """Return s [N·m/rad] or [-], the factor of Σ k_i e_i."""
        return contact.stiffness if self.elastic else 1.0

    @property
    def loop(self) -> Loop:
        """Steady loops of the model, see `allocator.joint.felt`."""
        return Loop(Slip(self.springs, self.widths, self.base, elastic=self.elastic))

    def as_dahl(self, plant: Plant) -> Friction:
        """Return Dahl's friction with the same loop width at θ = 0, P1 + P2 = 5 bar, as found without this model."""
        contact = Loads.of(plant, np.array([0.0, 0.0, WIDTH_AT, WIDTH_AT]))
        return Friction.of_width(plant, float(2 * self.most(contact) / contact.stiffness))


def friction_of(given: object) -> Hysteresis:
    """Return the friction model `given`; for a `PrandtlIshlinskii`, `MaxwellSlip.of` it or no friction.

    Raises `InvalidInput` for anything else.
    """
    if isinstance(given, PrandtlIshlinskii):
        return MaxwellSlip.of(given) if given.size or abs(given.gain - 1) > NO_GAIN else Friction()
    if isinstance(given, type) or not isinstance(given, Hysteresis):
        raise InvalidInput(f"friction = {given!r} has to be a Friction, a MaxwellSlip or a PrandtlIshlinskii")
    return given
