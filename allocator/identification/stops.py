"""End stops of a joint in measured angles: extreme angles that many readings share although their pressures differ."""

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG

_AT_STOP = 0.005  # of the range of the angle: angles so near an extreme one are at it
_OFTEN = 0.05  # of the readings
_LEAST = 3  # readings
_PUSHED = 0.2  # of the range of the pressure difference, over which a stop holds the angle


def stops(theta: Array, P1: Array, P2: Array) -> tuple[str, ...]:
    """Return a sentence for each end of the angles `theta` (n,) [rad] that looks like a stop.

    `P1` and `P2` (n,) [Pa] are the pressures of both muscles.
    """
    greatest = max(float(P1.max()), float(P2.max()))
    q, found = (P1 - P2) / (P1 + P2 + greatest / 2), []
    for end, name in ((float(theta.max()), "greatest"), (float(theta.min()), "least")):
        there = np.abs(theta - end) <= _AT_STOP * np.ptp(theta)
        if there.sum() < _LEAST or there.mean() < _OFTEN:
            continue
        if np.ptp(np.percentile(q[there], [5, 95])) >= _PUSHED * np.ptp(q):
            found.append(
                f"{there.mean():.0%} of the angles are the {name} one, {end / DEG:.3g}°, whatever the pressures: the "
                "fit knows no stops; leave such rows out, or stay between the stops"
            )
    return tuple(found)
