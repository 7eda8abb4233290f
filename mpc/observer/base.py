"""Observers have one interface; the plainest of them takes the difference of angles for the velocity."""

from typing import Protocol, runtime_checkable

import numpy as np

from allocator.calculus import Array, Value


@runtime_checkable
class Observer(Protocol):
    """An observer makes a state of what the sensors say, sample by sample."""

    def reset(self) -> None:
        """Forget the past."""

    def estimate(self, y: Array, u: Array) -> tuple[Array, Value]:
        """Return the state (2n + m,) and disturbance torque [N·m], (n,) of an arm, from `y` (2n + m,), NaN where
        unmeasured.

        `u` (m,) [Pa] was sent last.
        """


class Differentiator:
    """The differentiator is no observer at all: a velocity that is not measured is the difference of the last two
    angles.
    """

    def __init__(self, dt: float, n: int = 1) -> None:
        self.dt, self.n = dt, n
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._angles: Array | None = None  # (n,)

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """Return `y` (2n + m,) with the velocities filled in, and no disturbance torque."""
        x, n = np.array(y), self.n
        now, speed = x[:n].copy(), x[n : 2 * n]  # a view
        if np.isnan(speed).any():
            difference = np.zeros(n) if self._angles is None else (now - self._angles) / self.dt
            speed[:] = np.where(np.isnan(speed), difference, speed)
        self._angles = now
        return x, 0.0
