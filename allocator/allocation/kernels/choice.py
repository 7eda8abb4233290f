"""Which kernel answers for a joint, and with which numbers; and for what kinds of arguments it is compiled."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.kernels.numbers import AffineNumbers, TonduNumbers
from allocator.calculus import Array, Value, derivative
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.one_muscle import Side
from allocator.muscles import AffineMuscle

Kernel = Callable[..., Any]

_REMEMBERED = 64  # joints


class Law(NamedTuple):
    """The kernel of a joint."""

    joint: AntagonistJoint
    name: str  # "tondu", "affine", or "" where there is none
    p: tuple[Any, ...]  # the joint's numbers
    left: float  # joint range [rad]
    right: float


Kind = tuple[str, bool, bool, bool, bool | None]
"""What a kernel is compiled for: the law; whether there is a least, a greatest force, a slew limit; priority."""

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
    return [_coefficients(side) for side in joint.sides(theta)]


def _coefficients(side: Side) -> tuple[Value, ...]:
    """As `side` has them, but A, B and their derivatives are evaluated once."""
    muscle, eps = side.muscle, side.contraction
    assert isinstance(muscle, AffineMuscle)
    A, B = muscle.gain(0.0, eps), muscle.law(0.0, eps)
    elastic, geometric = -(side.arm**2) / side.rest_length, -side.sign * side.arm_slope
    k1 = elastic * muscle.gain_slope(0.0, eps) + geometric * A
    return A, B, side.arm, k1, elastic * derivative(muscle.B, eps) + geometric * B


def arrays(values: tuple[Value, ...], n: int) -> tuple[Array, ...]:
    """Each value as an array (n,) that a compiled loop takes."""
    return tuple(np.ascontiguousarray(np.broadcast_to(value, n), dtype=float) for value in values)


__all__ = ["Kernel", "Kind", "Law", "arrays", "coefficients", "law_of"]
