"""Recursions over samples in plain Python, compiled by numba where available."""

from collections.abc import Sequence
from functools import cache
from math import exp

import numpy as np

from allocator.calculus import Array
from allocator.compilation import jit
from allocator.joint.hysteresis import pass_plays

_INSTANT = 1e-9  # [s] a shorter lag counts as none


def follow(
    t: Array,
    u: Array,
    squeezed: Array,
    around: float,
    up: float,
    down: float,
    dead: float,
    rest: float,
    slowest: float,
    out: Array,
) -> None:
    """Fill `out` (m,) with the pressures [Pa] of a regulator with the commands u (m,) [Pa] at the times t (m,) [s].

    Each command holds until the next and acts after the dead time `dead` [s]; the pressure follows with the time
    constant `up` or `down` [s], to within `rest` [Pa], half the dead band, but takes at least `slowest` [s/Pa] because
    of the valves' flow; it begins at the first command. In the step to row k the joint's motion multiplies the absolute
    pressure by squeezed[k]² (m,), half before the regulator and half after; `around` is p_a [Pa].
    """
    acting, pressure = 0, u[0]
    out[0] = pressure
    for k in range(1, len(t)):
        pressure = (pressure + around) * squeezed[k] - around
        now = t[k - 1]
        while now < t[k]:
            while acting + 1 < k and t[acting + 1] + dead <= now:
                acting += 1
            until = min(t[k], t[acting + 1] + dead)
            if until <= now:
                until = t[k]
            error = u[acting] - pressure
            error = max(error - rest, 0.0) + min(error + rest, 0.0)
            lag = max(up if error > 0 else down, _INSTANT)
            left = until - now
            if abs(error) * slowest > lag:
                filling = min(left, abs(error) * slowest - lag)
                moved = filling / slowest if error > 0 else -filling / slowest
                pressure, error, left = pressure + moved, error - moved, left - filling
            pressure += error * (1 - exp(-left / lag))
            now = until
        pressure = (pressure + around) * squeezed[k] - around
        out[k] = pressure


def swing(
    u: Array,
    s: Array,
    k: Array,
    firm: Array,
    kappa: Array,
    r: Array,
    a1: float,
    a2: float,
    h: float,
    e: Array,
    out: Array,
) -> None:
    """Fill `out` (m,) with the angle [rad] of a joint with the static angle u (m,) [rad] and hysteresis stops:

        (a2 θ'' + a1 θ')/k + θ + f Σ κ_i e_i = u,   de_i = dθ while |e_i| < r_i s

    by Newmark's average acceleration with steps of h [s], at rest at the first u. k (m,) is the stiffness over the
    usual one, s (m,) the widths over r (n,) [rad], f = `firm` (m,) the springs over κ (n,); `e` (n,) are the stops,
    updated in place. The equation at the end of a step is increasing and piecewise linear in θ, so Newton's method is
    exact on its piece.
    """
    at, speed, pull = u[0], 0.0, 0.0
    out[0] = at
    for j in range(1, len(u)):
        c2, c1 = 4 * a2 / (h * h * k[j]), 2 * a1 / (h * k[j])
        past = a2 / k[j] * (4 * speed / h + pull) + a1 / k[j] * speed
        turn = 0.0
        for _ in range(12):
            error, slope = c2 * turn + c1 * turn - past + at + turn - u[j], c2 + c1 + 1
            for i in range(len(r)):
                stop = e[i] + turn
                width = r[i] * s[j]
                if -width < stop < width:
                    slope += firm[j] * kappa[i]
                error += firm[j] * kappa[i] * max(-width, min(width, stop))
            turn -= error / slope
            if abs(error) < 1e-10:
                break
        for i in range(len(r)):
            e[i] = max(-r[i] * s[j], min(r[i] * s[j], e[i] + turn))
        pull = 4 / (h * h) * (turn - h * speed) - pull
        speed = 2 / h * turn - speed
        at += turn
        out[j] = at


_LOOPS: dict[str, jit.Function] = {"follow": follow, "pass_plays": pass_plays, "swing": swing}


@cache
def _compiled(name: str) -> jit.Function:
    return jit.compiled(_LOOPS[name], (), inline=False, unaliased=False) or _LOOPS[name]


def pressures(t: Array, u: Array, squeezed: Array, around: float, regulator: Sequence[float]) -> Array:
    """Return the pressures (m,) [Pa] after `follow`, of a `regulator` (up, down, dead, whole dead band, slowest).

    Without any lag, dead time etc. they are u itself: measured pressures, not commands.
    """
    if not any(regulator):
        return u
    up, down, dead, band, slowest = map(float, regulator)
    out = np.empty(t.size)
    _compiled("follow")(t, u, squeezed, around, up, down, dead, band / 2, slowest, out)
    return out


def plays(u: Array, s: Array, r: Array) -> Array:
    """Return the plays (n, m) [rad] of half widths r (n,) times s (m,), at rest at the first of u (m,) [rad]."""
    out = np.empty((r.size, u.size))
    _compiled("pass_plays")(u, s, r, np.full(r.size, u[0]), out)
    return out


def swung(u: Array, s: Array, k: Array, firm: Array, kappa: Array, r: Array, a1: float, a2: float, h: float) -> Array:
    """Return the angle (m,) [rad] after `swing`, without memory before."""
    out = np.empty(u.size)
    _compiled("swing")(u, s, k, firm, kappa, r, float(a1), float(a2), float(h), np.zeros(r.size), out)
    return out
