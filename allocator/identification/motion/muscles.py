"""The muscles of a known joint are corrected so that it rests where the log of another of its kind says.

    minimise  Σ_k (u_k - z - θ_eq(P1_k, P2_k; p))²  +  n w² Σ_j (p_j/p_j⁰ - 1)²        over the encoder's zero z, p

p are the parameters of both muscles, p⁰ those of the given ones: what the angles leave open stays as it was, the force
scale above all. No parameter changes its sign.
"""

from dataclasses import replace

import numpy as np

from allocator.calculus import Array, falling_root
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import Muscle
from allocator.units import DEG

_HOLD = 0.05 * DEG  # w: a parameter that doubles costs as much as an error of this size everywhere
_MOST_CHANGE = 0.9  # of a parameter, in itself
_MOST_ZERO = 0.35  # of the encoder [rad]
_TURN = np.pi  # [rad] beyond which no joint is looked for
_CLOSE = 1e-7  # [rad] a Newton step after which the next is below rounding


def fit_muscles(joint: AntagonistJoint, u: Array, P1: Array, P2: Array) -> tuple[Muscle, Muscle, float]:
    """Return agonist, antagonist and the encoder's zero [rad] that rest at u (n,) [rad] at P1, P2 (n,) [Pa].

    Raises `InvalidInput` where these are no muscles any more.
    """
    from scipy.optimize import least_squares

    m = len(joint.agonist.parameters)
    given = np.array([*joint.agonist.parameters.values(), *joint.antagonist.parameters.values()])

    def muscles(x: Array) -> tuple[Muscle, Muscle]:
        p = given * (1 + x[1:])
        return joint.agonist.unchecked(p[:m].tolist()), joint.antagonist.unchecked(p[m:].tolist())

    def residual(x: Array) -> Array:
        error = u - x[0] - _equilibrium(joint, *muscles(x), u - x[0], P1, P2)
        return np.concatenate([error, _HOLD * np.sqrt(u.size) * x[1:]]) / DEG

    most = np.array([_MOST_ZERO, *[_MOST_CHANGE] * given.size])
    size = np.array([0.05, *[0.2] * given.size])
    x = least_squares(residual, 0 * size, bounds=(-most, most), x_scale=size, ftol=1e-6, max_nfev=60).x
    agonist, antagonist = muscles(x)
    try:
        one = joint.agonist.with_parameters(agonist.parameters)
        two = joint.antagonist.with_parameters(antagonist.parameters)
    except InvalidInput as error:
        raise InvalidInput(f"muscles like this joint's cannot hold the angles of the log: {error}") from None
    return replace(one, covariance=None), replace(two, covariance=None), float(x[0])


def _equilibrium(
    joint: AntagonistJoint, agonist: Muscle, antagonist: Muscle, start: Array, P1: Array, P2: Array
) -> Array:
    """Return θ_eq (n,) [rad], sought from `start` (n,) [rad]."""
    reach, l0 = joint.geometry.reach, joint.geometry.rest_length
    low, high = (np.full(start.size, end) for end in (max(reach[0], -_TURN), min(reach[1], _TURN)))

    def balance(theta: Array) -> tuple[Array, Array]:
        one = OneMuscle.at_joint(agonist, True, l0, joint.geometry.agonist(theta))
        two = OneMuscle.at_joint(antagonist, False, l0, joint.geometry.antagonist(theta))
        with np.errstate(all="ignore"):
            return one.torque(P1) + two.torque(P2), one.stiffness(P1) + two.stiffness(P2)

    return falling_root(balance, np.clip(start, low, high), low, high, _CLOSE)
