"""Friction models share one interface, `Hysteresis`. `Loads` on the sliding surfaces scale their torque.

A model remembers how the joint came to where it is, by the angle and not by time. `Friction` (Dahl) and `MaxwellSlip`
have the same interface, so that each of them may be in the plant under test and be told to observer and controllers.
`Contacts` gives the loads at every joint of a machine. At joint i they are, of m muscles with arms r_ji and forces F_j,

    Σ_j |r_ji| F_j,    twice the mean pressure of the muscles that cross it,    K_ii

which are a1 F1 + a2 F2, P1 + P2 and K of one joint with two muscles.
"""

from typing import NamedTuple, Protocol, Self, runtime_checkable

from allocator.calculus import Array, Value
from allocator.joint.felt import Loop
from mpc.codegen.buffered import Buffered
from mpc.model.arm.pressing import Pressing as ManyPressing
from mpc.model.machine import Machine
from mpc.model.plant import NX, Plant


class Loads(Protocol):
    """The loads on the sliding surfaces of a joint."""

    @property
    def pulled(self) -> Value:
        """The muscles' torques against each other [N·m]."""

    @property
    def filled(self) -> Value:
        """Twice the mean pressure [Pa]."""

    @property
    def stiffness(self) -> Value:
        """The isobaric stiffness [N·m/rad]."""


class Pressed(NamedTuple):
    """`Loads` as numbers."""

    pulled: float  # [N·m]
    filled: float  # [Pa]
    stiffness: float  # [N·m/rad]


class Pressing(Protocol):
    """A plant presses on what rubs by the pulls of its muscles, their stiffness and their pressures."""

    def pull(self, x: Value) -> Value:
        """Return a1 F1 + a2 F2 [N·m] in the state `x` [4, ...]."""

    def isobaric(self, x: Value) -> Value:
        """Return the isobaric stiffness [N·m/rad] in the state `x` [4, ...]."""


class BufferedPressing:
    """What presses is a plant's, in one CasADi function: for numbers that takes a fifth of the plant's own time."""

    def __init__(self, plant: Plant) -> None:
        import casadi as ca

        x = ca.SX.sym("x", NX)
        both = ca.densify(ca.vertcat(plant.pull(x), plant.isobaric(x)))
        self._both = Buffered(ca.Function("pressing", [x], [both]))

    def pull(self, x: Value) -> Value:
        """Return a1 F1 + a2 F2 [N·m] in the state `x` (4,)."""
        return float(self._both(x)[0][0, 0])

    def isobaric(self, x: Value) -> Value:
        """Return the isobaric stiffness [N·m/rad] in the state `x` (4,)."""
        return float(self._both(x)[0][0, 1])


class Contact(NamedTuple):
    """A contact is a plant in a state, of which a model of friction takes what presses on that which rubs."""

    plant: Pressing
    x: Value  # (4, ...)

    @property
    def pulled(self) -> Value:
        """Return a1 F1 + a2 F2 [N·m]."""
        return self.plant.pull(self.x)

    @property
    def filled(self) -> Value:
        """Return P1 + P2 [Pa]."""
        return self.x[2] + self.x[3]

    @property
    def stiffness(self) -> Value:
        """Return the isobaric stiffness [N·m/rad], whichever of the plant's is tracked."""
        return self.plant.isobaric(self.x)


class Contacts:
    """The loads at every joint of `machine`, as a function of its state."""

    def __init__(self, machine: Machine) -> None:
        self._plant = BufferedPressing(machine) if isinstance(machine, Plant) else None
        self._many = None if isinstance(machine, Plant) else ManyPressing(machine)

    def __call__(self, x: Array) -> tuple[Loads, ...]:
        """Return the loads at each of the n joints in the state `x` (2n + m,)."""
        if self._plant is not None:
            return (Contact(self._plant, x),)
        assert self._many is not None
        return tuple(Pressed(*joint) for joint in self._many(x).tolist())


@runtime_checkable
class Hysteresis(Protocol):
    """A hysteresis is a torque T_f against the motion that depends on the way by which the joint came.

    Its memory is a number, or some, for the observer and for controllers, and CasADi symbols (size,) in a plant under
    test.
    """

    @property
    def size(self) -> int:
        """Return how many numbers it remembers."""

    @property
    def absent(self) -> bool:
        """Return whether there is none."""

    @property
    def summary(self) -> str:
        """Return what it is in some words."""

    def begun(self, theta: float) -> Value:
        """Return the memory of a joint that has not moved from `theta` [rad] yet."""

    def moved(self, memory: Value, motion: Value, contact: Loads) -> Value:
        """Return the memory after turning by `motion` [rad] in one direction; numbers or CasADi symbols."""

    def along(self, memory: Value, theta: Array, contact: Loads) -> Array:
        """Return the memories (n, ...) at the angles `theta` (n,) [rad], from `memory` at the first."""

    def torque(self, memory: Value, contact: Loads) -> Value:
        """Return T_f [N·m] of a memory, or (n,) of memories (n, ...)."""

    def most(self, contact: Loads) -> Value:
        """Return the greatest T_f [N·m]."""

    def share(self, share: float) -> Self:
        """Return the same with a `share` [-] of its torque."""

    @property
    def loop(self) -> Loop:
        """Its steady loops, see `allocator.joint.felt`."""

    def as_dahl(self, plant: Plant) -> "Hysteresis":
        """Return Dahl's friction with a loop as wide at θ = 0, P1 + P2 = 5 bar."""
