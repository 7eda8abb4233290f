"""The global optimum of the allocation problem, without iteration where a closed form exists.

Without a pull (ρ = 0) an interior stationary point of [A] satisfies JᵀW r = 0 with the Jacobian J invertible, so its
residual r is zero: it is the analytic inverse. Hence either the inverse is feasible, or the optimum lies on the border
of the feasible set, where one equation is left to solve (`allocator.allocation.edges`). The lexicographic priorities
are limits of [A] and share the argument. Nothing but comparing a few candidates is left.

With a pull and affine muscles [A] is a convex quadratic programme in two variables: its stationary point, or that of
its restriction to the torque level, takes the inverse's place. Other muscles with a pull have no closed form.
"""

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.edges import border_points
from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.inverse import solve_inverse
from allocator.levels import Pair, inverse_on_level

_TIE = 1e-13  # torques or stiffnesses closer than this fraction of their scale are the same: rounding


def solve(problem: Problem) -> Pair:
    """The optimal pressures (P1, P2) [Pa], each (n,). Raises InvalidInput where there is no closed form."""
    P1, P2 = _pulled_optimum(problem) if problem.pull else _inverse_in_box(problem)
    inside = problem.box.contains(P1, P2)
    P1, P2 = np.where(inside, P1, np.nan), np.where(inside, P2, np.nan)
    if not inside.all():
        P1[~inside], P2[~inside] = _best(problem.take(~inside))
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
    """The analytic inverse; without a closed form it is sought only in the box."""
    joint = problem.joint
    if joint.affine or joint.tondu_pulley:
        return solve_inverse(joint, problem.theta, problem.K_aim, problem.T_aim)
    return inverse_on_level(problem.sides, problem.box, problem.K_aim, problem.T_aim)


def _pulled_optimum(problem: Problem) -> Pair:
    """Where the quadratic cost is stationary, or, for priority "torque", its restriction to the torque level."""
    if not problem.joint.affine or problem.priority == "stiffness":
        raise InvalidInput(
            "method='exact' has no closed form for a pull with these muscles and this priority; "
            "use affine muscles with priority 'torque' or 'weighted', or method='nlp'"
        )
    one, two = problem.sides
    zero, (R1, R2), rho = np.zeros(problem.theta.shape), problem.P_ref, problem.pull
    t1, t2, k1, k2 = one.torque_gain(zero), two.torque_gain(zero), one.stiffness_gain(zero), two.stiffness_gain(zero)
    e_T, e_K = problem.errors(R1 + zero, R2 + zero)  # at the reference, from which d is measured
    if problem.priority == "torque":  # d = d0 + s v on the level t·d = -e_T: v = (-t2, t1)
        d0 = -e_T / (t1**2 + t2**2)
        along = k2 * t1 - k1 * t2  # dK/ds
        residual = e_K + d0 * (k1 * t1 + k2 * t2)
        s = -along * residual / (along**2 + rho * (t1**2 + t2**2))
        return R1 + d0 * t1 - s * t2, R2 + d0 * t2 + s * t1
    w_T, w_K = problem.weights
    h11, h22, h12 = w_T * t1**2 + w_K * k1**2 + rho, w_T * t2**2 + w_K * k2**2 + rho, w_T * t1 * t2 + w_K * k1 * k2
    g1, g2 = w_T * t1 * e_T + w_K * k1 * e_K, w_T * t2 * e_T + w_K * k2 * e_K
    det = h11 * h22 - h12**2
    return R1 - (h22 * g1 - h12 * g2) / det, R2 - (h11 * g2 - h12 * g1) / det


def _best(problem: Problem) -> Pair:
    """The best of all candidates on the border."""
    P1, P2 = border_points(problem)  # (m, n)
    first, second, tie = ranking(problem, P1, P2)
    infeasible = ~problem.box.contains(P1, P2, tolerance=_TIE * problem.joint.pressure_span)
    first = np.where(infeasible, np.inf, first)
    winner = np.argmin(np.where(first <= first.min(axis=0) + tie, second, np.inf), axis=0)[None]
    P1, P2 = np.take_along_axis(P1, winner, 0)[0], np.take_along_axis(P2, winner, 0)[0]
    return P1, P2


def ranking(problem: Problem, P1: Array, P2: Array) -> tuple[Array, Array, Array]:
    """(first cost, second cost, what counts as a tie of the first) at pressures (…, n): lower is better."""
    (e_T, e_K), pulled, (T_scale, K_scale) = problem.errors(P1, P2), problem.pull_cost(P1, P2), problem.scales
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        cost = w_T * e_T**2 + w_K * e_K**2 + pulled
        return cost, cost, np.zeros(problem.theta.shape)
    if problem.priority == "torque":
        return np.abs(e_T), e_K**2 + pulled, _TIE * T_scale
    return np.abs(e_K), e_T**2 + pulled, _TIE * K_scale


__all__ = ["is_local", "ranking", "solve"]
