"""Global optimum for two muscles: in closed form if they are affine, else by a complete search.

Without a pull (ρ = 0) an interior stationary point of [A] satisfies JᵀW r = 0 with the Jacobian J. Where J is
invertible the residual r is zero, and the point is the analytic inverse. For affine muscles J is constant at an angle.
Hence either the inverse is feasible, or the optimum lies on the border of the feasible set, where one equation remains
(`border_points`). The lexicographic priorities are limits of [A] and share the argument. With a pull [A] is a convex
quadratic programme in two variables; its stationary point, or that of its restriction to the torque level, replaces the
inverse. The optimum is the best of a few candidates.

For other muscles J may be singular in the box, and several pairs may give the same torque and stiffness:
`allocator.search` finds all of them and a bound on the candidates dropped, the `gap`. With a pull there is no exact
answer for such muscles. The stiffness felt by a push couples both pressures; `felt` solves it exactly.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from allocator import search
from allocator.allocation.two_muscles import felt
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.closed_form import affine_inverse
from allocator.errors import InvalidInput
from allocator.joint.limits import PressureBox
from allocator.joint.torque_levels import Pair

_TIE = 1e-13  # torques or stiffnesses closer than this fraction of their scale are the same: rounding


class Optimum(NamedTuple):
    """Optimal pressures, each (n,), and their gap."""

    P1: Array  # [Pa]
    P2: Array
    gap: Array  # to a lower bound, see `Allocation.gap`; NaN without a proof


def solve(problem: Problem) -> Optimum:
    """Return the optimum of n problems. Raises InvalidInput for a pull on muscles without a closed form."""
    if problem.felt is not None:
        return Optimum(*felt.solve(problem), np.zeros(problem.theta.shape))
    if problem.joint.affine or problem.pull:
        return Optimum(*_closed(problem), np.zeros(problem.theta.shape))
    T, K, now = problem.T_aim, problem.of_muscles(problem.K_aim), problem.limits.previous
    P1, P2, gap = search.optima(problem.curves, T, K, problem.priority, problem.weights, now)
    return Optimum(P1, P2, gap / gap_units(problem)[1])


def gap_units(problem: Problem) -> Pair:
    """Return the units of a gap of either goal: their scales, or that of the weighted cost."""
    T_scale, K_scale = problem.scales
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        unit = np.asarray(w_T * T_scale**2 + w_K * K_scale**2)
        return unit, unit
    return (T_scale, K_scale) if problem.priority == "torque" else (K_scale, T_scale)


def determinant_signs(problem: Problem) -> Array:
    """Return the sign (n,) of det ∂(T, K)/∂(P1, P2) if it is proved constant over the box, else 0.

    Where it is not 0 no two pairs of pressures give the same torque and stiffness (the columns of the Jacobian depend
    on one pressure each), and along a torque level the stiffness rises (1) or falls (-1). Affine muscles: the
    determinant is constant. Others: by the slopes of both curves at the ends of their pieces, of any geometry.
    """
    if problem.felt is not None or _jumps(problem):
        return np.zeros(problem.theta.shape)
    if problem.tondu_pulley:  # F_Pε < 0 everywhere, and F_P falls with P: [M] holds up to the upper bounds
        (one, two), (first, second) = problem.sides, problem.box
        rises = (one.torque_gain(first.hi) > 0) & (two.torque_gain(second.hi) < 0)
        return np.where(rises, 1.0, 0.0)
    if not problem.joint.affine:
        return search.determinant_signs(problem.curves)
    one, two = problem.sides
    (t1, k1), (t2, k2) = ((side.torque_gain(0.0), side.stiffness_gain(0.0)) for side in (one, two))
    det = t1 * k2 - t2 * k1
    return np.where(np.abs(det) <= _TIE * (np.abs(t1 * k2) + np.abs(t2 * k1)), 0.0, np.sign(det))


def _jumps(problem: Problem) -> bool:
    """Return whether the stiffness may jump with the pressure: where F_P has a kink the volume of the gas does."""
    joint = problem.joint
    return problem.shares is not None and bool(joint.agonist.basis.kinks or joint.antagonist.basis.kinks)


def _closed(problem: Problem) -> Pair:
    """Return the best of the inverse (or its replacement) and the candidates on the border."""
    P1, P2 = _pulled_optimum(problem) if problem.pull else affine_inverse(problem.sides, problem.K_aim, problem.T_aim)
    inside = problem.box.contains(P1, P2)
    P1, P2 = np.where(inside, P1, np.nan), np.where(inside, P2, np.nan)
    if not inside.all():
        P1[~inside], P2[~inside] = _best(problem.take(~inside))
    return P1, P2


def _pulled_optimum(problem: Problem) -> Pair:
    """Return the stationary point of the quadratic cost, along the torque level for priority "torque"."""
    if not problem.joint.affine or problem.priority == "stiffness":
        raise InvalidInput(
            "method='exact' has no closed form for a pull with these muscles and this priority; "
            "use affine muscles with priority 'torque' or 'weighted', or method='nlp'"
        )
    one, two = problem.sides
    zero, (R1, R2), rho = np.zeros(problem.theta.shape), problem.P_ref, problem.pull
    t1, t2, k1, k2 = one.torque_gain(zero), two.torque_gain(zero), one.stiffness_gain(zero), two.stiffness_gain(zero)
    e_T, e_K = problem.errors(R1 + zero, R2 + zero)  # at the reference, the origin of d
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
    """Return the best of all candidates on the border."""
    P1, P2 = border_points(problem)  # (m, n)
    first, second, tie = ranking(problem, P1, P2)
    infeasible = ~problem.box.contains(P1, P2, tolerance=_TIE * problem.joint.pressure_span)
    first = np.where(infeasible, np.inf, first)
    winner = np.argmin(np.where(first <= first.min(axis=0) + tie, second, np.inf), axis=0)[None]
    P1, P2 = np.take_along_axis(P1, winner, 0)[0], np.take_along_axis(P2, winner, 0)[0]
    return P1, P2


def ranking(problem: Problem, P1: Array, P2: Array) -> tuple[Array, Array, Array]:
    """Return (first cost, second cost, tolerance of a tie of the first) at pressures (…, n): lower is better."""
    (e_T, e_K), pulled, (T_scale, K_scale) = problem.errors(P1, P2), problem.pull_cost(P1, P2), problem.scales
    if problem.priority == "weighted":
        w_T, w_K = problem.weights
        cost = w_T * e_T**2 + w_K * e_K**2 + pulled
        return cost, cost, np.zeros(problem.theta.shape)
    if problem.priority == "torque":
        return np.abs(e_T), e_K**2 + pulled, _TIE * T_scale
    return np.abs(e_K), e_T**2 + pulled, _TIE * K_scale


def border_points(problem: Problem) -> Pair:
    """Return all candidates (P1, P2), each (m, n), for the optimum of affine muscles on the border of the feasible set.

    Along a straight line P = start + s·direction torque and stiffness are affine in s: on an edge of the box, and on
    the co-contraction floor, where P1 + P2 is constant. The optimum on the line is a point that meets the torque or the
    stiffness, a stationary point of the weighted cost, each clipped to the line, or an end of it. The comparison of
    candidates rejects ends below the floor.
    """
    P1, P2 = [], []
    for (start1, start2), (d1, d2), length in _lines(problem.box):
        found = (np.clip(s, 0.0, length) for s in _solutions(problem, start1, start2, d1, d2))
        for s in (np.zeros_like(length), *found, length):
            P1.append(start1 + d1 * s)
            P2.append(start2 + d2 * s)
    return np.stack(P1), np.stack(P2)


def _lines(box: PressureBox) -> Iterator[tuple[Pair, tuple[int, int], Array]]:
    """Start, direction and length of every edge."""
    (lo1, hi1), (lo2, hi2) = ((side.lo, side.hi) for side in box)
    for P2 in (lo2, hi2):
        yield (lo1, P2), (1, 0), hi1 - lo1
    for P1 in (lo1, hi1):
        yield (P1, lo2), (0, 1), hi2 - lo2
    if box.has_floor:
        left, right = box.floor_segment
        yield (left, box.least_sum - left), (1, -1), np.maximum(right - left, 0.0)


def _solutions(problem: Problem, P1: Array, P2: Array, d1: int, d2: int) -> tuple[Array, ...]:
    """Return distances of the optimum from (P1, P2) along (d1, d2); 0 if a goal is constant along the line."""
    (one, two), (R1, R2), (w_T, w_K), rho = problem.sides, problem.P_ref, problem.weights, problem.pull
    e_T, e_K = problem.errors(P1, P2)
    t = d1 * one.torque_gain(0.0) + d2 * two.torque_gain(0.0)
    k = d1 * one.stiffness_gain(0.0) + d2 * two.stiffness_gain(0.0)
    if problem.priority != "weighted":
        return _quotient(-e_T, t), _quotient(-e_K, k)
    slope = w_T * e_T * t + w_K * e_K * k + rho * (d1 * (P1 - R1) + d2 * (P2 - R2))
    return (_quotient(-slope, w_T * t**2 + w_K * k**2 + rho * (d1 * d1 + d2 * d2)),)


def _quotient(dividend: Array, divisor: Array) -> Array:
    return np.asarray(np.where(divisor == 0, 0.0, dividend / np.where(divisor == 0, 1.0, divisor)))
