"""Formulas of a mechanism in CasADi symbols: muscle lengths, targets over pressures, the position of a hand.

Their values equal those of `allocator.mechanism.routes`, and CasADi differentiates them to any order.
"""

from typing import Any

from allocator.errors import InvalidInput
from allocator.lazy import SX, Function
from allocator.mechanism.endpoint.endpoint import Endpoint, LinkagePoint
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import Routes


def symbolic_lengths(routes: Routes, q: "SX") -> "SX":
    """Return the lengths l(q) (m, 1) [m] as a formula of the CasADi column `q` (n, 1).

    Raises `InvalidInput` for routes without a formula, such as tables.
    """
    import casadi as ca

    return ca.SX(ca.vertcat(*routes.symbolic(q)))


def has_formulas(routes: Routes) -> bool:
    """Return whether `symbolic_lengths` has formulas of these routes."""
    return type(routes).symbolic is not Routes.symbolic


def map_function(mechanism: Mechanism) -> "Function":
    """Return the CasADi function q ↦ (ε (m), A (m), B (m), y0 (d), M (d m), row by row), with forces F = A P + B.

    Raises `InvalidInput` for muscles that are not affine and for routes without formulas.
    """
    import casadi as ca

    mechanism.check_affine("formulas of the allocation")
    q, P = ca.SX.sym("q", mechanism.n), ca.SX.sym("P", mechanism.m)
    length, rest = symbolic_lengths(mechanism.routes, q), mechanism.routes.rest_length
    eps = [(L - length[j]) / L for j, L in enumerate(rest)]
    muscles = list(zip(mechanism.muscles, eps, strict=True))
    A = ca.vertcat(*(muscle.gain(0.0, e) for muscle, e in muscles))
    B = ca.vertcat(*(muscle.law(0.0, e) for muscle, e in muscles))
    torque = -ca.jacobian(length, q).T @ (A * P + B)  # (M1)
    stiffness = -ca.jacobian(torque, q)  # (M2)
    rows, columns = mechanism.upper_triangle
    entries = [stiffness[i, j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)]
    y = ca.vertcat(torque, *entries)
    y0, M = ca.substitute(y, P, 0), ca.jacobian(y, P)
    if ca.depends_on(M, P):
        raise InvalidInput("the targets of this mechanism are not affine in the pressures")
    made = ca.cse([ca.vertcat(*eps), A, B, y0, ca.vec(M.T)])
    return ca.Function(
        "mechanism", [q], list(map(ca.densify, made)), ["q"], ["contraction", "gain", "force", "y0", "M"]
    )


def symbolic_position(endpoint: Endpoint, q: "SX") -> "SX":
    """Return the position x (dim, 1) of an endpoint as a formula of the CasADi column `q` (n, 1)."""
    import casadi as ca

    point: Any = endpoint.kinematics
    if not isinstance(point, LinkagePoint):
        return ca.SX(point.column(q))
    R, origin = point.linkage.symbolic_frames(q)[point.site.link]
    x = ca.SX(origin + R @ ca.DM(point.site.position))
    return ca.vertcat(*(x["xyz".index(axis)] for axis in point.axes))


def symbolic_jacobian(endpoint: Endpoint, q: "SX") -> "SX":
    """Return J = ∂x/∂q (dim, n) of an endpoint as a formula of the CasADi column `q` (n, 1)."""
    import casadi as ca

    return ca.densify(ca.jacobian(symbolic_position(endpoint, q), q))
