"""How the allocated pressures move with angle, stiffness and torque while the active set stays as it is.

An answer is the solution of two equations G(P; θ, K*, T*) = 0, hence dP = -G_P⁻¹ G_x dx. Where both targets are met
they are T = T* and K = K*. Otherwise every pressure on a bound stays there, P_i = b_i(θ), and if the other one is free
it keeps the target that has priority or, with weights, the cost stationary.
"""

from collections.abc import Callable

import numpy as np

from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.levels import Sides
from allocator.limits import Limit, PressureInterval
from allocator.side import Side

_ON_BOUND = 1e-9  # of the supply range
_MET = 1e-9  # of the scale of torque or stiffness
_SLACK = Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK
_H = 1e-4  # step of the five-point difference, in rad or in supply ranges: error about 1e-11 of the slope


def jacobian(problem: Problem, P1: Array, P2: Array) -> Array:
    """dP/d(θ, K, T), (n, 2, 3); NaN where the equations are singular."""
    n = P1.size
    torque, stiffness = _torque_row(problem, P1, P2), _stiffness_row(problem, P1, P2)
    e_T, e_K = np.abs(problem.errors(P1, P2))
    missed = (e_T > _MET * problem.scales[0]) | (e_K > _MET * problem.scales[1])
    held = [missed & _on_bound(problem, interval, P) for interval, P in zip(problem.box, (P1, P2), strict=True)]
    rows = np.stack([torque, stiffness], 1)  # (n, 2, 5): G_P1, G_P2, G_θ, G_K, G_T
    for i, (side, interval, P) in enumerate(zip(problem.sides, problem.box, (P1, P2), strict=True)):
        rest = {"torque": torque, "stiffness": stiffness}.get(problem.priority)
        rest = _stationary_row(problem, P1, P2, free=1 - i) if rest is None else rest
        bound = _bound_row(n, i, side, interval, P)
        rows[:, i] = np.where(held[i][:, None], bound, rows[:, i])
        alone = held[i] & ~held[1 - i]
        rows[:, 1 - i] = np.where(alone[:, None], rest, rows[:, 1 - i])
    return _solve(rows[:, :, :2], -rows[:, :, 2:])


def _torque_row(problem: Problem, P1: Array, P2: Array) -> Array:
    """T(θ, P) - T* = 0; ∂T/∂θ = -K by definition."""
    one, two = problem.sides
    K = one.stiffness(P1) + two.stiffness(P2)
    return _row(one.torque_gain(P1), two.torque_gain(P2), -K, 0.0, -1.0)


def _stiffness_row(problem: Problem, P1: Array, P2: Array) -> Array:
    """K(θ, P) - K* = 0."""
    one, two = problem.sides
    K_theta = _five_point(lambda h: _total_stiffness(problem.joint.sides(problem.theta + h), P1, P2), _H)
    return _row(one.stiffness_gain(P1), two.stiffness_gain(P2), K_theta, -1.0, 0.0)


def _stationary_row(problem: Problem, P1: Array, P2: Array, free: int) -> Array:
    """φ = w_T (T - T*) T_Pj + w_K (K - K*) K_Pj = 0 for the free pressure j."""
    (w_T, w_K), step = problem.weights, _H * problem.joint.pressure_span

    def phi(dP1: float, dP2: float, dtheta: float) -> Array:
        sides = problem.joint.sides(problem.theta + dtheta)
        P = (P1 + dP1, P2 + dP2)
        e_T = sides[0].torque(P[0]) + sides[1].torque(P[1]) - problem.T
        e_K = _total_stiffness(sides, *P) - problem.K
        return np.asarray(
            w_T * e_T * sides[free].torque_gain(P[free]) + w_K * e_K * sides[free].stiffness_gain(P[free])
        )

    side, P = problem.sides[free], (P1, P2)[free]
    return _row(
        _five_point(lambda h: phi(h, 0, 0), step),
        _five_point(lambda h: phi(0, h, 0), step),
        _five_point(lambda h: phi(0, 0, h), _H),
        -w_K * side.stiffness_gain(P),
        -w_T * side.torque_gain(P),
    )


def _bound_row(n: int, i: int, side: Side, interval: PressureInterval, P: Array) -> Array:
    """P_i - b_i(θ) = 0; a slack limit F(b, ε) = F_min moves with ε' = ±a/l0, every other bound stays."""
    row = np.zeros((n, 5))
    row[:, i] = 1.0
    stretch = side.sign * side.arm / side.rest_length
    slack = (interval.lo_limit & _SLACK != 0) & (interval.lo >= P) & ~interval.empty
    gain, slope = side.muscle.gain(P, side.contraction), side.muscle.slope(P, side.contraction)
    row[:, 2] = np.where(slack, slope * stretch / gain, 0.0)
    return row


def _on_bound(problem: Problem, interval: PressureInterval, P: Array) -> Array:
    tolerance = _ON_BOUND * problem.joint.pressure_span
    return np.asarray((interval.lo + tolerance >= P) | (interval.hi - tolerance <= P))


def _total_stiffness(sides: Sides, P1: Array, P2: Array) -> Array:
    return np.asarray(sides[0].stiffness(P1) + sides[1].stiffness(P2))


def _row(*entries: Array | float) -> Array:
    return np.stack(np.broadcast_arrays(*entries), -1)


def _five_point(f: Callable[[float], Array], h: float) -> Array:
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


def _solve(A: Array, B: Array) -> Array:
    """A⁻¹B of stacked 2×2 systems by Cramer's rule, NaN where singular (NumPy's solve would refuse them all)."""
    (a, b), (c, d) = A[:, 0].T, A[:, 1].T
    det = a * d - b * c
    det = np.where(det == 0, np.nan, det)[:, None]
    first = d[:, None] * B[:, 0] - b[:, None] * B[:, 1]
    second = a[:, None] * B[:, 1] - c[:, None] * B[:, 0]
    return np.stack([first, second], 1) / det[:, :, None]


__all__ = ["jacobian"]
