"""What an arm asks of its bodies stands here, whatever they are made of."""

from typing import Protocol

from numpy.typing import ArrayLike

from allocator.calculus import Value


class MovingBodies(Protocol):
    """`MovingBodies` are what an arm asks of its bodies, such as `Bodies`, `TreeBodies` or `MujocoBodies`.

    Postures and velocities are (…, n) [rad], [rad/s] as numbers, or CasADi columns (n, 1) where there are formulas.
    """

    @property
    def n(self) -> int:
        """Return the number of joints."""

    @property
    def damping(self) -> ArrayLike:
        """Return the damping of the hinges (n,) [N·m·s/rad]."""

    @property
    def summary(self) -> str:
        """Return what they are, in some words."""

    def mass_matrix(self, q: Value) -> Value:
        """Return M(q) (…, n, n) [kg·m²]."""

    def bias(self, q: Value, omega: Value) -> Value:
        """Return the torques (…, n) [N·m] of a motion without acceleration."""

    def torque_for(self, q: Value, omega: Value, alpha: Value) -> Value:
        """Return the torques (…, n) [N·m] of a motion."""

    def gravity_torque(self, q: Value) -> Value:
        """Return the torques (…, n) [N·m] that hold a posture."""

    def gravity_stiffness(self, q: Value) -> Value:
        """Return the slope (…, n, n) [N·m/rad] of these."""
