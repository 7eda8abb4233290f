"""`kernel_of` chooses the kernel that answers for a joint; a `Kind` is what a kernel is compiled for."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.kernels.numbers import AffineNumbers, TonduNumbers
from allocator.calculus import Array, Value
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import Shares
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import AffineMuscle

Kernel = Callable[..., Any]

_REMEMBERED = 64  # joints


class JointKernel(NamedTuple):
    """A `JointKernel` is the kernel that answers for a joint, with the joint's numbers."""

    joint: AntagonistJoint
    name: str  # "tondu", "affine", or "" where there is none
    p: tuple[Any, ...]  # the joint's numbers
    left: float  # joint range [rad]
    right: float


Kind = tuple[str, bool, bool, bool, bool | None]
"""What a kernel is compiled for: its name; whether there is a least, a greatest force, a slew limit; priority."""

_kernels: dict[int, JointKernel] = {}  # by the joint's id; the value holds its joint, so that the id stays taken


def kernel_of(joint: AntagonistJoint) -> JointKernel:
    """Return the kernel of `joint`, made once."""
    kernel = _kernels.get(id(joint))
    if kernel is None:
        if len(_kernels) >= _REMEMBERED:
            _kernels.clear()
        kernel = _kernels[id(joint)] = _chosen(joint)
    return kernel


def _chosen(joint: AntagonistJoint) -> JointKernel:
    for name, numbers in (("tondu", TonduNumbers.of(joint)), ("affine", AffineNumbers.of(joint))):
        if numbers is not None:
            return JointKernel(joint, name, tuple(numbers), *joint.angle_range)
    return JointKernel(joint, "", (), *joint.angle_range)


def coefficients(joint: AntagonistJoint, theta: Value, shares: Shares | None = None) -> list[tuple[Value, ...]]:
    """Return (A, B, a, k', k0) of both affine muscles at angles in the joint range, as `affine_exact` takes them."""
    return [_coefficients(side) for side in joint.sides(theta, shares)]


def _coefficients(side: OneMuscle) -> tuple[Value, ...]:
    """Return (A, B, a, k', k0) as `side` has them, but with A, B and their derivatives evaluated once."""
    muscle, eps = side.muscle, side.contraction
    assert isinstance(muscle, AffineMuscle)
    A, B = muscle.gain(0.0, eps), muscle.law(0.0, eps)
    elastic, geometric = -(side.arm**2) / side.rest_length, side.bend
    k1 = elastic * muscle.gain_slope(0.0, eps) + geometric * A
    k0 = elastic * muscle.passive_slope(eps) + geometric * B
    if side.share is None:
        return A, B, side.moment_arm, k1, k0
    side.check_volume(0.0)
    gas = side.share * side.trapped(0.0) / side.gas.atmosphere  # affine in P + p_a
    return A, B, side.moment_arm, k1 + gas, k0 + gas * side.gas.atmosphere


def arrays(values: tuple[Value, ...], n: int) -> tuple[Array, ...]:
    """Return each value as an array (n,) that a compiled loop takes."""
    return tuple(np.ascontiguousarray(np.broadcast_to(value, n), dtype=float) for value in values)
