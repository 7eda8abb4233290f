"""An experiment is what a closed loop is run against: a plant in some state, its sensors, and time going on."""

from typing import Any, Protocol

from allocator.calculus import Array
from mpc.model.buffered import Buffered

FINE = 0.02  # resolution of simulations, see `Plant.discrete`
RESOLUTION = 0.5  # of a controller's model


class Experiment(Protocol):
    """An experiment is a plant under way."""

    @property
    def x(self) -> Array:
        """Return the true state (2n + m,): angles [rad], velocities [rad/s], pressures [Pa]."""

    def measure(self) -> Array:
        """Return what the sensors say of it (2n + m,); NaN for what is not measured. To be called once a sample."""

    def advance(self, u: Array, d: Any = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] and the torque `d` [N·m], (n,) of an arm, from outside
        besides the plant's own.
        """


class ExactExperiment:
    """An exact experiment is a plant that is its model, (x, u, d) ↦ x, and whose whole state is measured."""

    def __init__(self, discrete: Any, x0: Array) -> None:
        self._integrate = Buffered(discrete)
        self.x = x0

    def measure(self) -> Array:
        """Return the true state (2n + m,)."""
        return self.x.copy()

    def advance(self, u: Array, d: Any = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] and the torque `d` [N·m] from outside."""
        self.x = self._integrate(self.x, u, d)[0][0]
