"""The classical Runge–Kutta method serves formulas of numbers or CasADi symbols; compiled code takes its tableau."""

from collections.abc import Callable

from allocator.calculus import Value

NODES, SHARES = (0.0, 1 / 2, 1 / 2, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)


def integrated(rate: Callable[[Value], Value], x: Value, duration: Value, substeps: int) -> Value:
    """Return the state after `duration` [s] of x' = rate(x) from `x`, in `substeps` equal steps of fourth order."""
    h = duration / substeps
    for _ in range(substeps):
        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        k4 = rate(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x
