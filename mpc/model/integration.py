"""Classical Runge–Kutta method for formulas of numbers or CasADi symbols; compiled code uses its tableau.

`variational` has the equations of a motion's derivatives, S' = ∂f/∂x S + (0, ∂f/∂v), from
S = ∂x/∂(x(0), v) = (1, 0).
"""

from collections.abc import Callable, Sequence

from allocator.calculus import Value
from allocator.lazy import SX, Function

NODES, SHARES = (0.0, 1 / 2, 1 / 2, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)


def integrated(rate: Callable[[Value, Value], Value], x: Value, duration: Value, substeps: int) -> Value:
    """Return the state after `duration` [s] of x' = rate(x, t) from `x` at t = 0, in `substeps` equal steps."""
    h = duration / substeps
    for step in range(substeps):
        begin, middle, end = step * h, (step + 1 / 2) * h, (step + 1) * h
        k1 = rate(x, begin)
        k2 = rate(x + h / 2 * k1, middle)
        k3 = rate(x + h / 2 * k2, middle)
        k4 = rate(x + h * k3, end)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


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
