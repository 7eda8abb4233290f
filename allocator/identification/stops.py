"""End stops of a joint in measured angles: extreme angles that many readings share although their pressures differ."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.units import DEG

_NEAR = (0.04, 0.02, 0.01, 0.005)  # of the range of the angle: how near to an extreme one angles are at a stop
_OFTEN = 0.05  # of the readings
_LEAST = 3  # readings
_LEVEL = 0.05  # of the angle's mean slope with the pressure difference: a stop holds the angle
_ROUNDS = 4
_PUSHED = 0.2  # of the range of the pressure difference, at least


class Stop(NamedTuple):
    """End stop at which some readings rest."""

    end: str  # "greatest" or "least"
    angle: float  # [rad]
    there: Mask  # (n,) readings that rest on it


def stops(theta: Array, P1: Array, P2: Array) -> Iterator[Stop]:
    """Yield each end of the angles `theta` (n,) [rad] that looks like a stop.

    Many readings there have about the same angle, although their pressures `P1` and `P2` (n,) [Pa] differ so much that
    a free joint would turn.
    """
    if not theta.size:
        return
    greatest = max(float(P1.max()), float(P2.max()))
    q, span = (P1 - P2) / (P1 + P2 + greatest / 2), np.ptp(theta)
    for end, extreme in (("greatest", float(theta.max())), ("least", float(theta.min()))):
        for near in _NEAR:
            there = np.abs(theta - extreme) <= near * span
            if there.sum() < _LEAST or there.mean() < _OFTEN:
                break
            pushed = np.ptp(np.percentile(q[there], [5, 95])) / max(np.ptp(q), 1e-300)
            if pushed >= max(_PUSHED, near / _LEVEL):
                yield Stop(end, *_whole(theta, extreme, near * span))
                break


def _whole(theta: Array, extreme: float, width: float) -> tuple[float, Mask]:
    """Return the angle of a stop, and the readings (n,) on both sides of it.

    Noise is even about the stop, and `extreme` is its end, so that the other end is as far from the middle.
    """
    for _ in range(_ROUNDS):
        middle = float(np.median(theta[np.abs(theta - extreme) <= width]))
        width = max(width, 2 * abs(extreme - middle))
    return middle, np.asarray(np.abs(theta - extreme) <= width)


def described(stop: Stop) -> str:
    """Return a sentence about a stop."""
    return (
        f"{stop.there.mean():.0%} of the angles are the {stop.end} one, {stop.angle / DEG:.3g}°, whatever the "
        "pressures: the fit knows no stops; leave such rows out, or stay between the stops"
    )
