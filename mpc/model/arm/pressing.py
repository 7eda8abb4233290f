"""Loads on the sliding surfaces of an arm's joints, which scale the torques of friction models."""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.lazy import SX, Function
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
        self._shares = _shares(arm)
        self._formulas = None if arm.unformulated else Buffered(symbolic_pressing(arm))

    def __call__(self, x: Array) -> Array:
        """Return the loads (n, 3) [N·m], [Pa], [N·m/rad] in the state `x` (2n + m,)."""
        if self._formulas is not None:
            return self._formulas(x)[0]
        mechanism, q, P = self._arm.mechanism, x[: self._arm.n], x[2 * self._arm.n :]
        pulled = np.abs(mechanism.arms(q)).T @ np.maximum(mechanism.forces(q, P), 0.0)
        return np.stack([pulled, P @ self._shares, np.diag(mechanism.stiffness(q, P))], axis=1)


class SymbolicLoads(NamedTuple):
    """Loads at a joint as CasADi expressions."""

    pulled: "SX"  # [N·m]
    filled: "SX"  # [Pa]
    stiffness: "SX"  # [N·m/rad]


def symbolic_loads(arm: Arm, x: "SX") -> list[SymbolicLoads]:
    """Return the loads at every joint of an arm with formulas in the state `x` (2n + m,)."""
    loads = symbolic_pressing(arm)(x)
    return [SymbolicLoads(*(loads[row, i] for row in range(3))) for i in range(arm.n)]


def symbolic_pressing(arm: Arm) -> "Function":
    """Return the CasADi function x ↦ (3, n) of the loads at every joint of an arm with formulas."""
    import casadi as ca

    s, x = arm.statics, ca.SX.sym("x", arm.size)
    arms = ca.jacobian(symbolic_lengths(arm.mechanism.routes, s.q), s.q)
    pulled = ca.fabs(arms).T @ ca.fmax(s.forces, 0.0)
    loads = ca.horzcat(pulled, ca.DM(_shares(arm)).T @ s.P, ca.diag(s.stiffness)).T
    of_state = ca.Function("loads", [s.q, s.P], [loads])(x[: arm.n], x[2 * arm.n :])
    return ca.Function("pressing", [x], [ca.densify(of_state)])


def _shares(arm: Arm) -> Array:
    """Return the shares (m, n) of the pressures in twice the mean pressure at each joint."""
    crossing = (np.abs(arm.mechanism.arms(about_the_middle(arm))) > CROSSES).any(axis=0)  # (m, n)
    return np.asarray(2 * crossing / np.maximum(crossing.sum(axis=0), 1))
