"""Postures of an arm whose hand follows a path."""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.endpoint.endpoint import Endpoint
from allocator.units import MM
from mpc.model.arm.ranges import about_the_middle

if TYPE_CHECKING:
    from mpc.model.arm.model import Arm

_NEAR = 0.1 * MM  # of the path
_STEPS = 60  # of Gauss and Newton
_LONGEST = 0.3  # [rad] greatest step


class OutOfReach(InvalidInput):
    """A place on a path that the hand does not reach; `sample` is its place in the path."""

    def __init__(self, sample: int, x: Array, missed: float) -> None:
        """Set the sample, the position `x` (dim,) [m] and the least distance `missed` [m]."""
        where, self.sample = ", ".join(f"{value / MM:g}" for value in x), sample
        super().__init__(
            f"the hand does not reach ({where}) mm within the ranges of the joints; the nearest it comes is "
            f"{missed / MM:.1f} mm away"
        )


def followed(arm: "Arm", hand: Endpoint, path: Array) -> Array:
    """Return postures (M, n) [rad] with the `hand` on the `path` (M, dim) [m].

    They follow from Gauss–Newton steps in q on |x(q) - x|². Each sample starts from the one before, so that the arm
    does not change sides. Raises `OutOfReach`.
    """
    starts = np.vstack([arm.middle, about_the_middle(arm)])
    found: list[Array] = []
    for k, x in enumerate(path):
        reached = (_posture(arm, hand, x, q) for q in (found[-1:] or starts))
        missed, q = next((one for one in reached if one[0] <= _NEAR), (np.inf, starts[0]))
        if missed > _NEAR:
            missed, q = min((_nearest(arm, hand, x, q) for q in (*found[-1:], *starts[:4])), key=lambda one: one[0])
        if missed > _NEAR:
            raise OutOfReach(k, x, missed)
        found.append(q)
    return np.array(found)


def _posture(arm: "Arm", hand: Endpoint, x: Array, q: Array) -> tuple[float, Array]:
    """Return the remaining distance of the hand from `x` (dim,) [m], and the posture (n,), sought from `q` on."""
    for _ in range(_STEPS):
        place = hand.at(q)
        off = x - place.position
        if np.abs(off).max() <= _NEAR / 100:
            break
        step = np.linalg.lstsq(place.jacobian, off, rcond=1e-6)[0]
        step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-12))
        q = np.clip(q + step, *arm.angle_limits)
    return float(np.linalg.norm(x - hand.at(q).position)), q


def _nearest(arm: "Arm", hand: Endpoint, x: Array, q: Array) -> tuple[float, Array]:
    """Return the results of `_posture`, by a slower method that can move along the ends of the ranges."""
    from scipy.optimize import least_squares

    q = np.clip(q, *arm.angle_limits)
    found = least_squares(lambda q: hand.at(q).position - x, q, lambda q: hand.at(q).jacobian, arm.angle_limits)
    return float(np.linalg.norm(found.fun)), found.x
