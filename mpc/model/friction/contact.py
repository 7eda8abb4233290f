"""Friction models share one interface, `Hysteresis`. `Loads` on the sliding surfaces scale their torque.

The memory of a model depends on the path of the angle and not on time. `Friction` (Dahl) and `MaxwellSlip` have the
same interface, so that each of them can be in the plant under test and in the `Compensation` of observer and
controllers. `Contacts` has the loads at every joint of a machine. At joint i, with m muscles with arms r_ji and forces
F_j, they are

    Σ_j |r_ji| F_j,    twice the mean pressure of the muscles that cross it,    K_ii

which are a1 F1 + a2 F2, P1 + P2 and K of one joint with two muscles.
"""

from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.felt import Loop
from allocator.lazy import SX, Function
from allocator.mechanism.formulas import symbolic_lengths
from mpc.codegen.buffered import Buffered
from mpc.model.arm.model import Arm
from mpc.model.arm.ranges import about_the_middle
from mpc.model.machine import Machine
from mpc.model.plant import Plant

CROSSES = 1e-9  # [m] of an arm, above which its muscle crosses the joint


class Loads(NamedTuple):
    """Loads on the sliding surfaces of a joint: numbers, arrays or CasADi symbols."""

    pulled: Value  # sum of the muscles' opposing torques [N·m]; a slack muscle of an arm has none
    filled: Value  # twice the mean pressure [Pa]
    stiffness: Value  # isobaric stiffness [N·m/rad], for any tracked stiffness of the plant

    @classmethod
    def of(cls, plant: Any, x: Value) -> Self:
        """Return the loads in a `Plant` or a `RealPlant` in the state `x` [4, ...]."""
        return cls(plant.pull(x), x[2] + x[3], plant.isobaric(x))


class Contacts:
    """Loads at every joint of `machine`, as a function of its state; for arms without formulas it is slower."""

    def __init__(self, machine: Machine) -> None:
        self._machine: Any = machine
        self._formulas = None if machine.unformulated else Buffered(loads_function(machine))

    def __call__(self, x: Array) -> tuple[Loads, ...]:
        """Return the loads at each of the n joints in the state `x` (2n + m,)."""
        loads = self._numbers(x) if self._formulas is None else self._formulas(x)[0]
        return tuple(Loads(*joint) for joint in loads.tolist())

    def _numbers(self, x: Array) -> Array:
        """Return the loads (n, 3) at the joints of an arm."""
        n, mechanism = self._machine.n, self._machine.mechanism
        q, P = x[:n], x[2 * n :]
        pulled = np.abs(mechanism.arms(q)).T @ np.maximum(mechanism.forces(q, P), 0.0)
        return np.stack([pulled, P @ _shares(self._machine), np.diag(mechanism.stiffness(q, P))], axis=1)


def loads_function(machine: Machine) -> "Function":
    """Return the CasADi function x ↦ (3, n) of the loads at every joint of a machine with formulas."""
    import casadi as ca

    x = ca.SX.sym("x", machine.size)
    if isinstance(machine, Plant):
        return ca.Function("pressing", [x], [ca.densify(ca.vertcat(*Loads.of(machine, x)))])
    s = machine.statics
    arms = ca.jacobian(symbolic_lengths(machine.mechanism.routes, s.q), s.q)
    pulled = ca.fabs(arms).T @ ca.fmax(s.forces, 0.0)
    loads = ca.horzcat(pulled, ca.DM(_shares(machine)).T @ s.P, ca.diag(s.stiffness)).T
    of_state = ca.Function("loads", [s.q, s.P], [loads])(x[: machine.n], x[2 * machine.n :])
    return ca.Function("pressing", [x], [ca.densify(of_state)])


def symbolic_loads(machine: Machine, x: "SX") -> list[Loads]:
    """Return the loads at every joint of a machine with formulas in the state `x` (2n + m,), CasADi symbols."""
    loads = loads_function(machine)(x)
    return [Loads(*(loads[row, i] for row in range(3))) for i in range(machine.n)]


def _shares(arm: Arm) -> Array:
    """Return the shares (m, n) of the pressures in twice the mean pressure at each joint."""
    crossing = (np.abs(arm.mechanism.arms(about_the_middle(arm))) > CROSSES).any(axis=0)  # (m, n)
    return np.asarray(2 * crossing / np.maximum(crossing.sum(axis=0), 1))


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


def first_push(friction: Hysteresis, memory: Value, motion: float, contact: Loads) -> float:
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
