"""The formulas of a mechanism are written here as a CasADi function, from its routes and its affine muscles."""

from typing import TYPE_CHECKING

from allocator.errors import InvalidInput
from allocator.mechanism import Mechanism
from mpc.model.lengths import symbolic_lengths

if TYPE_CHECKING:
    from casadi import Function


def map_function(mechanism: Mechanism) -> "Function":
    """Return the CasADi function q ↦ (ε (m), A (m), B (m), y0 (d), M (d m), row by row), with forces F = A P + B.

    Raises `InvalidInput` for muscles that are not affine and for routes without formulas.
    """
    import casadi as ca

    mechanism.check_affine("the exported allocation")
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
