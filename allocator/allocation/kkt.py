"""The library's own certificate: how far an answer is from satisfying the optimality conditions of its problem.

The residual is the first-order (Gauss–Newton) step that would still improve the answer without leaving the feasible
set, in fractions of the supply range. It vanishes exactly at the Karush–Kuhn–Tucker points: no step is left, because
the gradient is zero or because the limits in the way have multipliers of the right sign. For the lexicographic
priorities the first goal is tested with all of the feasible set, the second along the level of the first.
"""

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.problem import Problem
from allocator.calculus import Array
from allocator.levels import Pair

Flags = NDArray[np.bool_]

_ON_LIMIT = 1e-9  # of the supply range: nearer to a limit is on it
_ROUNDING = 1e-12  # of the scale of torque or stiffness: a first goal missed by less leaves no step
MET = 1e-6  # of the scale: a first goal missed by more, and held, is at its limit: in one point, which leaves no choice
_HELD = 1e-3  # a step is held where the limits leave less than this of it


def residual(problem: Problem, P1: Array, P2: Array) -> Array:
    """Size of the step that would still improve (P1, P2), in fractions of the supply range; (n,), inf for NaN."""
    weigh = _weighted if problem.priority == "weighted" else _lexicographic
    with np.errstate(invalid="ignore", divide="ignore"):
        found = weigh(problem, P1, P2) / problem.joint.pressure_span
    return np.asarray(np.where(np.isnan(found), np.inf, found))


def _gradients(problem: Problem, P1: Array, P2: Array) -> tuple[Pair, Pair]:
    """((∂T/∂P1, ∂T/∂P2), (∂K/∂P1, ∂K/∂P2))."""
    one, two = problem.sides
    return (one.torque_gain(P1), two.torque_gain(P2)), (one.stiffness_gain(P1), two.stiffness_gain(P2))


def _weighted(problem: Problem, P1: Array, P2: Array) -> Array:
    """Gauss–Newton step of the pressures that no limit holds."""
    (t1, t2), (k1, k2) = _gradients(problem, P1, P2)
    (e_T, e_K), (R1, R2), (w_T, w_K), rho = problem.errors(P1, P2), problem.P_ref, problem.weights, problem.pull
    g1, g2 = (w_T * t * e_T + w_K * k * e_K for t, k in ((t1, k1), (t2, k2)))
    g1, g2 = g1 + rho * (P1 - R1), g2 + rho * (P2 - R2)
    h11, h22 = (w_T * t**2 + w_K * k**2 + rho for t, k in ((t1, k1), (t2, k2)))
    h12 = w_T * t1 * t2 + w_K * k1 * k2
    held1, held2, held_sum = _held(problem, P1, P2, g1, g2)
    det = h11 * h22 - h12**2
    d1, d2 = -(h22 * g1 - h12 * g2) / det, -(h11 * g2 - h12 * g1) / det
    d1, d2 = np.where(held2, -g1 / h11, d1), np.where(held1, -g2 / h22, d2)
    along = -(g1 - g2) / (h11 + h22 - 2 * h12)  # of the co-contraction floor
    d1, d2 = np.where(held_sum, along, d1), np.where(held_sum, -along, d2)
    d1, d2 = np.where(held1, 0.0, d1), np.where(held2, 0.0, d2)
    Q1, Q2 = problem.box.project(P1 + d1, P2 + d2)
    return np.asarray(np.maximum(np.abs(Q1 - P1), np.abs(Q2 - P2)))


def _held(problem: Problem, P1: Array, P2: Array, g1: Array, g2: Array) -> tuple[Flags, Flags, Flags]:
    """Which pressures, and whether their sum, lie on a limit against which the cost's descent -g pushes."""
    box, tolerance = problem.box, _ON_LIMIT * problem.joint.pressure_span

    def held(P: Array, lo: Array, hi: Array, g: Array) -> Flags:
        return np.asarray(((lo + tolerance >= P) & (g > 0)) | ((hi - tolerance <= P) & (g < 0)))

    on_floor = (P1 + P2 <= box.least_sum + tolerance) & (g1 + g2 > 0)
    agonist, antagonist = box
    return held(P1, agonist.lo, agonist.hi, g1), held(P2, antagonist.lo, antagonist.hi, g2), np.asarray(on_floor)


def _lexicographic(problem: Problem, P1: Array, P2: Array) -> Array:
    """The greater of the steps left to the first goal and, along its level, to the second."""
    gradients, errors = _gradients(problem, P1, P2), problem.errors(P1, P2)
    first, second = (0, 1) if problem.priority == "torque" else (1, 0)
    (a1, a2), (b1, b2) = gradients[first], gradients[second]
    missed = np.abs(errors[first]) / problem.scales[first]
    toward = np.where(missed > _ROUNDING, -errors[first], 0.0) / (a1**2 + a2**2)
    Q1, Q2 = problem.box.project(P1 + toward * a1, P2 + toward * a2)
    first_step = np.maximum(np.abs(Q1 - P1), np.abs(Q2 - P2))

    norm = np.hypot(a1, a2)
    v1, v2 = -a2 / norm, a1 / norm  # along the level of the first goal
    R1, R2 = problem.P_ref
    slope = errors[second] * (b1 * v1 + b2 * v2) + problem.pull * ((P1 - R1) * v1 + (P2 - R2) * v2)
    step = -slope / ((b1 * v1 + b2 * v2) ** 2 + problem.pull)
    second_step = np.minimum(np.abs(step), _room(problem, P1, P2, v1, v2, np.sign(step)))
    held = first_step < _HELD * np.abs(toward) * norm
    return np.asarray(np.maximum(first_step, np.where(held & (missed > MET), 0.0, second_step)))


def _room(problem: Problem, P1: Array, P2: Array, v1: Array, v2: Array, sign: Array) -> Array:
    """How far one can go from P along sign·v within the feasible set."""

    def distance(v: Array, P: Array, lo: Array, hi: Array) -> Array:
        return np.where(v > 0, hi - P, np.where(v < 0, P - lo, np.inf)) / np.where(v == 0, 1.0, np.abs(v))

    agonist, antagonist = problem.box
    one = distance(sign * v1, P1, agonist.lo, agonist.hi)
    two = distance(sign * v2, P2, antagonist.lo, antagonist.hi)
    total = distance(sign * (v1 + v2), P1 + P2, np.asarray(problem.box.least_sum), np.asarray(np.inf))
    return np.maximum(np.minimum(np.minimum(one, two), total), 0.0)


__all__ = ["MET", "residual"]
