"""Pressures in the muscles of a plant: the gas, which motion compresses, and the regulators.

A muscle that shortens swells by dV = g dθ, g = ∂T/∂P being its torque gain (`allocator.muscles.volume`). With constant
(P + p_a) V^κ its pressure falls by κ (P + p_a) g/V^eff per radian. That is the only change behind a shut valve;
otherwise a regulator works against it,

    P_i' = (u_i - P_i)/τ_i - κ (P_i + p_a) g_i ω/V_i^eff                                                         (G3)

The power of the torque, T ω, is then that of gas and rubber: no cycle of a shut joint does work. A muscle that pulls
several times as hard as its model therefore swells by the same factor.

In a model that is not affine in the pressure, the volume may fall with growing pressure so steeply that no gas could
fill it. Such a model is outside its range; V^eff is `STABLE` V there, the bound of the allocation.

A regulator is of first order; its pressures rise and fall with different time constants.

    P' = (u - P)/τ_up if u > P, else (u - P)/τ_down
       = a e + b |e|,     e = u - P,     a, b = (1/τ_up ± 1/τ_down)/2

The slope a at e = 0 is between those of both ways.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Value
from allocator.errors import InvalidInput
from allocator.joint.gas import Gas
from allocator.joint.one_muscle import STABLE, OneMuscle
from allocator.muscles import Muscle
from allocator.units import CM3


def fall(side: OneMuscle, P: Value, strength: float = 1.0) -> Value:
    """Return the fall of the pressure per angle of the joint behind a shut valve, κ (P + p_a) g/V^eff [Pa/rad].

    `strength` [-] is the ratio of the muscle's force to that of its model.
    """
    V = side.effective_volume(P)
    if not side.affine:
        least = STABLE * side.volume(P)
        V = (V + least + abs(V - least)) / 2
    if np.any(np.not_equal(strength, 1.0)):
        rest = side.muscle.volume_at_rest(side.rest_length)
        V = rest + strength * (V - rest)
    return strength * side.gas.kappa * (P + side.gas.atmosphere) * side.torque_gain(P) / V


def trapped(side: OneMuscle, P: Value, strength: float = 1.0) -> Value:
    """Return the stiffness of the gas behind a shut valve, κ (P + p_a) g²/V^eff [N·m/rad]   (G2)"""
    return strength * side.torque_gain(P) * fall(side, P, strength)


def gas_of(name: str, given: object, own: Gas) -> Gas | None:
    """Return the gas `given`: `own` for True, none for False or None. Raises `InvalidInput` for anything else."""
    if isinstance(given, Gas):
        return given
    if not (given is None or isinstance(given, bool)):
        raise InvalidInput(f"{name} = {checks.brief(given)} has to be a Gas(kappa, atmosphere), True or False")
    return own if given else None


def text_of(gas: Gas | bool | None, muscles: Sequence[Muscle], lengths: Iterable[float]) -> str:
    """Return the gas of a machine in words, with the volumes of its muscles of these rest `lengths` [m]."""
    if not isinstance(gas, Gas):
        return "no gas"
    volumes = [muscle.volume_at_rest(L) / CM3 for muscle, L in zip(muscles, lengths, strict=True)]
    each = list(dict.fromkeys(f"{V:.3g}" for V in volumes))
    volume = " and ".join(each) if len(each) < 3 else f"{min(volumes):.3g} to {max(volumes):.3g}"
    return f"gas with κ = {gas.kappa:g} in {volume} cm³ at rest length"


def pair_of_lags(given: Any) -> tuple[float, float]:
    """Return the time constants [s] of both muscles, given as one, a pair or an array. Raises `InvalidInput`."""
    several = isinstance(given, tuple | list) or (isinstance(given, np.ndarray) and given.ndim == 1)
    lags = tuple(given) if several else (given, given)
    if len(lags) != 2:
        raise InvalidInput(f"lag = {given!r} has to be one time constant or a pair of them [s]")
    return checks.positive("lag", lags[0], "s"), checks.positive("lag", lags[1], "s")


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
