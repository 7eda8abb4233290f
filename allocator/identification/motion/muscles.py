"""The muscles of a known joint are corrected so that it rests where the log of another of its kind says.

    minimise  Σ_k (u_k - z - θ_eq(P1_k, P2_k; p))²  +  n w² [(z/z⁰)² + (‖F(p) - F⁰‖/‖F⁰‖)²]    over the zero z and p

z is the encoder's zero, p are the parameters of both muscles, F(p) their forces on a grid of pressures and contractions
and F⁰ those of the given ones: what the angles leave open stays as it was, the force scale above all. A zero can hardly
be told from muscles that differ, and the errors are the model's as much as the sensor's: with a smaller w both go far
away for a few tenths of a degree. No parameter changes its sign.
"""

from dataclasses import replace

import numpy as np

from allocator.calculus import Array, falling_root
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import Muscle
from allocator.units import DEG

_HOLD = 2 * DEG  # w: forces that double cost as much as an error of this size everywhere
_ZERO = 40 * DEG  # z⁰: a zero that costs as much as forces that double
_SHARES, _CONTRACTIONS = np.meshgrid([1 / 3, 2 / 3, 1.0], [0.0, 0.08, 0.16, 0.24])  # of the supply; [-]
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

    def forces(agonist: Muscle, antagonist: Muscle) -> Array:
        P, eps = joint.pressure_limits[1] * _SHARES, _CONTRACTIONS
        with np.errstate(all="ignore"):
            return np.concatenate([agonist.force(P, eps), antagonist.force(P, eps)], axis=None)

    def residual(x: Array) -> Array:
        agonist, antagonist = muscles(x)
        error = u - x[0] - _equilibrium(joint, agonist, antagonist, u - x[0], P1, P2)
        changed = (forces(agonist, antagonist) - usual) / np.linalg.norm(usual)
        return np.concatenate([error, _HOLD * np.sqrt(u.size) * np.append(changed, x[0] / _ZERO)]) / DEG

    usual = forces(joint.agonist, joint.antagonist)
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
