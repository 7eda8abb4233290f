"""Choice of the kernel for a joint, and the joint's numbers that the kernel takes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.status import CLOSED_FORM
from allocator.calculus import Array, Value
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import Shares
from allocator.joint.limits import Limit
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import AffineMuscle

_MOST_Z = 0.5  # the region in which the fixed number of Newton steps of `kernels` is proved
_MOST_KAPPA = 0.8
_REMEMBERED = 64  # joints


class TonduNumbers(NamedTuple):
    """Numbers `p` of two equal Tondu2021 on a pulley; pass `tuple(numbers)`, which is faster."""

    S: float  # [m²]
    R: float  # [m]
    l0: float  # [m]
    eps0: float  # [-]
    q: float  # a - b [-]
    c: float  # [Pa]
    d: float  # [Pa]
    e: float  # [Pa²]
    g: float  # e - c d [Pa²]
    lo: float  # supply [Pa]
    hi: float  # supply or validity [Pa]
    least: float  # the formulas are proved from this pressure [Pa]
    most: float  # up to this one
    left: float  # joint range [rad]
    right: float
    near: float  # a pressure this near to a bound lies on it [Pa]
    hi_limit1: int  # Limit flag of `hi` for the agonist
    hi_limit2: int
    below: int  # what ends the joint range on the left
    above: int  # and on the right

    @classmethod
    def of(cls, joint: AntagonistJoint) -> "TonduNumbers | None":
        """Return the numbers of `joint`, or None if it is of another kind or the steps are not proved for it."""
        closed = joint.tondu_pulley
        if closed is None:
            return None
        m, pulley = closed.muscle, closed.pulley
        valid = m.max_pressure < joint.pressure_limits[1]
        lo, hi = joint.pressure_limits[0], min(m.max_pressure, joint.pressure_limits[1])
        numbers = cls(
            S=m.S,
            R=pulley.radius,
            l0=pulley.rest_length,
            eps0=pulley.initial_contraction,
            q=m.a - m.b,
            c=m.c,
            d=m.d,
            e=m.e,
            g=m.g,
            lo=lo,
            hi=hi,
            least=lo,
            most=hi,
            left=joint.angle_range[0],
            right=joint.angle_range[1],
            near=CLOSED_FORM.binds * joint.pressure_span,
            hi_limit1=int(Limit.AGONIST_VALIDITY if valid else Limit.P1_UPPER),
            hi_limit2=int(Limit.ANTAGONIST_VALIDITY if valid else Limit.P2_UPPER),
            below=int(joint.angle_limit(False)),
            above=int(joint.angle_limit(True)),
        )
        return numbers if numbers.settles else None

    @property
    def settles(self) -> bool:
        """Whether the Newton steps suffice over the whole supply range, and that range is proper."""
        if not (0 <= self.lo < self.hi < -self.d):
            return False
        weakest, strongest = 1 / (self.lo + self.d), 1 / (self.hi + self.d)
        z = (strongest - weakest) / (strongest + weakest)
        return z <= _MOST_Z and -self.g * self.eps0 * strongest**2 / self.q <= _MOST_KAPPA


class AffineNumbers(NamedTuple):
    """Numbers `p` of a joint with two affine muscles; pass `tuple(numbers)`."""

    lo: float  # supply [Pa]
    most1: float  # supply or validity [Pa]
    most2: float
    left: float  # joint range [rad]
    right: float
    near: float  # a pressure this near to a bound lies on it [Pa]
    hi_limit1: int  # Limit flag of `most1`
    hi_limit2: int
    below: int  # what ends the joint range on the left
    above: int  # and on the right

    @classmethod
    def of(cls, joint: AntagonistJoint) -> "AffineNumbers | None":
        """Return the numbers of `joint`, None if a muscle is not affine."""
        lo, supply = joint.pressure_limits
        valid1, valid2 = joint.agonist.max_pressure, joint.antagonist.max_pressure
        numbers = cls(
            lo=lo,
            most1=min(valid1, supply),
            most2=min(valid2, supply),
            left=joint.angle_range[0],
            right=joint.angle_range[1],
            near=CLOSED_FORM.binds * joint.pressure_span,
            hi_limit1=int(Limit.AGONIST_VALIDITY if valid1 < supply else Limit.P1_UPPER),
            hi_limit2=int(Limit.ANTAGONIST_VALIDITY if valid2 < supply else Limit.P2_UPPER),
            below=int(joint.angle_limit(False)),
            above=int(joint.angle_limit(True)),
        )
        return numbers if joint.affine and lo < min(numbers.most1, numbers.most2) else None


Kernel = Callable[..., Any]


class JointKernel(NamedTuple):
    """Kernel of a joint, with the joint's numbers."""

    joint: AntagonistJoint
    name: str  # "tondu", "affine", or "" for none
    p: tuple[Any, ...]  # the joint's numbers
    left: float  # joint range [rad]
    right: float


Kind = tuple[str, bool, bool, bool, bool | None]
"""Key of a compiled kernel: its name; whether there is a least, a greatest force, a slew limit; priority."""

_kernels: dict[int, JointKernel] = {}  # by the joint's id; the value holds the joint, so the id stays in use


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
    """Return (A, B, a, k', k0) of `side`, with A, B and their derivatives evaluated once."""
    muscle, eps = side.muscle, side.contraction
    assert isinstance(muscle, AffineMuscle)
    A, B = muscle.gain(0.0, eps), muscle.passive_force(eps)
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
