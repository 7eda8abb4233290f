"""The gas in an arm's muscles is here: what its motion makes of their pressures, in numbers and as a formula.

A muscle that lengthens by l' squeezes its gas; with the isobaric gain F_P of its force and all of the gas in V^eff

    P_j' = (u_j - P_j)/τ_j + κ (P_j + p_a) F_P,j l_j'/V_j^eff,     l_j' = -r_j·ω                                 (G3)

which is `mpc.model.gas` muscle by muscle. Slack muscles are taken as their laws have them.
"""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism import Mechanism
from mpc.model.arm.pneumatics import Pneumatics
from mpc.model.gas import fall
from mpc.model.lengths import symbolic_lengths

if TYPE_CHECKING:
    from casadi import Function

    from mpc.model.arm.model import Arm


def squeezed(mechanism: Mechanism, q: Array, omega: Array, P: Array) -> Array:
    """Return how fast motion raises the pressures (…, m) [Pa/s] in states (…, n), (…, n), (…, m)   (G3)"""
    muscles = Pneumatics(mechanism.muscles, mechanism.routes.rest_length, gas=mechanism.gas)
    routed = mechanism.routes.at(np.asarray(q, float))
    speed = -(routed.arm @ np.asarray(omega, float)[..., None])[..., 0]
    return muscles.squeezed(np.asarray(P, float), routed.length, speed)


def gas_motion(arm: "Arm") -> "Function":
    """Return the CasADi function (x, u, d) ↦ x' of an arm with gas."""
    import casadi as ca

    s, mechanism, n = arm.statics, arm.mechanism, arm.n
    omega, u, d = ca.SX.sym("omega", n), ca.SX.sym("u", arm.m), ca.SX.sym("d", n)
    length, L = symbolic_lengths(mechanism.routes, s.q), mechanism.routes.rest_length
    speed, rates = ca.jacobian(length, s.q) @ omega, []
    for j, muscle in enumerate(mechanism.muscles):
        side = OneMuscle(muscle, "muscle", L[j], 1 - length[j] / L[j], 1.0, 0.0, 1.0, mechanism.gas)
        rates.append((u[j] - s.P[j]) / float(arm.lags[j]) + fall(side, s.P[j]) * speed[j])
    x = ca.vertcat(s.q, omega, s.P)
    alpha = arm.acceleration()(s.q, omega, s.P, d)
    return ca.Function("motion", [x, u, d], [ca.vertcat(omega, alpha, *rates)])
