"""What is known of a joint beyond the nominal model is taken account of by observer and controllers alike.

The disturbance torque d is what remains besides. Observer and controller have to be given the same `Compensation`.
"""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from allocator import AntagonistJoint
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.model.contact import Contact, Hysteresis
from mpc.model.friction import Friction

SOFT = 0.02 * BAR  # over which the inverse of a dead band changes sides: noise must not make it jump
JITTER = 0.03 * DEG  # motions below are taken for noise of the angle


@dataclass(frozen=True)
class Compensation:
    """A compensation holds friction, dead time and dead band as far as they are known; by default there are none."""

    friction: Hysteresis = field(default_factory=Friction)
    dead_time: float = 0.0  # of the commands [s]
    dead_band: float = 0.0  # [Pa], total

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, unit in (("dead_time", "s"), ("dead_band", "Pa")):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InvalidInput(f"{name} = {value!r} {unit} has to be 0 or more, and finite")

    @classmethod
    def of(cls, joint: AntagonistJoint) -> Self:
        """Return what `allocator.fit_joint` found beyond the muscle laws: the joint's friction μ."""
        return cls(Friction(mu=joint.friction))

    def delay(self, dt: float) -> int:
        """Return the dead time in whole samples of `dt` [s]."""
        return round(self.dead_time / dt)

    def after_dead_band(self, u: Array, P: Array) -> Array:
        """Return the command [Pa] that moves a regulator without dead band as `u` moves this one at pressures P."""
        rest, e = self.dead_band / 2, u - P
        return P + e - np.clip(e, -rest, rest)

    def inverse_dead_band(self, v: Array, P: Array) -> Array:
        """Return what to command [Pa] for `v` to act: the inverse of `after_dead_band`, smooth where v passes P."""
        return np.asarray(v + self.dead_band / 2 * np.tanh((v - P) / SOFT))


class FrictionState:
    """A friction state is what friction remembers of the way of the angle."""

    def __init__(self, friction: Hysteresis) -> None:
        self.friction = friction
        self.memory: Value = friction.begun(0.0)
        self._theta: float | None = None

    def follow(self, theta: float, contact: Contact) -> Value:
        """Return the memory at the angle `theta` [rad], to which the joint has turned from that of the last call, and
        in `contact`.
        """
        if self._theta is None:
            self._theta, self.memory = theta, self.friction.begun(theta)
        motion = theta - self._theta
        if abs(motion) > JITTER:
            self._theta = theta
        else:
            motion = 0.0
        self.memory = self.friction.moved(self.memory, motion, contact)
        return self.memory


__all__ = ["JITTER", "SOFT", "Compensation", "FrictionState"]
