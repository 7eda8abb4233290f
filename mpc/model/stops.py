"""End stops of joints: τ_i = -I_i (Ω² e + 2Ω ω_i) with the excess e beyond the range, springs and dampers that only
push back.

Numbers, arrays or CasADi symbols.
"""

from allocator.calculus import Value

STOP_RATE = 50.0  # Ω [1/s]; MuJoCo's stops have the same time constant, 0.02 s


def pushed_back(depth: Value, speed: Value, stiffness: Value, damping: Value) -> Value:
    """Return the force of a spring and a damper that only push, at the `depth` beyond their end and its rate `speed`.

    Units are those of a translation or a rotation.
    """
    force = stiffness * depth + damping * speed
    return force * (force > 0) * (depth > 0)


def stop_torque(q: Value, omega: Value, low: Value, high: Value, inertia: Value) -> Value:
    """Return the torques [N·m] of the stops at `low` and `high` [rad] on joints with these inertias [kg·m²]."""
    down = pushed_back(q - high, omega, STOP_RATE**2, 2 * STOP_RATE)
    up = pushed_back(low - q, -omega, STOP_RATE**2, 2 * STOP_RATE)
    return inertia * (up - down)
