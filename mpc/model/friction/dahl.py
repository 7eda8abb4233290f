"""Hysteresis of a joint by friction that grows with the muscle forces, regularised by Dahl's model.

    T_f = T_max z,   T_max = μ (a1 F1 + a2 F2) + T_c,   z' = (ω - |ω| z)/δ

z ∈ [-1, 1] depends on the motion, not on time: it reverses within a few δ at any speed. Over a motion in one direction
s = ±1 it is z = s - (s - z_0) exp(-|Δθ|/δ), so that sampled motions need no integration. μ (a1 F1 + a2 F2) explains the
difference between up and down sweeps of measured joints; T_c is Coulomb friction of the bearing.

P. Dahl, "A solid friction model", Aerospace Corp. TOR-0158(3107-18), 1968; it is the Bouc–Wen model with n = 1, β = γ.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value, is_symbol
from allocator.joint.felt import Loop
from allocator.joint.hysteresis import PRESLIDING, dahl
from allocator.units import BAR
from mpc.model.friction.contact import Contacts, Loads
from mpc.model.machine import Machine
from mpc.model.plant import Plant

WIDTH_AT = 2.5 * BAR  # both pressures, at θ = 0, at which the width of the loop is defined


@dataclass(frozen=True)
class Friction:
    """Parameters of Dahl's friction."""

    mu: float = 0.0  # μ [-], share of the muscles' torques
    coulomb: float = 0.0  # T_c [N·m]
    presliding: float = PRESLIDING  # δ [rad]

    def __post_init__(self) -> None:
        """Check the parameters."""
        checks.not_negative("mu", self.mu, "-")
        checks.not_negative("coulomb", self.coulomb, "N·m")
        checks.positive("presliding", self.presliding, "rad")

    @classmethod
    def of_width(
        cls, plant: Machine, width: float, coulomb: float = 0.0, presliding: float = PRESLIDING, joint: int = 0
    ) -> "Friction":
        """Return friction with a loop `width` [rad] in slow sweeps at θ = 0, P1 + P2 = 5 bar: 2 T_f = K width.

        For an arm, the loop is that of a `joint`, counted from 0, in the middle of the ranges with 2.5 bar everywhere.
        """
        return cls(torque_of_width(plant, width, joint) / float(usual_loads(plant, joint).pulled), coulomb, presliding)

    @property
    def absent(self) -> bool:
        """Whether there is no friction."""
        return self.mu == 0 and self.coulomb == 0

    @property
    def size(self) -> int:
        """Size of the memory: z [-]."""
        return 1

    @property
    def summary(self) -> str:
        """Short description."""
        return f"Dahl's friction μ = {self.mu:.3g}" + f" and {self.coulomb:.3g} N·m" * bool(self.coulomb)

    def begun(self, theta: float) -> float:
        """Return z = 0 [-] for a joint that has not moved."""
        return 0.0

    def most(self, contact: Loads) -> Value:
        """Return T_max [N·m]."""
        return self.mu * contact.pulled + self.coulomb

    def moved(self, memory: Value, motion: Value, contact: Loads | None = None) -> Value:
        """Return z after turning by `motion` [rad] in one direction, a number or a CasADi symbol."""
        if is_symbol(motion):
            import casadi as ca

            s = ca.sign(motion)
            return s - (s - memory) * ca.exp(-ca.fabs(motion) / self.presliding)
        return dahl(memory, motion, self.presliding) if motion else memory

    def along(self, memory: float, theta: Array, contact: Loads | None = None) -> Array:
        """Return z (n,) at the angles `theta` (n,) [rad], from z = `memory` at the first."""
        states = [memory]
        for motion in np.diff(theta).tolist():
            states.append(dahl(states[-1], motion, self.presliding))
        return np.array(states)

    def torque(self, memory: Value, contact: Loads) -> Value:
        """Return T_f [N·m] of z, a number, an array or a CasADi symbol."""
        return self.most(contact) * memory

    def share(self, share: float) -> Self:
        """Return the same model with a `share` [-] of its torque. Raises `InvalidInput`."""
        share = checks.not_negative("share", share, "-")
        return replace(self, mu=share * self.mu, coulomb=share * self.coulomb)

    @property
    def loop(self) -> Loop:
        """Steady loops of the model, see `allocator.joint.felt`."""
        return Loop(None, self.mu, self.coulomb, self.presliding)

    def as_dahl(self, plant: Plant) -> "Friction":
        """Return the same model, which is Dahl's."""
        return self


def torque_of_width(plant: Machine, width: float, joint: int = 0) -> float:
    """Return T_f [N·m] of a loop `width` [rad] at θ = 0, P1 + P2 = 5 bar: K width/2. Raises `InvalidInput`."""
    return float(usual_loads(plant, joint).stiffness * checks.not_negative("width", width, "rad") / 2)


def usual_loads(plant: Machine, joint: int = 0) -> Loads:
    """Return the loads at which widths of loops are defined."""
    joint = checks.count("joint", joint, least=0, most=plant.n - 1)
    q = np.zeros(1) if isinstance(plant, Plant) else plant.middle
    return Contacts(plant)(np.concatenate([q, np.zeros(plant.n), np.full(plant.m, WIDTH_AT)]))[joint]
