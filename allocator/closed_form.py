"""Analytic inverse from (θ, K, T) to (P1, P2), without limits.

By [M] (see `allocator.muscles.base`) the Jacobian of (P1, P2) ↦ (T, K) on a pulley has positive principal minors up to
the sign of P2: it is a P-matrix, and a map whose Jacobian is a P-matrix on a rectangle is injective there (Gale &
Nikaido 1965). So at most one pressure pair gives (T, K): "which root of the cubic?" has one answer. In any other
geometry a determinant that does not vanish is enough: the Jacobian's columns depend on one pressure each. Where it
vanishes there may be several pairs.
"""

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint, joint_or_report
from allocator.joint.gas import Shares
from allocator.joint.limits import Limits, PressureBox
from allocator.joint.torque_levels import BothMuscles, Pair
from allocator.search import Curves, all_pairs

_SINGULAR = 1e-12  # of its terms: a determinant of no more is rounding
_SEARCHED = (0.0, 20e5)  # [Pa] where pressures are looked for when there is no closed form


def inverse(theta: ArrayLike, K: ArrayLike, T: ArrayLike = 0.0, *, joint: AntagonistJoint | None = None) -> Pair:
    """Find the pressures (P1, P2) [Pa] that give torque `T` [N·m] and stiffness `K` [N·m/rad] at `theta` [rad].

    Arguments broadcast. No limit is respected: the answer may be negative, beyond the supply or leave a cable slack;
    use `allocate` for pressures to apply. NaN where no inverse exists. `joint` defaults to the report's. Closed form
    for affine muscles in any geometry (the report's (9)–(10) is the McKibben case) and for two equal Tondu2021 on a
    pulley; otherwise all pairs within 0 … 20 bar are found (`allocator.search`), and the highest is given. Raises
    InvalidInput for arguments that make no sense.
    """
    joint = joint_or_report(joint)
    theta, K, T = checks.broadcast(
        theta=checks.angle("theta", theta), K=checks.stiffness("K", K), T=checks.real("T", T, "N·m")
    )
    return solve_inverse(joint, theta, K, T)


def solve_inverse(joint: AntagonistJoint, theta: Array, K: Array, T: Array, shares: Shares | None = None) -> Pair:
    """Find the `inverse` of checked arrays of one shape, of the stiffness with these `shares` of the trapped gas."""
    if joint.tondu_pulley and shares is None:
        return joint.tondu_pulley.inverse(theta, K, T)
    if joint.affine:
        return affine_inverse(joint.sides(theta, shares), K, T)
    P1, P2 = _highest_pair(joint.sides(theta.ravel(), shares), K.ravel(), T.ravel())
    return P1.reshape(T.shape), P2.reshape(T.shape)


def _highest_pair(sides: BothMuscles, K: Array, T: Array) -> Pair:
    """Return the pair with the highest pressures that gives (T, K), where a model is most likely to hold; else NaN."""
    if not T.size:
        return T, T
    limits = Limits(min_force=None if sides[0].share is None else 0.0)  # of slack muscles the volume means nothing
    one, two = (side.interval(_SEARCHED, limits) for side in sides)
    highest = float(max(one.hi.max(), two.hi.max()))  # of a law that ends earlier
    _, found = all_pairs(Curves.of(sides, PressureBox(one, two), (_SEARCHED[0], highest)), T, K)
    found = np.concatenate([np.full((len(found), 1, 2), np.nan), found], axis=1)
    best = np.nan_to_num(found.sum(axis=2), nan=-np.inf).argmax(axis=1)
    P1, P2 = found[np.arange(len(found)), best].T
    return P1, P2


def affine_inverse(sides: BothMuscles, K: Array, T: Array) -> Pair:
    """Solve the 2×2 system of two affine muscles; NaN where it is singular."""
    one, two = sides
    T = T - one.torque(0.0) - two.torque(0.0)
    K = K - one.stiffness(0.0) - two.stiffness(0.0)
    t1, t2 = one.torque_gain(0.0), two.torque_gain(0.0)
    k1, k2 = one.stiffness_gain(0.0), two.stiffness_gain(0.0)
    det = t1 * k2 - t2 * k1
    det = np.where(np.abs(det) <= _SINGULAR * (np.abs(t1 * k2) + np.abs(t2 * k1)), np.nan, det)
    return (k2 * T - t2 * K) / det, (t1 * K - k1 * T) / det


def why_no_inverse(joint: AntagonistJoint, isobaric: bool = True) -> str:
    """Return one sentence on where the inverse of this joint, for its isobaric stiffness or another, fails to exist."""
    if isobaric and (closed := joint.tondu_pulley):
        return f"with this muscle K has to lie between {closed.K_floor:.4g} and K_crit = {closed.K_crit:.4g} N·m/rad"
    if joint.affine:
        return "torque and stiffness depend on the pressures in the same way at this angle"
    return f"no pressures between {_SEARCHED[0] / 1e5:g} and {_SEARCHED[1] / 1e5:g} bar give this torque and stiffness"
