"""`border_points` lists candidates for the optimum of affine muscles on the border of the feasible set.

Along a straight line P = start + s·direction torque and stiffness are affine in s: on an edge of the box, and on the
co-contraction floor, where P1 + P2 is constant. The optimum on the line is where the torque or the stiffness is met, or
for the weighted priority where the cost is stationary, each clipped to the line, or an end of it. Ends that the floor
cuts off are sorted out by who compares the candidates.
"""

from collections.abc import Iterator

import numpy as np

from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.joint.limits import PressureBox
from allocator.joint.torque_levels import Pair


def border_points(problem: Problem) -> Pair:
    """Return all candidates (P1, P2), each (m, n), on the edges and at the corners."""
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
    """Return how far from (P1, P2) along (d1, d2) the optimum may lie; 0 where a goal is the same all along."""
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
