"""Limits on commands, angles and muscle forces."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from mpc.model.machine import Machine, sample_time

LONGEST_HORIZON = 1000  # samples; the time of a step grows with its square


@dataclass(frozen=True)
class Limits:
    """Limits of a plant, for commands that change once per sample."""

    pressure: tuple[float, float]  # of every command [Pa], hard
    step: float  # greatest |u_k - u_{k-1}| [Pa], hard
    theta: tuple[Value, Value]  # of the angle, or (n,) of each [rad], soft
    min_force: float = 0.0  # of all muscles [N], soft

    @classmethod
    def of(cls, plant: Machine, dt: float, min_force: float = 0.0) -> Self:
        """Return the limits of `plant` at the sample time `dt` [s], and the least force [N] of its muscles."""
        dt = sample_time(dt)
        least = float(checks.not_negative("min_force", min_force, "N"))
        return cls(plant.pressure_limits, plant.slew * dt, plant.angle_limits, least)

    def limited(self, u_last: Array, u: Array) -> Array:
        """Return the commands `u` (N, m) after `u_last` (m,), each moved to the nearest within slew and supply limits.

        The slew limit has priority: from outside the supply's range, commands return as fast as it permits.
        """
        (low, high), step = self.pressure, self.step
        kept = np.empty_like(u)
        for i, last in enumerate(u_last.tolist()):
            for k, wanted in enumerate(u[:, i].tolist()):
                last = min(max(min(max(wanted, low), high), last - step), last + step)
                kept[k, i] = last
        return kept

    def commandable(self, P: Array) -> Array:
        """Return the measured pressures `P` [Pa] as commands to start from.

        A gauge may read less than zero, which cannot be commanded; such readings are moved to zero. Other readings
        outside the supply stay, since commands return from there at the slew limit.
        """
        return np.maximum(P, min(self.pressure[0], 0.0))

    def excursion(self, theta: Array) -> float:
        """Return the greatest excursion of the angles `theta` (N,) or (N, n) from their ranges [rad]."""
        left, right = self.theta
        if theta.ndim > 1:
            return float(max(0.0, (left - theta).max(), (theta - right).max()))
        angles = theta.tolist()  # Python is faster than NumPy on so few numbers
        return float(max(0.0, left - min(angles), max(angles) - right))

    def slackening(self, F: Array) -> float:
        """Return the greatest shortfall of the forces `F` below the least one [N]."""
        return max(0.0, self.min_force - float(F.min()))
