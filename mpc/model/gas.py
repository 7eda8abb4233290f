"""The gas in the muscles of a plant is what a motion makes of their pressures.

A muscle that shortens swells by dV = g dθ, g = ∂T/∂P being its torque gain (`allocator.muscles.volume`). While the gas
keeps (P + p_a) V^κ its pressure falls by κ (P + p_a) g/V^eff a radian: behind a shut valve that is all, else a
regulator works against it,

    P_i' = (u_i - P_i)/τ_i - κ (P_i + p_a) g_i ω/V_i^eff                                                         (G3)

What the torque gives, T ω, is then what gas and rubber give: no cycle of a shut joint makes work. So a muscle that
pulls several times as hard as its law says swells as many times as much, too.

A law that is not affine in the pressure may say that its volume falls as the pressure grows, so steeply that no gas
could fill it. It is not meant for that; V^eff is taken as `STABLE` V there, the bound of what the allocation allows.
"""

import numpy as np

from allocator import checks
from allocator.calculus import Value
from allocator.errors import InvalidInput
from allocator.joint.gas import Gas
from allocator.joint.one_muscle import STABLE, OneMuscle


def fall(side: OneMuscle, P: Value, strength: float = 1.0) -> Value:
    """Return by how much the pressure falls as the joint turns behind a shut valve, κ (P + p_a) g/V^eff [Pa/rad].

    `strength` [-] is how many times as hard the muscle pulls as its law says.
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
    """Return what the gas behind a shut valve adds to the stiffness, κ (P + p_a) g²/V^eff [N·m/rad]   (G2)"""
    return strength * side.torque_gain(P) * fall(side, P, strength)


def gas_of(name: str, given: object, own: Gas) -> Gas | None:
    """Return the gas that is meant: `own` by True, none by False or None. Raises `InvalidInput` for anything else."""
    if isinstance(given, Gas):
        return given
    if not (given is None or isinstance(given, bool)):
        raise InvalidInput(f"{name} = {checks.brief(given)} has to be a Gas(kappa, atmosphere), True or False")
    return own if given else None
