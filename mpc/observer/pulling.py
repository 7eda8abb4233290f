"""Torques of a model's muscles in a state, their slopes, and the change of pressures by motion."""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.formulas import symbolic_lengths
from mpc.codegen.buffered import Buffered
from mpc.model.arm.model import Arm
from mpc.model.arm.pneumatics import Pneumatics
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant

if TYPE_CHECKING:
    from casadi import Function


class Pulls:
    """Pulls (2 m n + m,) of `machine` in a state x (2n + m,), for n joints and m muscles.

    They are the torques T_ji of each muscle at each joint [N·m], their slopes ∂T_ji/∂P_j [N·m/Pa], muscle by muscle,
    and the fall of the pressures by the motion [Pa/s].
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        formulas = pulling(machine) if isinstance(machine, Plant) else self._of_many(machine)
        self._formulas = None if formulas is None else Buffered(formulas)

    def __call__(self, x: Array) -> Array:
        """Return the pulls in the state `x`."""
        pulled = self._numbers(x) if self._formulas is None else np.asarray(self._formulas(x)[0][0])
        return pulled if isinstance(self._machine, Plant) else np.append(pulled, self._machine.expansion(x))

    @staticmethod
    def _of_many(arm: Arm) -> "Function | None":
        """Return x ↦ torques and slopes, without the effect of motion; None for an arm without formulas."""
        import casadi as ca

        if arm.unformulated:
            return None
        s, x = arm.statics, ca.SX.sym("x", arm.size)
        arms = -ca.jacobian(symbolic_lengths(arm.mechanism.routes, s.q), s.q)  # (m, n)
        gains = ca.diag(ca.jacobian(s.forces, s.P))
        rows = [ca.vec((arms * ca.repmat(each, 1, arm.n)).T) for each in (s.forces, gains)]
        found = ca.Function("of_posture", [s.q, s.P], [ca.vertcat(*rows)])(x[: arm.n], x[2 * arm.n :])
        return ca.Function("pulls", [x], [ca.densify(found)])

    def _numbers(self, x: Array) -> Array:
        assert isinstance(self._machine, Arm)
        mechanism, q, P = self._machine.mechanism, x[: self._machine.n], x[2 * self._machine.n :]
        muscles = Pneumatics(mechanism.muscles, mechanism.routes.rest_length)
        arms, length = mechanism.arms(q), mechanism.lengths(q)
        pulls = (forces[:, None] * arms for forces in (muscles.laws(length, P), muscles.force_slopes(length, P)))
        return np.concatenate([each.ravel() for each in pulls])


def pulling(plant: Plant) -> "Function":
    """Return the pulls of a joint, x (4,) ↦ (6,), as a CasADi function."""
    import casadi as ca

    x = ca.SX.sym("x", NX)
    T = ca.vertcat(*(side.torque(x[2 + i]) for i, side in enumerate(plant.joint.sides(x[0]))))
    gains = [ca.jacobian(T[i], x[2 + i]) for i in range(NU)]
    return ca.Function("pulls", [x], [ca.densify(ca.vertcat(T, *gains, *plant.expansion(x)))])
