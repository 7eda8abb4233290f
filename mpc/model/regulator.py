"""Pressure regulator of first order whose pressures rise and fall with different time constants.

    P' = (u - P)/τ_up if u > P, else (u - P)/τ_down
       = a e + b |e|,     e = u - P,     a, b = (1/τ_up ± 1/τ_down)/2

The slope a at e = 0 is between those of both ways.
"""

from collections.abc import Sequence

from allocator.calculus import Value

_ALIKE = 0.05  # relative difference of two lags below which one represents both


def pull(e: Value, up: float, down: float) -> Value:
    """Return the rate [Pa/s] of a pressure that is `e` [Pa] below its command, with the lags `up` and `down` [s].

    `e` is a number, an array or a CasADi symbol.
    """
    return e / up if up == down else (1 / up + 1 / down) / 2 * e + (1 / up - 1 / down) / 2 * abs(e)


def each_way(lags: Sequence[float], venting: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the lags [s] of rising and of falling pressures.

    `lags` (m,) [s] are their means, and `venting` [-] is the ratio of the second to the first.
    """
    rising = tuple(2 * lag / (1 + venting) for lag in lags)
    return rising, tuple(venting * lag for lag in rising)


def ratio(up: float, down: float) -> float:
    """Return the lag `down` of a falling pressure over the lag `up` of a rising one, or 1 for nearly equal ones."""
    return 1.0 if abs(up - down) < _ALIKE * up else down / up
