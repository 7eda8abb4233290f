"""Friction of an exported controller: the kind of model, its elements and its dependence on the state.

Both supported models are T_f = strength · Σ k_i m_i. The angle moves the memories m_i, each bounded by a half width
that `scale` multiplies; `mpc/export/c/mpc/friction.c` moves them.
"""

from collections.abc import Iterator, Sequence
from math import inf
from typing import Any

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.lazy import Function
from mpc.export.joint import Numbers
from mpc.model.arm.pressing import symbolic_loads
from mpc.model.compensation import Compensation
from mpc.model.friction.contact import Contact, Hysteresis, Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.machine import Machine
from mpc.model.plant import Plant

_NEVER = 1e30  # [rad], in place of an infinite width


def check_frictions(known: Compensation, n: int) -> None:
    """Raise `InvalidInput` for friction models of `n` joints without a C implementation, or of different kinds."""
    frictions = known.of_joints(n)
    for friction in frictions:
        if not isinstance(friction, Friction | MaxwellSlip):
            raise InvalidInput(
                f"a controller with friction {type(friction).__name__} cannot be exported: the C code supports "
                "Dahl's Friction and MaxwellSlip"
            )
    if len(set(map(type, frictions))) > 1:
        raise InvalidInput(
            "a controller with Dahl's Friction at one joint and MaxwellSlip at another cannot be exported: take one "
            "kind for all joints"
        )


def _slips(frictions: Sequence[Hysteresis]) -> bool:
    return isinstance(frictions[0], MaxwellSlip)


def friction_sizes(frictions: Sequence[Hysteresis]) -> Numbers:
    """Return the sizes of the friction memory."""
    return {
        "SLIPS": (int(_slips(frictions)), "1 for Maxwell slip, 0 for Dahl's friction"),
        "ELEMENTS": (max(friction.size for friction in frictions), "numbers in the friction memory of a joint"),
    }


def friction_numbers(frictions: Sequence[Hysteresis]) -> Numbers:
    """Return the parameters of the model."""
    return {"NEVER": (_NEVER, "half width of an element that never slips [rad]")} if _slips(frictions) else {}


def friction_tables(frictions: Sequence[Any]) -> Iterator[tuple[str, str, Array]]:
    """Yield the parameters of every joint's friction: name, meaning, values."""
    if not _slips(frictions):
        yield "ANT_PRESLIDING", "presliding of Dahl's friction [rad]", np.array([f.presliding for f in frictions])
        return
    springs, widths = np.zeros((2, len(frictions), max(f.size for f in frictions)))
    widths[:] = _NEVER  # absent elements have no spring
    for i, friction in enumerate(frictions):
        springs[i, : friction.size] = friction.springs
        widths[i, : friction.size] = [_NEVER if r == inf else r for r in friction.widths]
    unit = "-" if frictions[0].elastic else "N*m/rad"
    yield "ANT_SPRINGS", f"stiffnesses of the Maxwell-slip elements of each joint [{unit}]", springs
    yield "ANT_WIDTHS", "their half widths at a mean pressure of 2.5 bar [rad]", widths


def friction_function(known: Compensation, plant: Machine) -> tuple["Function", str]:
    """Return the CasADi function from the state to the two load numbers of friction, and its description."""
    import casadi as ca

    x = ca.SX.sym("x", plant.size)
    loads: Sequence[Any] = [Contact(plant, x)] if isinstance(plant, Plant) else symbolic_loads(plant, x)
    pairs = [_of_state(friction, load) for friction, load in zip(known.of_joints(plant.n), loads, strict=True)]
    strength, scale = (ca.densify(ca.SX(ca.vertcat(*each))) for each in zip(*pairs, strict=True))
    function = ca.Function("friction", [x], ca.cse([strength, scale]), ["x"], ["strength", "scale"])
    return function, "greatest torque of Dahl's friction [N*m], or the factor of the springs; scale of their widths"


def _of_state(friction: Any, load: Loads) -> tuple[Value, Value]:
    if isinstance(friction, MaxwellSlip):
        return friction.strength(load), friction.scale(load.filled)
    return friction.most(load), 1.0
