"""Weights of the rows of a sag test, by what a law without a threshold pressure may be wrong there.

The bladder of a home-made muscle presses on the braid only above a threshold pressure P_t of 0.1 to 0.3 bar. A law that
knows none, fitted to equilibria far above it, is off by about P_t e^{-P/P_t} where a cable goes slack at P: the same
way in all rows. Their covariance is therefore

    σ² I + b bᵀ,    b_i = P_t e^{-P_i/P_t}
"""

import numpy as np

from allocator.calculus import Array
from allocator.identification.joint.samples import SlackReadings
from allocator.units import BAR

THRESHOLD = 0.3 * BAR  # P_t [Pa]


def weighed(sag: SlackReadings, error: Array, has_threshold: bool) -> Array:
    """Return errors (k,) [Pa] of the pressures, as independent ones of the standard deviation `sag.noise`.

    A law that has a threshold itself is held to the readings alone. Complex where `error` is.
    """
    if has_threshold:
        return error
    s = sag.samples
    b = THRESHOLD * np.exp(-np.where(sag.agonist, s.P1, s.P2) / THRESHOLD) / sag.noise
    square = float(b @ b)
    if square == 0:
        return error
    shrunk = 1 - 1 / np.sqrt(1 + square)  # (I + b bᵀ)^(-1/2) = I - shrunk b bᵀ/(bᵀ b)
    return np.asarray(error - shrunk * b * (b @ error) / square)
