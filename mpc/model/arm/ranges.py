"""Properties of an arm over the ranges of its joints.

Postures of an arm whose hand follows a path.
"""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.endpoint.endpoint import Endpoint
from allocator.units import MM

if TYPE_CHECKING:
    from mpc.model.arm.model import Arm


def about_the_middle(arm: "Arm") -> Array:
    """Return some postures (32, n) [rad] of the middle halves of the ranges."""
    low, high = arm.angle_limits
    return np.asarray(low + (0.25 + 0.5 * np.random.default_rng(0).random((32, arm.n))) * (high - low))


def middle(arm: "Arm") -> Array:
    """Return a posture (n,) [rad] in the middle of the ranges, or near it if the endpoint is singular there."""
    low, high = arm.angle_limits
    if arm.endpoint is None:
        return np.asarray((low + high) / 2)
    postures = about_the_middle(arm)
    sizes = np.linalg.svd(arm.endpoint.jacobian(postures), compute_uv=False)
    return np.asarray(postures[np.argmax(sizes[:, -1])])


def lever(arm: "Arm") -> float:
    """Return the mean size [m/rad] of the endpoint's Jacobian over some postures; 1 for the joints' own stiffness."""
    if arm.endpoint is None:
        return 1.0
    J = arm.endpoint.jacobian(about_the_middle(arm))
    return float(np.sqrt(np.mean((J**2).sum(axis=(-1, -2)) / arm.tracked)))


def torque_reach(arm: "Arm") -> tuple[Array, Array]:
    """Return the greatest |T| (n,) [N·m] of the muscles together in the middle of the ranges, and anywhere."""
    q = np.vstack([arm.middle, about_the_middle(arm)])
    P = np.full((len(q), arm.m), arm.pressure_limits[1])
    pulls = np.abs(arm.mechanism.arms(q)) * np.abs(arm.mechanism.forces(q, P))[..., None]
    torques = pulls.sum(axis=-2)
    return torques[0], torques.max(axis=0)


def fastest_rate(arm: "Arm") -> float:
    """Return an estimate of the fastest eigenvalue [1/s] at full pressure."""
    low, high = arm.angle_limits
    fastest = float(np.max(1 / arm.lags))
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        q = low + share * (high - low) if arm.has_stops else np.zeros(arm.n)
        P = np.full(arm.m, arm.pressure_limits[1])
        # stiffness at fast motions
        own = arm.mechanism.stiffness(q, P, "open" if arm.gas is None else "shut")
        stiff = own + arm.bodies.gravity_stiffness(q)
        below = -np.linalg.solve(arm.bodies.mass_matrix(q), np.hstack([stiff, np.diag(arm.bodies.damping)]))
        both = np.vstack([np.hstack([np.zeros((arm.n, arm.n)), np.eye(arm.n)]), below])
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(both)).max()))
    return fastest


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
