"""Corners of what is uncertain about a governed arm, which the governor simulates one by one.

Not all 2ᵏ corners are simulated. A muscle counts by what its strength adds to the torques that drive the joints out of
their range: for each combination of directions in which the n joints can leave, the muscles that pull that way are at
their strongest and the others at their weakest; besides, all are at their strongest or all at their weakest. For a
joint of two muscles that is every corner. Each is combined with the least and the greatest damping, masses and lags,
because less damping lets the arm swing farther but more damping holds it longer where pressures push it outwards.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.governor.model import Dynamics, statics_function


class Corners(NamedTuple):
    """Corners of strengths, damping, masses and lags, s of them."""

    values: Array  # (s, m + n + 1), see `Dynamics.bounds`
    lag: Array  # (s, m) [s]


def corners(dynamics: Dynamics, lag: Array, q: Array) -> Corners:
    """Return the corners to be simulated, with `lag` (2, m) [s] its bounds and `q` (n) [rad] a posture in the range.

    Without intervals there is one.
    """
    n, m = dynamics.mechanism.n, dynamics.mechanism.m
    bounds = dynamics.bounds
    rows = [
        np.concatenate([strength, bounds[damping, m : m + n], bounds[mass, m + n :], lag[slow]])
        for strength in _strengths(dynamics, q)
        for damping, mass, slow in product((0, 1), (1, 0), (1, 0))
    ]
    found = np.array(list(dict.fromkeys(map(tuple, np.array(rows).tolist()))))  # each once, the worst ones first
    return Corners(found[:, : m + n + 1], found[:, m + n + 1 :])


def _strengths(dynamics: Dynamics, q: Array) -> list[Array]:
    """Return rows (m) of strengths."""
    low, high = dynamics.strength
    slope = np.array(statics_function(dynamics)(q, np.zeros(dynamics.mechanism.m), dynamics.middle)[4])  # (m, n)
    towards = [-slope @ np.array(signs) > 0 for signs in product((1.0, -1.0), repeat=dynamics.mechanism.n)]
    return [*(np.where(pulls, high, low) for pulls in towards), low, high]
