"""Friction models share one interface, `Hysteresis`. `Loads` on the sliding surfaces scale their torque.

The memory of a model depends on the path of the angle and not on time. `Friction` (Dahl) and `MaxwellSlip` have the
same interface, so that each of them can be in the plant under test and in the `Compensation` of observer and
controllers. `Contacts` has the loads at every joint of a machine. At joint i, with m muscles with arms r_ji and forces
F_j, they are

    Σ_j |r_ji| F_j,    twice the mean pressure of the muscles that cross it,    K_ii

which are a1 F1 + a2 F2, P1 + P2 and K of one joint with two muscles.
"""

from typing import NamedTuple, Protocol, Self, runtime_checkable

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.felt import Loop
from mpc.codegen.buffered import Buffered
from mpc.model.arm.pressing import Pressing as ManyPressing
from mpc.model.machine import Machine
from mpc.model.plant import NX, Plant


class Loads(Protocol):
    """Loads on the sliding surfaces of a joint."""

    @property
    def pulled(self) -> Value:
        """Sum of the muscles' opposing torques [N·m]."""

    @property
    def filled(self) -> Value:
        """Twice the mean pressure [Pa]."""

    @property
    def stiffness(self) -> Value:
        """Isobaric stiffness [N·m/rad]."""


class Pressed(NamedTuple):
    """Numeric `Loads`."""

    pulled: float  # [N·m]
    filled: float  # [Pa]
    stiffness: float  # [N·m/rad]


class Pressing(Protocol):
    """Plant that supplies the loads on sliding surfaces: pull, stiffness and pressures of its muscles."""

    def pull(self, x: Value) -> Value:
        """Return a1 F1 + a2 F2 [N·m] in the state `x` [4, ...]."""

    def isobaric(self, x: Value) -> Value:
        """Return the isobaric stiffness [N·m/rad] in the state `x` [4, ...]."""


class BufferedPressing:
    """Loads of a plant in one CasADi function, which takes a fifth of the plant's own time for numbers."""

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
    """Loads of a plant in a state, for a friction model."""

    plant: Pressing
    x: Value  # (4, ...)

    @property
    def pulled(self) -> Value:
        """Sum a1 F1 + a2 F2 [N·m] of the muscles' opposing torques."""
        return self.plant.pull(self.x)

    @property
    def filled(self) -> Value:
        """Sum P1 + P2 [Pa]."""
        return self.x[2] + self.x[3]

    @property
    def stiffness(self) -> Value:
        """Isobaric stiffness [N·m/rad], for any tracked stiffness of the plant."""
        return self.plant.isobaric(self.x)


class Contacts:
    """Loads at every joint of `machine`, as a function of its state."""

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
    """Torque T_f against the motion that depends on the past path of the joint.

    Its memory is one or more numbers for the observer and controllers, and CasADi symbols (size,) in a plant under
    test.
    """

    @property
    def size(self) -> int:
        """Size of its memory."""

    @property
    def absent(self) -> bool:
        """Whether there is no friction."""

    @property
    def summary(self) -> str:
        """Short description."""

    def begun(self, theta: float) -> Value:
        """Return the memory of a joint that has not moved from `theta` [rad]."""

    def moved(self, memory: Value, motion: Value, contact: Loads) -> Value:
        """Return the memory after turning by `motion` [rad] in one direction; numbers or CasADi symbols."""

    def along(self, memory: Value, theta: Array, contact: Loads) -> Array:
        """Return the memories (n, ...) at the angles `theta` (n,) [rad], from `memory` at the first."""

    def torque(self, memory: Value, contact: Loads) -> Value:
        """Return T_f [N·m] of a memory, or (n,) of memories (n, ...)."""

    def most(self, contact: Loads) -> Value:
        """Return the greatest T_f [N·m]."""

    def share(self, share: float) -> Self:
        """Return the same model with a `share` [-] of its torque."""

    @property
    def loop(self) -> Loop:
        """Steady loops of the model, see `allocator.joint.felt`."""

    def as_dahl(self, plant: Plant) -> "Hysteresis":
        """Return Dahl's friction with a loop of the same width at θ = 0, P1 + P2 = 5 bar."""


def first_push(friction: Hysteresis, memory: Value, motion: float, contact: Contact) -> float:
    """Return the stiffness [N·m/rad] against a push by `motion` [rad], with its sign, from a `memory`.

        K + [T_f(m after Δθ) - T_f(m)]/Δθ

    A steady loop is symmetric (`allocator.joint.felt`), the first push after a motion is not: one in its direction
    meets the backbone alone, one that turns the joint back by A meets up to K + Σ k_i min(1, 2 ρ_i/A). The result
    includes the isobaric stiffness of the `contact`. Raises `InvalidInput` for a push of 0.
    """
    by = checks.number("motion", motion, "rad")
    if by == 0:
        raise InvalidInput("motion = 0 rad is no push")
    before, after = (friction.torque(m, contact) for m in (memory, friction.moved(memory, by, contact)))
    return float(contact.stiffness + (after - before) / by)
