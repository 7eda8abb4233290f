"""What runs sample by sample is written here in plain Python, and compiled by numba where it can be."""

from functools import cache
from math import exp
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.compilation import jit
from allocator.joint.hysteresis import pass_plays

_INSTANT = 1e-9  # [s] a shorter lag is none


def follow(t: Any, u: Any, up: float, down: float, dead: float, rest: float, out: Any) -> None:
    """Fill `out` (m,) with the pressures [Pa] of a regulator that is told u (m,) [Pa] at the times t (m,) [s].

    Each command holds until the next and acts after the dead time `dead` [s]; the pressure follows with the time
    constant `up` or `down` [s], to within `rest` [Pa], half the dead band, and begins at the first command.
    """
    acting, pressure = 0, u[0]
    out[0] = pressure
    for k in range(1, len(t)):
        now = t[k - 1]
        while now < t[k]:
            while acting + 1 < k and t[acting + 1] + dead <= now:
                acting += 1
            until = min(t[k], t[acting + 1] + dead)
            if until <= now:
                until = t[k]
            error = u[acting] - pressure
            error = max(error - rest, 0.0) + min(error + rest, 0.0)
            lag = up if error > 0 else down
            pressure += error * (1 - exp(-(until - now) / max(lag, _INSTANT)))
            now = until
        out[k] = pressure


_LOOPS: dict[str, jit.Function] = {"follow": follow, "pass_plays": pass_plays}


@cache
def _compiled(name: str) -> jit.Function:
    return jit.compiled(_LOOPS[name], (), inline=False, unaliased=False) or _LOOPS[name]


def pressures(t: Array, u: Array, up: float, down: float, dead: float, band: float) -> Array:
    """Return the pressures (m,) [Pa] after `follow`; `band` is the whole dead band [Pa]."""
    out = np.empty(t.size)
    _compiled("follow")(t, u, float(up), float(down), float(dead), float(band) / 2, out)
    return out


def plays(u: Array, s: Array, r: Array) -> Array:
    """Return the plays (n, m) [rad] of half widths r (n,) times s (m,), at rest at the first of u (m,) [rad]."""
    out = np.empty((r.size, u.size))
    _compiled("pass_plays")(u, s, r, np.full(r.size, u[0]), out)
    return out


__all__ = ["follow", "plays", "pressures"]
