"""Friction of an exported controller: the kind of model, its elements and its dependence on the state.

Both supported models are T_f = strength · Σ k_i m_i. The angle moves the memories m_i, each bounded by a half width
that `scale` multiplies; `mpc/export/c/mpc/friction.c` moves them.
"""

from collections.abc import Iterator
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from mpc.export.joint import Numbers
from mpc.model.friction.contact import Contact, Hysteresis
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.plant import NX, Plant

if TYPE_CHECKING:
    from casadi import Function

_NEVER = 1e30  # [rad], in place of an infinite width


def check_friction(friction: Hysteresis) -> None:
    """Raise `InvalidInput` for a friction model without a C implementation."""
    if not isinstance(friction, Friction | MaxwellSlip):
        raise InvalidInput(
            f"a controller with friction {type(friction).__name__} cannot be exported: the C code supports "
            "Dahl's Friction and MaxwellSlip"
        )


def friction_sizes(friction: Hysteresis) -> Numbers:
    """Return the sizes of the friction memory."""
    return {
        "SLIPS": (int(isinstance(friction, MaxwellSlip)), "1 for Maxwell slip, 0 for Dahl's friction"),
        "ELEMENTS": (friction.size, "numbers in the friction memory"),
    }


def friction_numbers(friction: Hysteresis) -> Numbers:
    """Return the parameters of the model."""
    if isinstance(friction, Friction):
        return {
            "FRICTION": (friction.mu, "mu [-]"),
            "COULOMB": (friction.coulomb, "[N*m]"),
            "PRESLIDING": (friction.presliding, "[rad]"),
        }
    return {"NEVER": (_NEVER, "half width of an element that never slips [rad]")}


def friction_tables(friction: Hysteresis) -> Iterator[tuple[str, str, Array]]:
    """Yield the elements of Maxwell slip: name, meaning, values."""
    if isinstance(friction, MaxwellSlip):
        widths = np.array([_NEVER if r == inf else r for r in friction.widths])
        unit = "-" if friction.elastic else "N*m/rad"
        yield "ANT_SPRINGS", f"stiffnesses of the Maxwell-slip elements [{unit}]", np.array(friction.springs)
        yield "ANT_WIDTHS", "their half widths at P1 + P2 = 5 bar [rad]", widths


def friction_function(friction: Hysteresis, plant: Plant) -> tuple["Function", str]:
    """Return the CasADi function from the state to the two load numbers of friction, and its description."""
    import casadi as ca

    x = ca.SX.sym("x", NX)
    press, scale = (ca.densify(ca.SX(value)) for value in _of_state(friction, Contact(plant, x)))
    function = ca.Function("friction", [x], [press, scale], ["x"], ["press", "scale"])
    return function, "pull [N*m] for Dahl's friction, or the factor of the springs; scale of their widths"


def _of_state(friction: Hysteresis, contact: Contact) -> tuple[Value, Value]:
    if isinstance(friction, MaxwellSlip):
        return friction.strength(contact), friction.scale(contact.filled)
    return contact.pulled, 1.0
