"""Status, optimality residual and gap of answers, computed from their pressures alone, whatever the method.

The residual measures the violation of the optimality conditions. It is the first-order (Gauss–Newton) step that would
still improve the answer within the feasible set, in fractions of the supply range. It vanishes exactly at the
Karush–Kuhn–Tucker points, where the gradient is zero or the active limits have multipliers of the right sign. For the
lexicographic priorities the first goal is tested over the whole feasible set, the second along the level of the first.

The gap is the distance from the bound that the exact method proves for the problem.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import CLOSED_FORM, OPTIMISER, Status, Tolerance, decided
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.limits import PressureBox, PressureInterval
from allocator.joint.one_muscle import OneMuscle
from allocator.joint.torque_levels import Pair

Flags = NDArray[np.bool_]

_ROUNDING = 1e-12  # of the scale of torque or stiffness: a first goal missed by less leaves no step
_CANCELLED = 1e-6  # of two terms: a smaller difference is rounding
_HELD = 1e-3  # a step is held if the limits leave a smaller part of it


class Assessment(NamedTuple):
    """Assessment of n answers, each (n,)."""

    T: Array  # achieved torque [N·m]
    K: Array  # achieved stiffness [N·m/rad]
    status: NDArray[np.int8]
    limits: NDArray[np.int32]  # Limit flags


def assess(
    problem: Problem, P1: Array, P2: Array, outside: NDArray[np.int32], tolerance: Tolerance = CLOSED_FORM
) -> Assessment:
    """Assess feasible pressures; `outside` holds the Limit flag of angles that had to be moved into the joint range."""
    T, K = problem.given(P1, P2)
    T_scale, K_scale = problem.scales
    T_missed = np.abs(T - problem.T) > tolerance.met * T_scale
    K_missed = np.abs(K - problem.K) > problem.stiffness_tolerance + tolerance.met * K_scale
    limits = problem.box.binding(P1, P2, tolerance.binds * problem.joint.pressure_span) | outside
    return Assessment(T, K, decided(T_missed, K_missed, problem.pull > 0, problem.box, outside != 0), limits)


def assess_inverse(problem: Problem, P1: Array, P2: Array, outside: NDArray[np.int32]) -> Assessment:
    """Assess the inverse without limits: `limits` are those that it violates or lies on."""
    found = assess(problem, P1, P2, outside)
    near = CLOSED_FORM.binds * problem.joint.pressure_span
    allowed = problem.box.contains(P1, P2, near) & ~problem.box.empty & (outside == 0)
    status = np.where(allowed, Status.EXACT, Status.OUTSIDE_LIMITS)
    status = np.where(np.isnan(P1), Status.NO_INVERSE, status)
    return found._replace(status=status.astype(np.int8))


def residual(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return the step that would still improve (P1, P2), in fractions of the supply range; (n,), inf for NaN.

    NaN at a kink of a felt stiffness, which has no gradient there.
    """
    weigh = _weighted if problem.priority == "weighted" else _lexicographic
    with np.errstate(invalid="ignore", divide="ignore"):
        found = weigh(problem, P1, P2) / problem.joint.pressure_span
    found = np.where(np.isnan(found), np.inf, found)
    if problem.felt is not None:
        kink = problem.felt.on_kink(P1 + P2, CLOSED_FORM.binds * problem.joint.pressure_span)
        found = np.where(kink, np.nan, found)
    return np.asarray(found)


def _gradients(problem: Problem, P1: Array, P2: Array) -> tuple[Pair, Pair]:
    """Return ((∂T/∂P1, ∂T/∂P2), (∂K/∂P1, ∂K/∂P2))."""
    one, two = problem.sides
    torques = one.torque_gain(P1), two.torque_gain(P2)
    if problem.felt is not None:
        return torques, problem.stiffness_slopes(P1, P2)
    return torques, (_stiffness_gain(one, P1), _stiffness_gain(two, P2))


def _stiffness_gain(side: OneMuscle, P: Array) -> Array:
    """Return dk/dP, 0 at a turning point of the stiffness, where its parts cancel."""
    return _sum(*side.stiffness_gain_terms(P))


