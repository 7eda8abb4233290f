"""Candidates for the optimum on the border of the feasible set.

On an edge of the pressure box one pressure is at a bound and the other, free one has to supply what is left of the
targets: t(P) = T_left and k(P) = K_left. On the co-contraction floor P2 = 2 P_co - P1 follows from P1. Depending on the
priority the optimum on the edge is where the first holds, where the second holds, or where the cost is stationary, each
clipped to the edge, or an end of the edge. Ends that the floor cuts off are sorted out by who compares the candidates.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from allocator.allocation.problem import Problem
from allocator.calculus import Array, all_roots
from allocator.levels import Pair
from allocator.limits import PressureInterval
from allocator.muscles import Tondu2021
from allocator.side import Side


class Edge(NamedTuple):
    """An edge of the box; arrays (n,)."""

    free: Side  # the muscle whose pressure varies
    interval: PressureInterval  # where it may be
    T_left: Array  # torque that it has to supply [N·m]
    K_left: Array  # stiffness that it has to supply [N·m/rad]
    P_ref: Array  # its reference pressure [Pa]


def border_points(problem: Problem) -> Pair:
    """All candidates (P1, P2), each (m, n), on the edges and at the corners."""
    (one, two), (R1, R2) = problem.sides, problem.P_ref
    P1, P2 = [], []
    for fixed in (problem.box.antagonist.lo, problem.box.antagonist.hi):
        points = _candidates(problem, _edge(problem, one, two, problem.box.agonist, fixed, R1))
        P1.append(points)
        P2.append(np.broadcast_to(fixed, points.shape))
    for fixed in (problem.box.agonist.lo, problem.box.agonist.hi):
        points = _candidates(problem, _edge(problem, two, one, problem.box.antagonist, fixed, R2))
        P2.append(points)
        P1.append(np.broadcast_to(fixed, points.shape))
    if problem.box.has_floor:
        points = _on_floor(problem)
        P1.append(points)
        P2.append(problem.box.least_sum - points)
    return np.concatenate(P1), np.concatenate(P2)


def _edge(problem: Problem, free: Side, held: Side, interval: PressureInterval, fixed: Array, P_ref: Array) -> Edge:
    return Edge(free, interval, problem.T_aim - held.torque(fixed), problem.K_aim - held.stiffness(fixed), P_ref)


def _candidates(problem: Problem, edge: Edge) -> Array:
    """Pressures (m, n) of the free muscle: the solutions for this priority, clipped to the edge, and its ends."""
    lo, hi = edge.interval.lo, edge.interval.hi
    solutions = np.atleast_2d(_SOLUTIONS[problem.priority](problem, edge))
    solutions = np.where(np.isnan(solutions), lo, solutions)
    return np.concatenate([np.clip(solutions, lo, hi), np.stack([lo, hi])])


def _torque_met(problem: Problem, edge: Edge) -> Array:
    return edge.free.pressure_for_torque(edge.T_left)


def _stiffness_met(problem: Problem, edge: Edge) -> Array:
    """k(P) = K_left; where k may turn also its turning points, the extremes of the stiffness on this edge."""
    free = edge.free
    if free.affine:
        gain = free.stiffness_gain(0.0)
        return np.asarray((edge.K_left - free.stiffness(0.0)) / np.where(gain == 0, np.nan, gain))
    if (terms := _tondu_terms(edge)) is not None:
        _, _, _, kappa0, kappa, d = terms
        with np.errstate(divide="ignore"):
            return np.asarray(-kappa / kappa0 - d)
    return np.concatenate(
        [
            _roots(edge, lambda side, P, T_left, K_left: side.stiffness(P) - K_left),
            _roots(edge, lambda side, P, T_left, K_left: side.stiffness_gain(P)),
        ]
    )


def _cost_stationary(problem: Problem, edge: Edge) -> Array:
    """d/dP [w_T (t - T_left)² + w_K (k - K_left)² + ρ (P - P_ref)²] = 0: linear, a quartic, or root finding."""
    free, (w_T, w_K), rho = edge.free, problem.weights, problem.pull
    if free.affine:
        t0, t1, k0, k1 = free.torque(0.0), free.torque_gain(0.0), free.stiffness(0.0), free.stiffness_gain(0.0)
        normal = w_T * t1 * (edge.T_left - t0) + w_K * k1 * (edge.K_left - k0) + rho * edge.P_ref
        return np.asarray(normal / (w_T * t1**2 + w_K * k1**2 + rho))
    if (terms := _tondu_terms(edge)) is not None:
        alpha, beta, gamma, kappa0, kappa, d = terms
        return (
            _quartic_roots(
                alpha / beta,
                -(w_T * alpha * gamma + w_K * kappa * kappa0) / (w_T * beta**2),
                -(w_T * gamma**2 + w_K * kappa**2) / (w_T * beta**2),
                scale=abs(d),
            )
            - d
        )

    def slope(side: Side, P: Array, T_left: Array, K_left: Array) -> Array:
        torque = w_T * (side.torque(P) - T_left) * side.torque_gain(P)
        return np.asarray(torque + w_K * (side.stiffness(P) - K_left) * side.stiffness_gain(P))

    return _roots(edge, slope)


_SOLUTIONS: dict[str, Callable[[Problem, Edge], Array]] = {
    "torque": _torque_met,
    "stiffness": _stiffness_met,
    "weighted": _cost_stationary,
}


def _tondu_terms(edge: Edge) -> tuple[Array, Array, Array, Array, Array, float] | None:
    """(α, β, γ, κ0, κ, d) of t - T_left = α + βu + γ/u and k - K_left = κ0 + κ/u, u = P + d: Tondu2021."""
    muscle, side = edge.free.muscle, edge.free  # and a constant arm
    if not isinstance(muscle, Tondu2021) or np.any(side.arm_slope):
        return None
    push, stretch = side.sign * side.arm * muscle.S, side.arm**2 / side.rest_length * muscle.S
    beta, gamma = push * (muscle.a - muscle.b), -push * side.contraction * muscle.g
    alpha = -beta * muscle.d - push * side.contraction * muscle.c - edge.T_left
    return alpha, beta, gamma, stretch * muscle.c - edge.K_left, stretch * muscle.g, muscle.d


def _quartic_roots(a3: Array, a1: Array, a0: Array, scale: float) -> Array:
    """Real parts (4, n) of the roots of u⁴ + a3 u³ + a1 u + a0 = 0, from companion matrices scaled by `scale`."""
    companion = np.zeros((a3.size, 4, 4))
    companion[:, 0, 0] = -a3 / scale
    companion[:, 0, 2] = -a1 / scale**3
    companion[:, 0, 3] = -a0 / scale**4
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    return np.asarray(np.linalg.eigvals(companion).real.T * scale)


def _roots(edge: Edge, f: Callable[[Side, Array, Array, Array], Array]) -> Array:
    """Roots on the edge of f(free side, P, T_left, K_left), by bracketing."""
    side = edge.free

    def g(P: Array, eps: Array, arm: Array, arm_slope: Array, T_left: Array, K_left: Array) -> Array:
        return f(side.moved(eps, arm, arm_slope), P, T_left, K_left)

    return all_roots(g, edge.interval.lo, edge.interval.hi, *side.arrays, edge.T_left, edge.K_left)


def _on_floor(problem: Problem) -> Array:
    """Candidates P1 (m, n) on the co-contraction floor, by bracketing on what the priority asks for."""
    box, (one, two) = problem.box, problem.sides
    left, right = box.floor_segment
    right = np.maximum(left, right)  # where there is no floor edge the candidates are infeasible, and lose
    total, R1, R2, *_ = np.broadcast_arrays(box.least_sum, *problem.P_ref, left)
    given = (*one.arrays, *two.arrays, problem.T_aim, problem.K_aim, total, R1, R2)
    rho, (w_T, w_K) = problem.pull, problem.weights

    def condition(P1: Array, *a: Array, kind: str) -> Array:
        first, second, (T, K, total, R1, R2) = one.moved(*a[:3]), two.moved(*a[3:6]), a[6:]
        P2 = total - P1
        e_T, e_K = first.torque(P1) + second.torque(P2) - T, first.stiffness(P1) + second.stiffness(P2) - K
        T_slope = first.torque_gain(P1) - second.torque_gain(P2)
        K_slope = first.stiffness_gain(P1) - second.stiffness_gain(P2)
        cost_slope = w_T * e_T * T_slope + w_K * e_K * K_slope + rho * (P1 - R1 - P2 + R2)
        return np.asarray({"torque": e_T, "stiffness": e_K, "turn": K_slope, "weighted": cost_slope}[kind])

    kinds = ("stiffness", "turn") if problem.priority == "stiffness" else (problem.priority,)
    pieces = 1 if problem.joint.affine else 32
    roots = [all_roots(partial(condition, kind=kind), left, right, *given, pieces=pieces) for kind in kinds]
    return np.concatenate([*roots, right[None]])


__all__ = ["Edge", "border_points"]
