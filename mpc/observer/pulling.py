"""Torques of a model's muscles in a state, their slopes, and the change of pressures by motion."""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.formulas import symbolic_lengths
from mpc.codegen.buffered import Buffered
from mpc.model.arm.formulas import falls
from mpc.model.arm.model import Arm
from mpc.model.arm.pneumatics import Pneumatics
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX

if TYPE_CHECKING:
    from casadi import Function


class Pulls:
    """Pulls (2 m n + m,) of `machine` in a state x (2n + m,), for n joints and m muscles.

    They are the torques T_ji of each muscle at each joint [N·m], their slopes ∂T_ji/∂P_j [N·m/Pa], muscle by muscle,
    and the fall of the pressures by the motion [Pa/s].
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._numeric = isinstance(machine, Arm) and bool(machine.unformulated)
        self._formulas = None if self._numeric else Buffered(pulling(machine))

    def __call__(self, x: Array) -> Array:
        """Return the pulls in the state `x`."""
        return self._numbers(x) if self._formulas is None else np.asarray(self._formulas(x)[0][0])

    def _numbers(self, x: Array) -> Array:
        assert isinstance(self._machine, Arm)
        mechanism, q, P = self._machine.mechanism, x[: self._machine.n], x[2 * self._machine.n :]
        muscles = Pneumatics(mechanism.muscles, mechanism.routes.rest_length)
        arms, length = mechanism.arms(q), mechanism.lengths(q)
        pulls = (forces[:, None] * arms for forces in (muscles.laws(length, P), muscles.force_slopes(length, P)))
        return np.concatenate([*(each.ravel() for each in pulls), self._machine.expansion(x)])


def pulling(machine: Machine) -> "Function":
    """Return the pulls of a joint, or of an arm with formulas, as a CasADi function of the state."""
    import casadi as ca

    if isinstance(machine, Arm):
        s = machine.statics
        arms = -ca.jacobian(symbolic_lengths(machine.mechanism.routes, s.q), s.q)  # (m, n)
        gains = ca.diag(ca.jacobian(s.forces, s.P))
        rows = [ca.vec((arms * ca.repmat(each, 1, machine.n)).T) for each in (s.forces, gains)]
        omega = ca.SX.sym("omega", machine.n)
        pulls = ca.densify(ca.vertcat(*rows, falls(machine, omega)))
        return ca.Function("pulls", [ca.vertcat(s.q, omega, s.P)], [pulls])
    x = ca.SX.sym("x", NX)
    T = ca.vertcat(*(side.torque(x[2 + i]) for i, side in enumerate(machine.joint.sides(x[0]))))
    slopes = [ca.jacobian(T[i], x[2 + i]) for i in range(NU)]
    return ca.Function("pulls", [x], [ca.densify(ca.vertcat(T, *slopes, *machine.expansion(x)))])
