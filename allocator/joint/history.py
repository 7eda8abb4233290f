"""The angle after a history of pressures is found here: quasi-static, so that only their order counts, not their times.

With a Prandtl–Ishlinskii operator H the static angles go through it, θ = H[u(P1, P2)]. With friction μ alone each angle
is the root of

    T(θ, P) - μ (a1 F1 + a2 F2) z = load,    z = s - (s - z_0) exp(-|Δθ|/δ),  s = sign(Δθ)          Dahl 1968

z_0 that of the angle before: exact however far the joint turns, as long as it turns one way between two pressures.
"""

from collections.abc import Callable
from math import copysign, exp

import numpy as np

from allocator.calculus import Array
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.units import DEG

PRESLIDING = 0.5 * DEG  # δ of measured joints in slow sweeps [rad]
_PIECES = 32  # of the way to the end of the joint range in which the nearest root is looked for


def dahl(z: float, motion: float, presliding: float = PRESLIDING) -> float:
    """Return the state z [-] of Dahl's friction after turning by `motion` [rad] in one direction."""
    s = copysign(1.0, motion)
    return s - (s - z) * exp(-abs(motion) / presliding)


def through_plays(H: PrandtlIshlinskii, u: Array, filled: Array) -> Array:
    """Return θ (m,) [rad] for the static angles u (m,) [rad], NaN where there is none: the memory stays."""
    theta, known = np.full(u.size, np.nan), np.isfinite(u)
    theta[known] = H.run(u[known], filled[known])
    return theta


Excess = Callable[[float, float, float, float], float]  # (θ [rad], P1, P2 [Pa], z [-]) ↦ torque beyond the load [N·m]


def through_friction(excess: Excess, start: float, P1: Array, P2: Array, ends: tuple[float, float]) -> Array:
    """Return θ (m,) [rad] as the pressures go through P1, P2 (m,) [Pa], from rest without friction at `start` [rad].

    The `excess` falls with θ. NaN where the joint would leave its range, `ends` [rad]: the memory stays.
    """
    theta, found, z = start, np.full(P1.size, np.nan), 0.0
    for k, (one, two) in enumerate(zip(P1.tolist(), P2.tolist(), strict=True)):
        moved = _settled(excess, theta, z, one, two, ends)
        if np.isfinite(moved):
            z = dahl(z, moved - theta)
            found[k] = theta = moved
    return found


def _settled(
    excess: Excess,
    theta: float,
    z: float,
    P1: float,
    P2: float,
    ends: tuple[float, float],
) -> float:
    """Return the first angle [rad] without excess, on the way that the torque drives from `theta`."""
    from scipy.optimize import brentq

    def balance(at: float) -> float:
        return excess(at, P1, P2, dahl(z, at - theta))

    here = balance(theta)
    if here == 0:
        return theta
    way = np.linspace(theta, ends[1] if here > 0 else ends[0], _PIECES + 1)
    for near, far in zip(way[:-1].tolist(), way[1:].tolist(), strict=True):
        if balance(far) * here <= 0:
            return float(brentq(balance, near, far, xtol=1e-12))
    return float("nan")