def _weighted(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return the Gauss–Newton step of the pressures that no limit holds."""
    (t1, t2), (k1, k2) = _gradients(problem, P1, P2)
    (e_T, e_K), (R1, R2), (w_T, w_K), rho = problem.errors(P1, P2), problem.P_ref, problem.weights, problem.pull
    g1, g2 = (_sum(w_T * t * e_T, w_K * k * e_K) for t, k in ((t1, k1), (t2, k2)))
    h11, h22 = (w_T * t**2 + w_K * k**2 + rho for t, k in ((t1, k1), (t2, k2)))
    h12 = w_T * t1 * t2 + w_K * k1 * k2
    near = CLOSED_FORM.binds * problem.joint.pressure_span
    return newton_step(problem.box, P1, P2, (g1 + rho * (P1 - R1), g2 + rho * (P2 - R2)), (h11, h12, h22), near)


def newton_step(
    box: PressureBox, P1: Array, P2: Array, gradient: Pair, hessian: tuple[Array, Array, Array], near: float
) -> Array:
    """Return the step [Pa] to the minimum of a quadratic cost, of the pressures that no limit within `near` holds.

    On the co-contraction floor, with corners that two limits may hold in many ways, that of a projected gradient step.
    """
    (g1, g2), (h11, h12, h22) = gradient, hessian
    held1, held2 = _held(box.agonist, P1, g1, near), _held(box.antagonist, P2, g2, near)
    on_floor = P1 + P2 <= box.least_sum + near
    det = h11 * h22 - h12**2
    still = (g1 == 0) & (g2 == 0)  # the Hessian may be singular there
    d1, d2 = (np.where(still, 0.0, -d / det) for d in (h22 * g1 - h12 * g2, h11 * g2 - h12 * g1))
    d1 = np.where(held1, 0.0, np.where(held2, -g1 / h11, d1))
    d2 = np.where(held2, 0.0, np.where(held1, -g2 / h22, d2))
    d1, d2 = (np.where(on_floor, -g / (h11 + h22), d) for g, d in ((g1, d1), (g2, d2)))
    Q1, Q2 = box.project(P1 + d1, P2 + d2)
    return np.asarray(np.maximum(np.abs(Q1 - P1), np.abs(Q2 - P2)))


def _sum(one: Array, *others: Array) -> Array:
    """Return the sum, 0 if only rounding remains: on a fold both curves have one slope, and they cancel."""
    total, size = one, np.abs(one)
    for other in others:
        total, size = total + other, size + np.abs(other)
    return np.where(np.abs(total) <= _CANCELLED * size, 0.0, total)


def _held(interval: PressureInterval, P: Array, g: Array, near: float) -> Flags:
    """Return whether P lies on a limit against which the cost's descent -g pushes."""
    return np.asarray(((interval.lo + near >= P) & (g > 0)) | ((interval.hi - near <= P) & (g < 0)))


def _lexicographic(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return the greater of the steps left to the first goal and, along its level, to the second."""
    gradients, errors = _gradients(problem, P1, P2), problem.errors(P1, P2)
    first, second = (0, 1) if problem.priority == "torque" else (1, 0)
    (a1, a2), (b1, b2) = gradients[first], gradients[second]
    missed = np.abs(errors[first]) / problem.scales[first]
    first_step, wanted = _goal_step(problem, P1, P2, errors[first], problem.scales[first], (a1, a2))
    R1, R2 = problem.P_ref
    g1, g2 = (errors[second] * b + problem.pull * d for b, d in ((b1, P1 - R1), (b2, P2 - R2)))
    hessian = b1**2 + problem.pull, b1 * b2, b2**2 + problem.pull
    second_step = level_step(problem.box, P1, P2, (a1, a2), (g1, g2), hessian)
    # a missed first goal that is held is at its limit: a single point
    held = (first_step <= _HELD * wanted) & (missed > OPTIMISER.met)
    free = problem.joint.affine & (a1 == 0) & (a2 == 0)  # the first goal is the same everywhere
    anywhere, _ = _goal_step(problem, P1, P2, errors[second], problem.scales[second], (b1, b2))
    return np.asarray(np.maximum(first_step, np.where(free, anywhere, np.where(held, 0.0, second_step))))


def _goal_step(problem: Problem, P1: Array, P2: Array, error: Array, scale: Array, gradient: Pair) -> Pair:
    """Return the sizes of the step to a goal within the limits and without them."""
    (g1, g2), steep = gradient, gradient[0] ** 2 + gradient[1] ** 2
    wanted = (np.abs(error) > _ROUNDING * scale) & (steep > 0)
    toward = np.where(wanted, -error, 0.0) / np.where(steep > 0, steep, 1.0)
    Q1, Q2 = problem.box.project(P1 + toward * g1, P2 + toward * g2)
    return np.maximum(np.abs(Q1 - P1), np.abs(Q2 - P2)), np.abs(toward) * np.hypot(g1, g2)


def level_step(
    box: PressureBox, P1: Array, P2: Array, kept: Pair, gradient: Pair, hessian: tuple[Array, Array, Array]
) -> Array:
    """Return the step [Pa] to the minimum of a quadratic cost along the level with the gradient `kept`."""
    (a1, a2), (g1, g2), (h11, h12, h22) = kept, gradient, hessian
    norm = np.hypot(a1, a2)
    v1, v2 = -a2 / norm, a1 / norm
    slope = _sum(g1 * v1, g2 * v2)
    step = np.where(slope == 0, 0.0, -slope / (h11 * v1**2 + 2 * h12 * v1 * v2 + h22 * v2**2))
    return np.asarray(np.minimum(np.abs(step), _distance_left(box, P1, P2, np.sign(step) * v1, np.sign(step) * v2)))


def _distance_left(box: PressureBox, P1: Array, P2: Array, v1: Array, v2: Array) -> Array:
    """Return the distance from P along v to the border of the feasible set."""

    def distance(v: Array, P: Array, lo: Array, hi: Array) -> Array:
        return np.where(v > 0, hi - P, np.where(v < 0, P - lo, np.inf)) / np.where(v == 0, 1.0, np.abs(v))

    one = distance(v1, P1, box.agonist.lo, box.agonist.hi)
    two = distance(v2, P2, box.antagonist.lo, box.antagonist.hi)
    total = distance(v1 + v2, P1 + P2, np.asarray(box.least_sum), np.asarray(np.inf))
    return np.maximum(np.minimum(np.minimum(one, two), total), 0.0)


def gap(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return the excess of (P1, P2) over the proved bound (n,), as `Allocation.gap`; NaN without a bound."""
    try:
        best = exact.solve(problem)
    except InvalidInput:  # a pull without a closed form
        return np.full(P1.shape, np.nan)
    costs = [exact.ranking(problem, *pair)[:2] for pair in ((P1, P2), (best.P1, best.P2))]
    if problem.priority != "weighted":  # the second cost is a square
        costs = [(first, np.sqrt(second)) for first, second in costs]
    (first, second), (least_first, least_second) = costs
    first_worse = (first - least_first) / exact.gap_units(problem)[0]
    second_worse = (second - least_second) / exact.gap_units(problem)[1]
    worse = np.where(first_worse > CLOSED_FORM.met, first_worse, second_worse)
    return np.asarray(np.maximum(worse, 0.0) + best.gap)
