"""Loads on the sliding surfaces of an arm's joints, which scale the torques of friction models."""

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.formulas import symbolic_lengths
from mpc.codegen.buffered import Buffered
from mpc.model.arm.model import Arm
from mpc.model.arm.ranges import about_the_middle

CROSSES = 1e-9  # [m] of an arm, above which its muscle crosses the joint


class Pressing:
    """Loads at every joint of `arm`: Σ_j |r_ji| F_j, twice the mean pressure of the muscles that cross it, and K_ii.

    A slack muscle has no load. Arms without formulas are evaluated as numbers, which takes longer.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        crossing = (np.abs(arm.mechanism.arms(about_the_middle(arm))) > CROSSES).any(axis=0)  # (m, n)
        self._shares = 2 * crossing / np.maximum(crossing.sum(axis=0), 1)
        self._formulas = None if arm.unformulated else self._buffered()

    def __call__(self, x: Array) -> Array:
        """Return the loads (n, 3) [N·m], [Pa], [N·m/rad] in the state `x` (2n + m,)."""
        if self._formulas is not None:
            return self._formulas(x)[0]
        mechanism, q, P = self._arm.mechanism, x[: self._arm.n], x[2 * self._arm.n :]
        pulled = np.abs(mechanism.arms(q)).T @ np.maximum(mechanism.forces(q, P), 0.0)
        return np.stack([pulled, P @ self._shares, np.diag(mechanism.stiffness(q, P))], axis=1)

    def _buffered(self) -> Buffered:
        import casadi as ca

        arm, s, x = self._arm, self._arm.statics, ca.SX.sym("x", self._arm.size)
        arms = ca.jacobian(symbolic_lengths(arm.mechanism.routes, s.q), s.q)
        pulled = ca.fabs(arms).T @ ca.fmax(s.forces, 0.0)
        loads = ca.horzcat(pulled, ca.DM(self._shares).T @ s.P, ca.diag(s.stiffness)).T
        of_state = ca.Function("loads", [s.q, s.P], [loads])(x[: arm.n], x[2 * arm.n :])
        return Buffered(ca.Function("pressing", [x], [ca.densify(of_state)]))
