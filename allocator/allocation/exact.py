"""The global optimum of the allocation problem, without iteration where a closed form exists.

An interior stationary point of [A] satisfies JᵀW r = 0 with the Jacobian J invertible, so its residual r is zero: it is
the analytic inverse. Hence either the inverse lies in the box, or the optimum lies on one of the four edges, where one
pressure is fixed and the other is found from one equation (`allocator.allocation.edges`). The lexicographic priorities
are limits of [A] and share the argument. Nothing but comparing a few candidates is left.
"""

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.edges import edge_points
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.inverse import solve_inverse
from allocator.levels import Pair, inverse_on_level

_TIE = 1e-13  # torques or stiffnesses closer than this fraction of their scale are the same: rounding


def solve(problem: Problem) -> Pair:
    """The optimal pressures (P1, P2) [Pa], each (n,)."""
    P1, P2 = _inverse_in_box(problem)
    on_edge = np.isnan(P1)
    if on_edge.any():
        P1[on_edge], P2[on_edge] = _best(problem.take(on_edge))
    return P1, P2


def is_local(problem: Problem) -> NDArray[np.bool_]:
    """Where the argument above is not proved: the determinant of J is not positive on (a 5×5 grid of) the box."""
    one, two = problem.sides
    share = np.linspace(0, 1, 1 if problem.joint.affine else 5)[:, None]
    (lo1, hi1), (lo2, hi2) = ((side.lo, side.hi) for side in problem.box)
    P1, P2 = lo1 + share * (hi1 - lo1), (lo2 + share * (hi2 - lo2))[:, None]  # (5, n), (5, 1, n)
    t1, t2, k1, k2 = one.torque_gain(P1), two.torque_gain(P2), one.stiffness_gain(P1), two.stiffness_gain(P2)
    proved = (t1 > 0) & (t2 < 0) & (t1 * k2 - t2 * k1 > 0)
    return np.asarray(~proved.all(axis=(0, 1)))


def _inverse_in_box(problem: Problem) -> Pair:
    """The analytic inverse where it lies in the box, NaN elsewhere; without a closed form it is sought only there."""
    joint, box = problem.joint, problem.box
    if joint.affine or joint.tondu_pulley:
        P1, P2 = solve_inverse(joint, problem.theta, problem.K, problem.T)
    else:
        P1, P2 = inverse_on_level(problem.sides, box, problem.K, problem.T)
    inside = box.contains(P1, P2)
    return np.where(inside, P1, np.nan), np.where(inside, P2, np.nan)


def _best(problem: Problem) -> Pair:
    """The best of all candidates on the edges of the box."""
    P1, P2 = edge_points(problem)  # (m, n)
    e_T, e_K = problem.errors(P1, P2)
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        winner = np.argmin(w_T * e_T**2 + w_K * e_K**2, axis=0)
    else:
        ranked = [(np.abs(e_T), problem.scales[0]), (np.abs(e_K), problem.scales[1])]
        (first, scale), (second, _) = ranked if problem.priority == "torque" else ranked[::-1]
        winner = _lexicographic_argmin(first, second, _TIE * scale)
    index = winner[None]
    return np.take_along_axis(P1, index, 0)[0], np.take_along_axis(P2, index, 0)[0]


def _lexicographic_argmin(first: Array, second: Array, tie: Array) -> NDArray[np.intp]:
    """Index of the smallest `second` among those whose `first` is smallest up to `tie`; (m, n) → (n,)."""
    return np.asarray(np.argmin(np.where(first <= first.min(axis=0) + tie, second, np.inf), axis=0))


__all__ = ["is_local", "solve"]
