"""End stops of a joint in measured angles: extreme angles that many readings share although their pressures differ."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.units import DEG

_SAME_ANGLE = (0.04, 0.02, 0.01, 0.005)  # of the range of the angle: how near to an extreme one angles are at a stop
_OFTEN = 0.05  # of the readings
_FEWEST = 3  # readings
_LEVEL = 0.05  # of the angle's mean slope with the pressure difference: a stop holds the angle
_ROUNDS = 4
_PUSHED = 0.2  # of the range of the pressure difference, at least
_FLAT = 0.1  # of the mean slope: a group of rests with a smaller slope, by two standard deviations, is held by a stop
_FEWEST_RESTS, _APART = 5, 0.08  # rests of a group, and its part of the range of the pressure difference, at least
_SCATTER = 3.0  # standard deviations of the rests on a stop


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
    q, span = _difference(P1, P2), np.ptp(theta)
    for end, extreme in (("greatest", float(theta.max())), ("least", float(theta.min()))):
        for near in _SAME_ANGLE:
            there = np.abs(theta - extreme) <= near * span
            if there.sum() < _FEWEST or there.mean() < _OFTEN:
                break
            pushed = np.ptp(np.percentile(q[there], [5, 95])) / max(np.ptp(q), 1e-300)
            if pushed >= max(_PUSHED, near / _LEVEL):
                yield Stop(end, *_whole(theta, extreme, near * span))
                break


def stops_of_rests(theta: Array, P1: Array, P2: Array) -> dict[str, Stop]:
    """Return the stops of angles at rest, by their ends.

    In addition to those of `stops`, these are ends at which the angle hardly changes with the pressure difference, so
    that stops are also found under noise and with few rests, whose angles are spread.
    """
    found = {stop.end: stop for stop in stops(theta, P1, P2)}
    if theta.size < 2 * _FEWEST_RESTS or not np.ptp(q := _difference(P1, P2)):
        return found
    usual = _FLAT * abs(float(np.polyfit(q, theta, 1)[0]))
    for end, sign in (("greatest", 1.0), ("least", -1.0)):
        order = np.argsort(-sign * q)
        for count in range(theta.size // 2, _FEWEST_RESTS - 1, -1):
            group = order[:count]
            x, y = q[group] - q[group].mean(), theta[group] - theta[group].mean()
            if np.ptp(x) < _APART * np.ptp(q):
                break
            slope = float(x @ y) / float(x @ x)
            scatter = float(np.sqrt(((y - slope * x) ** 2).sum() / (count - 2)))
            if abs(slope) + 2 * scatter / np.sqrt(x @ x) <= usual:
                angle = float(theta[group].mean())
                found[end] = Stop(end, angle, np.asarray(sign * (theta - angle) >= -_SCATTER * scatter - 1e-12))
                break
    return found


def _difference(P1: Array, P2: Array) -> Array:
    """Return the pressure difference (n,) over the sum [-], which determines the angle of a free joint roughly."""
    return np.asarray((P1 - P2) / (P1 + P2 + max(float(P1.max()), float(P2.max())) / 2))


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
        "pressures: taken for an end stop, and left out of the fit; stay between the stops"
    )
