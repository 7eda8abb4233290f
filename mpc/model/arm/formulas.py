"""Formulas of an arm in CasADi symbols: statics, outputs, acceleration, and the motion over a sample."""

from collections.abc import Sequence
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Value
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism import Mechanism, Routes
from allocator.mechanism.formulas import has_formulas, symbolic_jacobian, symbolic_lengths
from mpc.model.arm.mujoco_mechanics import MujocoBodies
from mpc.model.experiment import integrated
from mpc.model.pressures import fall

if TYPE_CHECKING:
    from casadi import MX, SX, Function

    from mpc.model.arm.model import Arm


class Statics(NamedTuple):
    """Statics as CasADi expressions of the symbols q (n, 1) [rad] and P (m, 1) [Pa]."""

    q: "SX"
    P: "SX"
    torque: "SX"  # τ (n, 1) [N·m]
    stiffness: "SX"  # K (n, n) [N·m/rad]
    forces: "SX"  # F (m, 1) [N]


class MovingBodies(Protocol):
    """Interface of an arm's bodies, such as `Bodies`, `TreeBodies` or `MujocoBodies`.

    Postures and velocities are (…, n) [rad], [rad/s] as numbers, or CasADi columns (n, 1) for bodies with formulas.
    """

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def damping(self) -> ArrayLike:
        """Damping of the hinges (n,) [N·m·s/rad]."""

    @property
    def summary(self) -> str:
        """Short description."""

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


def missing(routes: Routes, bodies: MovingBodies) -> str:
    """Return the parts without formulas in words, or "" if there are none."""
    found = [] if has_formulas(routes) else [f"{type(routes).__name__}, the muscles' ways,"]
    found += [type(bodies).__name__] * isinstance(bodies, MujocoBodies)
    return f"{' and '.join(found)} have no formulas" if found else ""


def statics(mechanism: Mechanism, gains: Sequence[float] | None = None) -> Statics:
    """Return torques, stiffness and forces of muscles `gains` (m,) as strong as their models.

    Raises `InvalidInput` for routes without formulas.
    """
    import casadi as ca

    q, P = ca.SX.sym("q", mechanism.n), ca.SX.sym("P", mechanism.m)
    length, L = symbolic_lengths(mechanism.routes, q), mechanism.routes.rest_length
    laws = (muscle.law(P[j], (L[j] - length[j]) / L[j]) for j, muscle in enumerate(mechanism.muscles))
    F = ca.vertcat(*laws)
    F = F if gains is None else ca.DM(gains) * F
    torque = -ca.jacobian(length, q).T @ F  # (M1)
    return Statics(q, P, torque, -ca.jacobian(torque, q), F)  # (M2)


def along(name: str, s: Statics, value: "SX") -> "Function":
    """Return the function (q, P) ↦ `value`."""
    import casadi as ca

    return ca.Function(name, [s.q, s.P], [value])


def outputs(arm: "Arm") -> "SX":
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


def joint_svec(s: Statics) -> "SX":
    """Return svec of the joints' stiffness as a column."""
    import casadi as ca

    rows, columns = np.triu_indices(s.stiffness.shape[0])
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return ca.vertcat(*(s.stiffness[i, j] if i == j else sqrt(2) * s.stiffness[i, j] for i, j in pairs))


def acceleration(s: Statics, bodies: MovingBodies) -> "Function":
    """Return the function (q, ω, P, d) ↦ ω'."""
    import casadi as ca

    n = s.q.shape[0]
    omega, d = ca.SX.sym("omega", n), ca.SX.sym("d", n)
    pushing = s.torque - bodies.bias(s.q, omega) + d
    return ca.Function("acceleration", [s.q, omega, s.P, d], [ca.solve(bodies.mass_matrix(s.q), pushing)])


def varied_acceleration(bodies: MovingBodies, q: "SX", omega: "SX", torque: "SX", mass: Value, damping: Value) -> "SX":
    """Return ω' (n, 1) under a `torque` (n, 1) [N·m], with factors of all masses and of the damping. Symbols."""
    import casadi as ca

    rubbing = ca.DM(np.asarray(bodies.damping, float).tolist()) * omega
    pushing = torque - mass * (bodies.bias(q, omega) - rubbing) - damping * rubbing
    alpha: SX = ca.ldl_solve(pushing, *ca.ldl(mass * bodies.mass_matrix(q)))
    return alpha


