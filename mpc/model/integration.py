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


def swung(
    accelerate: Callable[[Value, Value, Value], Value],
    pressures: Callable[[Value, Value], Value],
    state: tuple[Value, Value, Value],
    h: Value,
    steps: int,
) -> tuple[Value, Value, Value]:
    """Return (q, ω, P) after `steps` of `h` [s] of q'' = accelerate(q, ω, P), along pressures that are known.

    `pressures(P, t)` is what they are a time `t` after `P`.
    """
    q, omega, P = state
    for _ in range(steps):
        middle, end = pressures(P, h / 2), pressures(P, h)
        a1 = accelerate(q, omega, P)
        v2 = omega + h / 2 * a1
        a2 = accelerate(q + h / 2 * omega, v2, middle)
        v3 = omega + h / 2 * a2
        a3 = accelerate(q + h / 2 * v2, v3, middle)
        v4 = omega + h * a3
        a4 = accelerate(q + h * v3, v4, end)
        q = q + h / 6 * (omega + 2 * v2 + 2 * v3 + v4)
        omega, P = omega + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), end
    return q, omega, P
