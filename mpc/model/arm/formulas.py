"""The formulas of an arm in CasADi symbols: statics, outputs, acceleration, and its motion over a sample."""

from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from allocator.mechanism import Mechanism
from mpc.model.arm.gas import gas_motion
from mpc.model.arm.mechanics.moving_bodies import MovingBodies
from mpc.model.integration import integrated, swung
from mpc.model.lengths import symbolic_jacobian, symbolic_lengths

if TYPE_CHECKING:
    from mpc.model.arm.model import Arm


class Statics(NamedTuple):
    """The statics are CasADi expressions at a posture: of symbols q (n, 1) and P (m, 1) [Pa]."""

    q: Any
    P: Any
    torque: Any  # τ (n, 1) [N·m]
    stiffness: Any  # K (n, n) [N·m/rad]
    forces: Any  # F (m, 1) [N]


def statics(mechanism: Mechanism) -> Statics:
    """Return torques, stiffness and forces. Raises `InvalidInput` for routes without formulas."""
    import casadi as ca

    q, P = ca.SX.sym("q", mechanism.n), ca.SX.sym("P", mechanism.m)
    length, L = symbolic_lengths(mechanism.routes, q), mechanism.routes.rest_length
    laws = (muscle.law(P[j], (L[j] - length[j]) / L[j]) for j, muscle in enumerate(mechanism.muscles))
    F: Any = ca.vertcat(*laws)
    torque = -ca.jacobian(length, q).T @ F  # (M1)
    return Statics(q, P, torque, -ca.jacobian(torque, q), F)  # (M2)


def along(name: str, s: Statics, value: Any) -> Any:
    """Return the function (q, P) ↦ `value`."""
    import casadi as ca

    return ca.Function(name, [s.q, s.P], [value])


def outputs(arm: "Arm") -> Any:
    """Return the column (svec K, F), K being the stiffness that is tracked."""
    import casadi as ca

    K = arm.statics.stiffness
    if arm.endpoint is not None:
        J = symbolic_jacobian(arm.endpoint, arm.statics.q)
        if arm.tracked == arm.n:  # (M4) without a force
            turned = ca.inv(J)
            K = turned.T @ K @ turned
        else:
            K = ca.inv(J @ ca.solve(K, J.T))
    entries = [f * K[int(i), int(j)] for i, j, f in zip(*arm.entries, strict=True)]
    return ca.vertcat(*entries, arm.statics.forces)


def joint_svec(s: Statics) -> Any:
    """Return svec of the joints' stiffness as a column."""
    import casadi as ca

    rows, columns = np.triu_indices(s.stiffness.shape[0])
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return ca.vertcat(*(s.stiffness[i, j] if i == j else sqrt(2) * s.stiffness[i, j] for i, j in pairs))


def acceleration(s: Statics, bodies: MovingBodies) -> Any:
    """Return the function (q, ω, P, d) ↦ ω'."""
    import casadi as ca

    n = s.q.shape[0]
    omega, d = ca.SX.sym("omega", n), ca.SX.sym("d", n)
    pushing = s.torque - bodies.bias(s.q, omega) + d
    return ca.Function("acceleration", [s.q, omega, s.P, d], [ca.solve(bodies.mass_matrix(s.q), pushing)])


def discrete(arm: "Arm", dt: float, substeps: int) -> Any:
    """Return the function (x, u, d) ↦ x after `dt` [s] in `substeps` of the classical Runge–Kutta method."""
    import casadi as ca

    n = arm.n
    x, u, d = ca.MX.sym("x", arm.size), ca.MX.sym("u", arm.m), ca.MX.sym("d", n)
    if arm.gas is not None:
        rate = gas_motion(arm)
        later = integrated(lambda z: rate(z, u, d), x, dt, substeps)
    else:
        alpha, state = arm.acceleration(), (x[:n], x[n : 2 * n], x[2 * n :])
        moved = swung(
            lambda q, omega, P: alpha(q, omega, P, d),
            lambda P, t: u + ca.DM(np.exp(-t / arm.lags)) * (P - u),
            state, dt / substeps, substeps,
        )  # fmt: skip
        later = ca.vertcat(*moved)
    return ca.Function("discrete", [x, u, d], [later], ["x", "u", "d"], ["x_next"])
