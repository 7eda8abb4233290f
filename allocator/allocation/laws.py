"""Which kernel answers for a joint, and with which numbers; and for what kinds of arguments it is compiled."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.joint_numbers import AffineNumbers, TonduNumbers
from allocator.calculus import Array, Value
from allocator.joint import AntagonistJoint

Kernel = Callable[..., Any]

_REMEMBERED = 64  # joints


class Law(NamedTuple):
    """The kernel of a joint."""

    joint: AntagonistJoint
    name: str  # "tondu", "affine", or "" where there is none
    p: tuple[Any, ...]  # the joint's numbers
    left: float  # joint range [rad]
    right: float


class Kind(NamedTuple):
    """What a kernel is compiled for: the law, which limits there are, and the priority."""

    name: str
    taut: bool
    ceiling: bool
    slew: bool
    stiffness_first: bool | None


_laws: dict[int, Law] = {}  # by the joint's id; a Law holds its joint, so that the id stays taken


def law_of(joint: AntagonistJoint) -> Law:
    """The law of `joint`; made once."""
    law = _laws.get(id(joint))
    if law is None:
        if len(_laws) >= _REMEMBERED:
            _laws.clear()
        law = _laws[id(joint)] = _law(joint)
    return law


def _law(joint: AntagonistJoint) -> Law:
    for name, numbers in (("tondu", TonduNumbers.of(joint)), ("affine", AffineNumbers.of(joint))):
        if numbers is not None:
            return Law(joint, name, tuple(numbers), *joint.angle_range)
    return Law(joint, "", (), *joint.angle_range)


def coefficients(joint: AntagonistJoint, theta: Value) -> list[tuple[Value, ...]]:
    """(A, B, a, k', k0) of both affine muscles at angles in the joint range, as `kernels.affine_exact` takes them."""
    return [
        (
            side.muscle.gain(0.0, side.contraction),
            side.muscle.force(0.0, side.contraction),
            side.arm,
            side.stiffness_gain(0.0),
            side.stiffness(0.0),
        )
        for side in joint.sides(theta)
    ]


def arrays(values: tuple[Value, ...], n: int) -> tuple[Array, ...]:
    """Each value as an array (n,) that a compiled loop takes."""
    return tuple(np.ascontiguousarray(np.broadcast_to(value, n), dtype=float) for value in values)


__all__ = ["Kernel", "Kind", "Law", "arrays", "coefficients", "law_of"]