def discrete(arm: "Arm", dt: float, substeps: int) -> "Function":
    """Return the function (x, u, d) ↦ x after `dt` [s] in `substeps` of the classical Runge–Kutta method."""
    import casadi as ca

    n, lags = arm.n, arm.lags
    x, u, d = ca.MX.sym("x", arm.size), ca.MX.sym("u", arm.m), ca.MX.sym("d", n)
    if arm.gas is not None:
        motion = gas_motion(arm)
        later = integrated(lambda z, t: motion(z, u, d), x, dt, substeps)
    else:
        alpha, gap = acceleration(arm.statics, arm.bodies), x[2 * n :] - u

        def rate(s: "MX", t: float) -> "MX":
            return ca.vertcat(s[n:], alpha(s[:n], s[n:], u + ca.DM(np.exp(-t / lags)) * gap, d))

        moved = integrated(rate, x[: 2 * n], dt, substeps)
        later = ca.vertcat(moved, u + ca.DM(np.exp(-dt / lags)) * gap)
    return ca.Function("discrete", [x, u, d], [later], ["x", "u", "d"], ["x_next"])


def gas_motion(arm: "Arm") -> "Function":
    """Return the function (x, u, d) ↦ x' of an arm with gas, `mpc.model.pressures` muscle by muscle   (G3)"""
    import casadi as ca

    s = arm.statics
    omega, u, d = ca.SX.sym("omega", arm.n), ca.SX.sym("u", arm.m), ca.SX.sym("d", arm.n)
    x = ca.vertcat(s.q, omega, s.P)
    alpha = acceleration(s, arm.bodies)(s.q, omega, s.P, d)
    return ca.Function("motion", [x, u, d], [ca.vertcat(omega, alpha, *pressure_rates(arm, omega, u))])


def pressure_rates(arm: "Arm", omega: "SX", u: "SX") -> list["SX"]:
    """Return P' [Pa/s] of muscles with gas, under commands `u` [Pa]. Expressions of the symbols of `arm.statics`."""
    P = arm.statics.P
    return [(u[j] - P[j]) / float(arm.lags[j]) + rise for j, rise in enumerate(rises(arm, omega))]


def pressure_functions(arm: "Arm") -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Return the inputs and outputs of (q, ω, P, u) ↦ P', and of (q, ω, P) ↦ its Jacobian by these, ∂P_j'/∂u_j.

    Without gas there are none.
    """
    import casadi as ca

    if arm.gas is None:
        return {}
    s, omega, u = arm.statics, ca.SX.sym("omega", arm.n), ca.SX.sym("u", arm.m)
    rate, moving = ca.vertcat(*pressure_rates(arm, omega, u)), {"q": s.q, "omega": omega, "P": s.P}
    slopes = {"by": ca.jacobian(rate, ca.vertcat(*moving.values())), "by_command": ca.SX(ca.DM(1 / arm.lags))}
    return {"pressures": (moving | {"u": u}, {"rate": rate}), "pressure_slopes": (moving, slopes)}


def rises(arm: "Arm", omega: "SX", gains: Sequence[float] | None = None) -> list["SX"]:
    """Return the rise of each pressure [Pa/s] by the motion `omega`, of muscles `gains` (m,) as strong as their models.

    Expressions of the symbols of `arm.statics`.
    """
    import casadi as ca

    s, mechanism = arm.statics, arm.mechanism
    length, L = symbolic_lengths(mechanism.routes, s.q), mechanism.routes.rest_length
    speed, found = ca.jacobian(length, s.q) @ omega, []
    for j, (muscle, gain) in enumerate(zip(mechanism.muscles, gains or (1.0,) * arm.m, strict=True)):
        side = OneMuscle(muscle, "muscle", L[j], 1 - length[j] / L[j], 1.0, 0.0, 1.0, mechanism.gas)
        found.append(fall(side, s.P[j], gain) * speed[j])
    return found


def falls(arm: "Arm", omega: "SX") -> "SX":
    """Return the fall of the pressures (m, 1) [Pa/s] by the motion `omega`: 0 without gas."""
    import casadi as ca

    return ca.SX.zeros(arm.m) if arm.gas is None else -ca.vertcat(*rises(arm, omega))
