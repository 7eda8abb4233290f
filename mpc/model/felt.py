"""Stiffness against the first push after a motion, from the friction's memory.

A steady loop is symmetric (`allocator.joint.felt`); the first push is not. A push in the direction of the last motion
meets the backbone alone; one that turns the joint back by A meets up to K + Σ k_i min(1, 2 ρ_i/A). With the memory m of
a hysteresis, as in plants under test and observers (`FrictionState`), a push by Δθ meets

    K_first = K + [T_f(m after Δθ) - T_f(m)]/Δθ
"""

from allocator import checks
from allocator.calculus import Value
from allocator.errors import InvalidInput
from mpc.model.friction.contact import Contact, Hysteresis


def first_push(friction: Hysteresis, memory: Value, motion: float, contact: Contact) -> float:
    """Return the stiffness [N·m/rad] against a push by `motion` [rad], with its sign, from a `memory`.

    It includes the isobaric stiffness of the `contact`. Raises `InvalidInput` for a push of 0.
    """
    by = checks.number("motion", motion, "rad")
    if by == 0:
        raise InvalidInput("motion = 0 rad is no push")
    before, after = (friction.torque(m, contact) for m in (memory, friction.moved(memory, by, contact)))
    return float(contact.stiffness + (after - before) / by)
