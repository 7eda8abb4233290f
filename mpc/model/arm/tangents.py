"""Pressures along a motion of an arm whose muscles are not affine in the pressure, by tangents of the muscle models.

About pressures P̄ the force of every muscle is F ≈ F(P̄, ε) + F_P(P̄, ε) (P - P̄), which is affine. The kernel of
affine muscles therefore solves all samples in one call; its solution is the next P̄. This is Newton's method on the
optimality conditions, which settles at the solution of `allocate` for the models themselves, without a proof.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from allocator.allocation import allocate
from allocator.allocation.box.result import BoxAllocation
from allocator.calculus import Array, Value
from allocator.joint.gas import Stiffness
from allocator.joint.limits import Limits
from allocator.muscles.base import NOT_A_NUMBER, AffineMuscle, Muscle
from allocator.units import BAR

if TYPE_CHECKING:
    from mpc.model.arm.model import Arm

_MOST_PASSES = 10
_SETTLED = 1e-3 * BAR  # [Pa] greatest change by the last pass: the next one moves a pressure by about the square


@dataclass(frozen=True, eq=False)
class TangentMuscle(AffineMuscle):
    """Tangent in the pressure of the model `of` a muscle, about a pressure [Pa] at every posture."""

    of: Muscle = field(kw_only=True, metadata=NOT_A_NUMBER)
    about: Array = field(kw_only=True, metadata=NOT_A_NUMBER)

    @property
    def max_pressure(self) -> float:
        """Greatest pressure of the muscle [Pa]."""
        return self.of.max_pressure

    @property
    def min_contraction(self) -> float:
        """Least contraction of the muscle [-]."""
        return self.of.min_contraction

    def A(self, eps: Value) -> Value:
        """Return F_P(P̄, ε) [N/Pa]."""
        return self.of.gain(self.about, eps)

    def B(self, eps: Value) -> Value:
        """Return F(P̄, ε) - P̄ F_P(P̄, ε) [N]."""
        return self.of.law(self.about, eps) - self.about * self.A(eps)

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """Return F_Pε(P̄, ε) [N/Pa]."""
        return self.of.gain_slope(self.about, eps) + 0.0 * P

    def passive_slope(self, eps: Value) -> Value:
        """Return F_ε(P̄, ε) - P̄ F_Pε(P̄, ε) [N]."""
        return self.of.slope(self.about, eps) - self.about * self.of.gain_slope(self.about, eps)


def allocated(arm: "Arm", theta: Array, K: Array, T: Array, min_force: float) -> BoxAllocation:
    """Return the pressures of an arm along a motion: angles (M, n), stiffness (M, k, k) and torques (M, n)."""
    mechanism, limits = arm.mechanism, Limits(min_force)
    kind, along = Stiffness(endpoint=arm.endpoint), 0 if len(theta) > 1 else None
    if mechanism.affine:
        return allocate(theta, K, T, joint=mechanism, limits=limits, stiffness=kind, along=along)
    P = np.full((len(theta), arm.m), np.mean(arm.pressure_limits))
    for _ in range(_MOST_PASSES):
        laws = zip(mechanism.muscles, P.T, strict=True)
        tangents = mechanism.with_muscles([TangentMuscle(of=muscle, about=about) for muscle, about in laws])
        found = allocate(theta, K, T, joint=tangents, limits=limits, stiffness=kind, along=along)
        moved, P = np.abs(found.P - P).max(), found.P
        if moved < _SETTLED:
            break
    return found
