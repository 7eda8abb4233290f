"""The limits of an arm are what commands, angles and muscle forces have to keep to."""

from dataclasses import dataclass

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.arm.model import Arm
from mpc.tracking.limits import Limits

_SHORTEST = 1e-5  # sample time [s]


@dataclass(frozen=True)
class ArmLimits(Limits):
    """The limits of an arm are `Limits` with a range for every joint."""

    theta: tuple[Array, Array]  # type: ignore[assignment]  # (n,) [rad], soft: one range a joint

    @classmethod
    def of_arm(cls, arm: Arm, dt: float, min_force: float = 0.0) -> "ArmLimits":
        """Return the limits of `arm` at the sample time `dt` [s], and the least force [N] of its muscles."""
        if not _SHORTEST <= dt < 1:
            raise InvalidInput(f"dt = {dt:g} s has to be a sample time between {_SHORTEST:g} and 1 s")
        least = float(checks.not_negative("min_force", min_force, "N"))
        return cls(arm.mechanism.pressure_limits, arm.slew * dt, arm.angle_limits, least)

    def limited(self, u_last: Array, u: Array) -> Array:
        """Return the commands `u` (N, m) after `u_last` (m,), each moved to the nearest that slew and supply allow."""
        (low, high), kept, last = self.pressure, np.empty_like(u), u_last
        for k, wanted in enumerate(np.clip(u, low, high)):
            kept[k] = last = np.minimum(np.maximum(wanted, last - self.step), last + self.step)
        return kept

    def excursion(self, theta: Array) -> float:
        """Return how far `theta` (…, n) leaves the joints' ranges at worst [rad]."""
        left, right = self.theta
        return float(max(0.0, (left - theta).max(), (theta - right).max()))
