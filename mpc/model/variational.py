"""Variational equations of a motion: S' = ∂f/∂x S + (0, ∂f/∂v), from S = ∂x/∂(x(0), v) = (1, 0)."""

from collections.abc import Sequence

from allocator.lazy import SX, Function


def variational(x: "SX", given: Sequence["SX"], v: "SX", rate: "SX") -> "Function":
    """Return the CasADi function (x, S, *given) ↦ (x', S') of x' = `rate`, an expression of `x` and `given`.

    `v` (k, 1) are the inputs by which S (n, n + k) differentiates. S has constant zeros; the S of the function, and S',
    have only the other entries, at the same places and in columns.
    """
    import casadi as ca

    n, k = x.numel(), v.numel()
    jacobian, source = ca.jacobian(rate, x), ca.horzcat(ca.SX(n, n), ca.jacobian(rate, v))
    pattern, grown = None, ca.horzcat(ca.DM.eye(n), ca.DM(n, k)).sparsity()
    while pattern is None or grown != pattern:
        pattern, S = grown, ca.SX.sym("S", grown)
        slope = jacobian @ S + source
        grown = pattern.unite(slope.sparsity())
    return ca.Function("variational", [x, S, *given], ca.cse([rate, ca.project(slope, pattern)]))
