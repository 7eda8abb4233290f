"""Classical Runge–Kutta method for formulas of numbers or CasADi symbols; compiled code uses its tableau."""

from collections.abc import Callable

from allocator.calculus import Value

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
