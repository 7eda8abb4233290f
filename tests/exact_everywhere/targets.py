"""Targets: random ones over 1.5 times the feasible range, and those of random pressures."""

import numpy as np

from .dense_search import Targets

STRETCH = 1.5
LEAST_STIFFNESS = 0.01  # [N·m/rad] targets must be positive


def random_targets(reach, each, rng):
    """Return `each` targets at every angle of the image, most of them infeasible."""
    row = np.repeat(np.arange(reach.theta.size), each)
    wanted = []
    for name in "tk":
        one, two = (getattr(curve, name) for curve in reach.curves)
        low, high = (one.min(1) + two.min(1))[row], (one.max(1) + two.max(1))[row]
        wanted.append((low + high) / 2 + STRETCH * rng.uniform(-0.5, 0.5, row.size) * (high - low))
    return Targets(row, wanted[0], np.maximum(wanted[1], LEAST_STIFFNESS))


def made_targets(joint, reach, each, rng):
    """Return torque and stiffness of random taut pressures at every angle, if the stiffness is positive."""
    row = np.repeat(np.arange(reach.theta.size), each)
    shares = rng.uniform(size=(2, row.size))
    P1, P2 = (lo[row] + share * (hi - lo)[row] for share, lo, hi in zip(shares, reach.lo, reach.hi, strict=True))
    theta = reach.theta[row]
    targets = Targets(row, joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2))
    return targets.take(targets.K > LEAST_STIFFNESS)
