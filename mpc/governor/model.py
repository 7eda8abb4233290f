"""The formulas that the governor asks are written here: how the arm moves, and its energy at rest pressures.

With the mass matrix M(q) the bodies' equations are M q'' = τ(q, P) - C - D q' - g(q) + d, where by Lagrange
C = (∂(M ω)/∂q) ω - ½ ∂(ωᵀM ω)/∂q; d is the greatest load, which pushes away from the rest. Slack cables do not push.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.mechanism import Mechanism
from mpc.model.lengths import symbolic_lengths

_NODES = 3  # of the quadrature of a potential


class Dynamics(NamedTuple):
    """The `Dynamics` are a mechanism with bodies: `inertia` and `gravity` are M and g, or functions of CasADi's q."""

    mechanism: Mechanism
    inertia: Any  # M (n, n) [kg·m²]
    gravity: Callable[[Any], Any] | None  # g (n) [N·m]
    damping: Array  # (n) [N·m·s/rad]
    load: Array  # (n) [N·m]

    def mass(self, q: Any) -> Any:
        """Return M(q)."""
        import casadi as ca

        return ca.SX(self.inertia(q)) if callable(self.inertia) else ca.SX(ca.DM(self.inertia))

    def held(self, q: Any) -> Any:
        """Return g(q)."""
        import casadi as ca

        return ca.SX.zeros(self.mechanism.n) if self.gravity is None else ca.SX(self.gravity(q))


def statics_function(dynamics: Dynamics) -> Any:
    """Return the CasADi function (q, P) ↦ (τ - g, ∂τ/∂P, -∂(τ - g)/∂q, M, ∂l/∂q, A, B), with forces A P + B.

    Raises `InvalidInput` for muscles that are not affine and for routes without formulas.
    """
    import casadi as ca

    q, P = ca.SX.sym("q", dynamics.mechanism.n), ca.SX.sym("P", dynamics.mechanism.m)
    slope, A, B = _muscles(dynamics.mechanism, q)
    torque = -slope.T @ (A * P + B) - dynamics.held(q)  # (M1)
    made = [torque, -slope.T @ ca.diag(A), -ca.jacobian(torque, q), dynamics.mass(q), slope, A, B]
    return ca.Function("statics", [q, P], list(map(ca.densify, ca.cse(made))))


def motion_function(dynamics: Dynamics, rest: Array) -> Any:
    """Return the CasADi function (q, ω, P) ↦ (ω', A, B, -l', (½ ωᵀM ω, -ω·g)), with forces A P + B.

    The load pushes every joint away from `rest` (n) [rad]. Raises `InvalidInput` as `statics_function` does.
    """
    import casadi as ca

    n, m = dynamics.mechanism.n, dynamics.mechanism.m
    q, omega, P = ca.SX.sym("q", n), ca.SX.sym("omega", n), ca.SX.sym("P", m)
    slope, A, B = _muscles(dynamics.mechanism, q)
    M, g = dynamics.mass(q), dynamics.held(q)
    momentum = M @ omega
    kinetic = ca.dot(omega, momentum) / 2
    pushing = -slope.T @ ca.fmax(A * P + B, 0) - g - ca.DM(dynamics.damping) * omega
    pushing -= ca.jacobian(momentum, q) @ omega - ca.gradient(kinetic, q)
    if dynamics.load.any():
        pushing += ca.DM(dynamics.load) * ca.sign(q - ca.DM(rest))
    alpha = ca.ldl_solve(pushing, *ca.ldl(M))
    made = [alpha, A, B, -(slope @ omega), ca.vertcat(kinetic, -ca.dot(omega, g))]
    names = ["q", "omega", "P"], ["alpha", "gain", "force", "speed", "energy"]
    return ca.Function("motion", [q, omega, P], list(map(ca.densify, ca.cse(made))), *names)


def potential_function(dynamics: Dynamics, rest: Array, P: Array) -> Any:
    """Return the CasADi function q ↦ the energy [J] of muscles at `P` (m) [Pa], gravity and load above that at `rest`.

    It is the work along the straight way from the posture `rest` (n) [rad], by Gauss's quadrature.
    """
    import casadi as ca

    q = ca.SX.sym("q", dynamics.mechanism.n)
    away, statics = q - ca.DM(rest), statics_function(dynamics)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    level: Any = -ca.dot(ca.DM(dynamics.load), ca.fabs(away))
    for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        level -= weight * ca.dot(statics(ca.DM(rest) + float(node) * away, ca.DM(P))[0], away)
    return ca.Function("potential", [q], [ca.densify(ca.cse([level])[0])], ["q"], ["level"])


def _muscles(mechanism: Mechanism, q: Any) -> tuple[Any, Any, Any]:
    """Return ∂l/∂q (m, n), A (m) and B (m) of the forces A P + B at `q`."""
    import casadi as ca

    mechanism.check_affine("a governor")
    length = symbolic_lengths(mechanism.routes, q)
    eps = [(L - length[j]) / L for j, L in enumerate(mechanism.routes.rest_length)]
    pairs = list(zip(mechanism.muscles, eps, strict=True))
    A = ca.vertcat(*(muscle.gain(0.0, e) for muscle, e in pairs))
    return ca.jacobian(length, q), A, ca.vertcat(*(muscle.law(0.0, e) for muscle, e in pairs))


__all__ = ["Dynamics", "motion_function", "potential_function", "statics_function"]
