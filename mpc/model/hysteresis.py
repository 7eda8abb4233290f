"""Hysteresis of the joint is modelled by Maxwell slip: friction of another structure than what controllers are told,
Dahl's.

    T_f = Σ k_i e_i,   de_i = dθ while |e_i| < ρ_i, 0 while it slips,   ρ_i = r_i (s_0 + (1 - s_0) (P1 + P2)/5 bar)

Each element is a spring k_i in series with a slider: a stop operator of the angle (θ - e_i is a play operator), so that
T_f is a Prandtl–Ishlinskii operator. It depends on where the joint turned round, not on time, and remembers every turn
that no greater one has wiped out; Dahl's single state remembers none. The widths are affine in the co-contraction
P1 + P2, which presses on what rubs, also where a muscle is slack; they do not know the pull of the muscles. As the k_i
are constant, no change of pressure feeds energy into the joint: T_f is passive.

While θ turns in one direction, e_i = clip(e_i + Δθ, ±ρ_i) exactly, however long the way: no differential equation has
to be integrated, and a simulation errs only by what the joint moves on in the fine step in which it turns round.

P. Krejčí & K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. Control Theory Appl. 148
(2001) 185–192; F. Al-Bender, V. Lampaert & J. Swevers, "The generalized Maxwell-slip model: a novel model for friction
simulation and compensation", IEEE Trans. Autom. Control 50 (2005) 1883–1887, here without what depends on speed.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from allocator.calculus import Value
from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc.model.friction import WIDTH_AT, Contact, Friction, torque_of_width
from mpc.model.plant import Plant

_PRESLIDING = tuple(r * DEG for r in (0.5, 1.0, 2.0, 4.0))  # r_i [rad], of elements that carry the same torque: they
# turn round on average within r_i as Dahl's model does within δ, which a measured lever joint of McKibben muscles puts
# at 0.5° in slow sweeps and at 3.2° in a log of random steps
_BASE = 0.2  # s_0 [-]: as K is nearly proportional to P1 + P2, loops stay about as wide in degrees, as measured ones do


@dataclass(frozen=True)
class MaxwellSlip:
    """Maxwell slip is described by the parameters of its elements."""

    springs: tuple[float, ...]  # k_i [N·m/rad]
    widths: tuple[float, ...]  # r_i, half widths of the plays where P1 + P2 = 5 bar [rad]
    base: float = _BASE  # s_0 [-], share of the widths that is left without pressure

    def __post_init__(self) -> None:
        """Check the parameters."""
        for name, unit in (("springs", "N·m/rad"), ("widths", "rad")):
            values = tuple(float(v) for v in getattr(self, name))
            if not (values and all(np.isfinite(v) and v > 0 for v in values)):
                raise InvalidInput(f"{name} = {values} {unit} have to be positive and finite, one for each element")
            object.__setattr__(self, name, values)
        if len(self.springs) != len(self.widths):
            raise InvalidInput(f"{len(self.springs)} springs and {len(self.widths)} widths: an element has one of each")
        if not 0 < self.base <= 1:
            raise InvalidInput(f"base = {self.base!r} has to be above 0, and 1 at most")

    @classmethod
    def of_width(
        cls, plant: Plant, width: float, presliding: tuple[float, ...] = _PRESLIDING, base: float = _BASE
    ) -> Self:
        """Make elements with a loop `width` [rad] wide in slow sweeps at θ = 0, P1 + P2 = 5 bar: 2 T_f = K width.

        The elements of half widths `presliding` [rad] carry equal shares of the torque there.
        """
        share = torque_of_width(plant, width) / len(presliding)
        return cls(tuple(share / r for r in presliding), presliding, base)

    @property
    def size(self) -> int:
        """Return how many numbers it remembers: e_i [rad] of each element."""
        return len(self.widths)

    def scale(self, filled: Value) -> Value:
        """Return ρ_i/r_i [-] where P1 + P2 = `filled` [Pa]."""
        return self.base + (1 - self.base) * filled / (2 * WIDTH_AT)

    def most(self, contact: Contact) -> Value:
        """Return Σ k_i ρ_i [N·m], the torque when all elements slip."""
        return sum(k * r for k, r in zip(self.springs, self.widths, strict=True)) * self.scale(contact.filled)

    def moved(self, memory: Value, motion: Value, contact: Contact) -> Value:
        """Return the e_i (n,) [rad] after turning by `motion` [rad] in one direction, CasADi symbols."""
        import casadi as ca

        width = self.scale(contact.filled) * ca.DM(self.widths)
        return ca.fmin(ca.fmax(memory + motion, -width), width)

    def torque(self, memory: Value, contact: Contact) -> Value:
        """Return T_f [N·m] of the e_i (n,), CasADi symbols."""
        import casadi as ca

        return ca.dot(ca.DM(self.springs), memory)

    def as_dahl(self, plant: Plant) -> Friction:
        """Return Dahl's friction with a loop as wide at θ = 0, P1 + P2 = 5 bar: all that is found without this one."""
        x = np.array([0.0, 0.0, WIDTH_AT, WIDTH_AT])
        full = self.most(Contact(pulled=np.nan, filled=2 * WIDTH_AT))
        return Friction.of_width(plant, float(2 * full / plant.stiffness(x)))


__all__ = ["MaxwellSlip"]
