"""Friction that is known is followed and foreseen here, as `Friction` and `MaxwellSlip` do.

Its numbers are [kind, μ or s_0, T_c or whether the springs are shares of the stiffness, δ], springs k_i, widths r_i.
"""

from math import copysign, exp, isinf
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat
from mpc.model.compensation import JITTER
from mpc.model.contact import Hysteresis
from mpc.model.friction import WIDTH_AT, Friction
from mpc.model.hysteresis import MaxwellSlip

ABSENT, DAHL, SLIP = range(3)
_SPAN = 2 * WIDTH_AT  # [Pa]


class Pressed(NamedTuple):
    """A `Pressed` is what presses on that which rubs, see `mpc.model.contact.Contact`."""

    pulled: float  # [N·m]
    filled: float  # [Pa]
    stiffness: float  # [N·m/rad]


def friction_numbers(friction: Hysteresis) -> Array | None:
    """Return the numbers (4 + 2 n,) of `friction`, whose memory are n; None for one that is not known here."""
    if type(friction) is Friction:
        kind = ABSENT if friction.absent else DAHL
        return np.array([kind, friction.mu, friction.coulomb, friction.presliding, 0.0, 0.0])
    if type(friction) is MaxwellSlip:
        return np.array([SLIP, friction.base, friction.elastic, 0.0, *friction.springs, *friction.widths])
    return None


@inlined_flat
def dahl(z: float, motion: float, presliding: float) -> float:
    """Return z after turning by `motion` [rad], see `allocator.joint.history.dahl`."""
    s = copysign(1.0, motion)
    return s - (s - z) * exp(-abs(motion) / presliding)


@inlined_flat
def width_of(numbers: Array, i: int, filled: float) -> float:
    """Return the half width ρ_i [rad] of an element of `MaxwellSlip`."""
    return float((numbers[1] + (1 - numbers[1]) * filled / _SPAN) * numbers[4 + (numbers.size - 4) // 2 + i])


@inlined_flat
def followed(numbers: Array, theta: float, pressed: Pressed, last: float, memory: Array, now: Array) -> float:
    """Set `now` (n,) to what friction remembers at `theta` [rad], having remembered `memory` (n,) at the angle `last`,
    NaN for none; return the angle from which its motion counts on: see `FrictionState.follow`.
    """
    begins = np.isnan(last)
    motion = 0.0 if begins or not abs(theta - last) > JITTER else theta - last
    for i in range(now.size):
        z = memory[i]
        if numbers[0] == SLIP:
            width = width_of(numbers, i, pressed.filled)
            if begins:
                z = theta if isinf(width) else 0.0
            now[i] = min(max(z + motion, -width), width)
        else:
            z = 0.0 if begins else z
            now[i] = dahl(z, motion, numbers[3]) if motion != 0.0 else z
    return theta if begins or motion != 0.0 else last


@inlined_flat
def less_friction(
    numbers: Array, now: Array, back: float, theta: Array, pressed: Pressed, d: float, torques: Array
) -> None:
    """Set `torques` (M,) [N·m] to `d` less the friction of the motion along `theta` (M,) [rad], `back` being the first
    angle, where friction remembers `now` (n,); all of it is left out where some is not finite.
    """
    n, M, all_finite = now.size, theta.size, True
    for k in range(M):
        torques[k] = 0.0
    for i in range(n):
        z, slips = now[i], numbers[0] == SLIP
        width = width_of(numbers, i, pressed.filled) if slips else 0.0
        share = numbers[4 + i] if slips else 1.0
        for k in range(M):
            if k > 0:
                motion = theta[k] - (back if k == 1 else theta[k - 1])
                z = min(max(z + motion, -width), width) if slips else dahl(z, motion, numbers[3])
            torques[k] += share * z
    most = numbers[1] * pressed.pulled + numbers[2]
    if numbers[0] == SLIP:
        most = pressed.stiffness if numbers[2] != 0.0 else 1.0
    for k in range(M):
        torques[k] *= most
        all_finite = all_finite and np.isfinite(torques[k])
    for k in range(M):
        torques[k] = d - torques[k] if all_finite else d
