"""Observers have one interface; the plainest of them takes the difference of angles for the velocity."""

from typing import Protocol, runtime_checkable

import numpy as np

from allocator.calculus import Array


@runtime_checkable
class Observer(Protocol):
    """An observer makes a state of what the sensors say, sample by sample."""

    def reset(self) -> None:
        """Forget the past."""

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """Return the state (4,) and disturbance torque [N·m] from `y` (4,), NaN where unmeasured.

        `u` (2,) [Pa] was sent last.
        """


class Differentiator:
    """The differentiator is no observer at all: a velocity that is not measured is the difference of the last two
    angles.
    """

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._theta: float | None = None

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """Return `y` (4,) with the velocity filled in, and no disturbance torque."""
        x = np.array(y)
        if np.isnan(x[1]):
            x[1] = 0.0 if self._theta is None else (x[0] - self._theta) / self.dt
        self._theta = float(x[0])
        return x, 0.0
