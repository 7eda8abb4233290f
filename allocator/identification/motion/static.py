"""What the static angle is a polynomial of: the equilibrium of a known joint, or the difference of both pressures."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline

_GRID = 36  # pressures a muscle
_LEAST_CONTRACTION = -0.2  # [-]: where the muscles would be longer than at rest the law is still asked


@dataclass(frozen=True)
class Difference:
    """The difference is q = (P1 - P2)/(P1 + P2 + P_max/2) [-], as pressures set the angle of joints of this kind."""

    greatest: float  # P_max [Pa]

    def __call__(self, P1: Array, P2: Array) -> Array:
        """Return q (…) [-]."""
        return (P1 - P2) / (P1 + P2 + self.greatest / 2)

    def stiffness(self, P1: Array, P2: Array) -> Array:
        """Return what the stiffness (…) is about in proportion to [Pa]: P1 + P2."""
        return np.asarray(P1 + P2)


@dataclass(frozen=True)
class Equilibrium:
    """The equilibrium is the angle q [rad] at which a joint rests without load, interpolated on a grid of pressures."""

    joint: AntagonistJoint
    greatest: float  # P_max [Pa]

    def __call__(self, P1: Array, P2: Array) -> Array:
        """Return q (…) [rad]."""
        return np.asarray(self._splines[0].ev(P1, P2))

    def stiffness(self, P1: Array, P2: Array) -> Array:
        """Return the stiffness (…) [N·m/rad] of the joint at rest."""
        return np.asarray(self._splines[1].ev(P1, P2))

    @cached_property
    def _splines(self) -> tuple["RectBivariateSpline", "RectBivariateSpline"]:
        """Return those of the angle at rest and of the stiffness there."""
        from scipy.interpolate import NearestNDInterpolator, RectBivariateSpline

        wide = replace(self.joint, angle_limits=None, covariance=None)
        low = min(self.joint.min_contraction, _LEAST_CONTRACTION)
        if all(muscle.min_contraction <= low for muscle in (self.joint.agonist, self.joint.antagonist)):
            wide = replace(wide, min_contraction=low)
        P = np.linspace(0.0, self.greatest, _GRID)
        P1, P2 = np.meshgrid(P, P, indexing="ij")
        theta = wide.equilibrium(P1, P2)
        known = np.isfinite(theta)
        if known.mean() < 0.5:
            raise InvalidInput(
                f"joint rests nowhere at {1 - known.mean():.0%} of the pressures up to {self.greatest:.3g} Pa: it is "
                "not the joint of this log"
            )
        K = np.full(theta.shape, np.nan)
        K[known] = wide.stiffness(theta[known], P1[known], P2[known])
        nearest = NearestNDInterpolator(np.stack([P1[known], P2[known]], axis=1), np.stack([theta, K], axis=-1)[known])
        there = np.where(known[..., None], np.stack([theta, K], axis=-1), nearest(P1, P2))
        return tuple(RectBivariateSpline(P, P, there[..., i], kx=1, ky=1) for i in (0, 1))
