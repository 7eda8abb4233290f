"""Properties of an arm over the ranges of its joints."""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array

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
