"""Hysteresis of the joint is friction that grows with the muscle forces, regularised by Dahl's model.

    T_f = T_max z,   T_max = μ (a1 F1 + a2 F2) + T_c,   z' = (ω - |ω| z)/δ

z ∈ [-1, 1] follows the motion, not time: whatever the speed, it has turned round after a few δ. Over a motion in one
direction s = ±1 it is z = s - (s - z_0) exp(-|Δθ|/δ), so that sampled motions need no integration. μ (a1 F1 + a2 F2) is
what explains the difference between up and down sweeps of measured joints; T_c is Coulomb friction of the bearing.

P. Dahl, "A solid friction model", Aerospace Corp. TOR-0158(3107-18), 1968; it is the Bouc–Wen model with n = 1, β = γ.
"""

from dataclasses import dataclass
from math import copysign, exp
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.model.plant import Plant

WIDTH_AT = 2.5 * BAR  # both pressures, at θ = 0, for which the width of the loop is given


class Contact(NamedTuple):
    """A contact is what presses on that which rubs."""

    pulled: Value  # a1 F1 + a2 F2 of the taut muscles [N·m]
    filled: Value  # P1 + P2 [Pa]


@dataclass(frozen=True)
class Friction:
    """Friction is described by the parameters of its torque."""

    mu: float = 0.0  # μ [-], share of the muscles' torques
    coulomb: float = 0.0  # T_c [N·m]
    presliding: float = 0.5 * DEG  # δ [rad]

    def __post_init__(self) -> None:
        """Check the parameters."""
        for name, unit in (("mu", ""), ("coulomb", " N·m")):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InvalidInput(f"{name} = {value!r}{unit} has to be 0 or more, and finite")
        if not (np.isfinite(self.presliding) and self.presliding > 0):
            raise InvalidInput(f"presliding = {self.presliding!r} rad has to be positive and finite")

    @classmethod
    def of_width(cls, plant: Plant, width: float, coulomb: float = 0.0, presliding: float = 0.5 * DEG) -> "Friction":
        """Make friction with a loop `width` [rad] wide in slow sweeps at θ = 0, P1 + P2 = 5 bar: 2 T_f = K width."""
        x = np.array([0.0, 0.0, WIDTH_AT, WIDTH_AT])
        return cls(torque_of_width(plant, width) / float(pull(plant, x)), coulomb, presliding)

    @property
    def absent(self) -> bool:
        """Return whether there is none."""
        return self.mu == 0 and self.coulomb == 0

    def limit(self, pulled: Value) -> Value:
        """Return T_max [N·m] when the muscles pull with the torques a1 F1 + a2 F2 = `pulled` [N·m]."""
        return self.mu * pulled + self.coulomb

    def after(self, z: float, motion: float) -> float:
        """Return z after turning by `motion` [rad] in one direction."""
        s = copysign(1.0, motion)
        return s - (s - z) * exp(-abs(motion) / self.presliding)

    def along(self, z: float, theta: Array) -> Array:
        """Return z (n,) at the angles `theta` (n,) [rad], from `z` at the first."""
        states = [z]
        for motion in np.diff(theta).tolist():
            states.append(self.after(states[-1], motion))
        return np.array(states)

    # --- of a plant under test, as `mpc.model.hysteresis` has it too -------------------------------------------------

    @property
    def size(self) -> int:
        """Return how many numbers it remembers: z [-]."""
        return 1

    def most(self, contact: Contact) -> Value:
        """Return T_max [N·m]."""
        return self.limit(contact.pulled)

    def moved(self, memory: Value, motion: Value, contact: Contact) -> Value:
        """Return z (1,) after turning by `motion` [rad] in one direction, CasADi symbols."""
        import casadi as ca

        s = ca.sign(motion)
        return s - (s - memory) * ca.exp(-ca.fabs(motion) / self.presliding)

    def torque(self, memory: Value, contact: Contact) -> Value:
        """Return T_f [N·m] of z (1,), CasADi symbols."""
        return self.most(contact) * memory

    def as_dahl(self, plant: Plant) -> "Friction":
        """Return itself: it is Dahl's."""
        return self


def torque_of_width(plant: Plant, width: float) -> float:
    """Return T_f [N·m] of which a loop is `width` [rad] wide at θ = 0, P1 + P2 = 5 bar: K width/2."""
    return float(plant.stiffness(np.array([0.0, 0.0, WIDTH_AT, WIDTH_AT])) * width / 2)


def pull(plant: Plant, x: Value) -> Value:
    """Return a1 F1 + a2 F2 [N·m] in the state `x` [4, ...]: both torques against each other."""
    agonist, antagonist = plant.joint.sides(x[0])
    return agonist.torque(x[2]) - antagonist.torque(x[3])


__all__ = ["WIDTH_AT", "Contact", "Friction", "pull", "torque_of_width"]
