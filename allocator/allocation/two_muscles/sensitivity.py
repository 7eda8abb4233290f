"""Derivatives of two allocated pressures by angle, stiffness and torque, with the active set held.

An answer is the solution of two equations G(P; θ, K*, T*) = 0, hence dP = -G_P⁻¹ G_x dx. Where both targets are met
they are T = T* and K = K*. Otherwise every active limit replaces an equation, P_i = b_i(θ) or P1 + P2 = 2 P_co, and a
remaining one keeps the target that has priority, or the cost stationary along the free direction.
"""

import numpy as np

from allocator.allocation.status import CLOSED_FORM
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import STEP, Array, Mask, five_point
from allocator.joint.limits import Limit, PressureInterval

_BY_FORCE = Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK | Limit.AGONIST_FORCE | Limit.ANTAGONIST_FORCE
_BY_VOLUME = Limit.AGONIST_VALIDITY | Limit.ANTAGONIST_VALIDITY
_SINGULAR = 1e-12  # of the rows' lengths: a determinant of no more is rounding


def jacobian(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return dP/d(θ, K, T), (n, 2, 3); NaN where the equations are singular."""
    first, second = _free_rows(problem, P1, P2)
    e_T, e_K = np.abs(problem.errors(P1, P2))
    missed = (e_T > CLOSED_FORM.met * problem.scales[0]) | (e_K > CLOSED_FORM.met * problem.scales[1])
    near = CLOSED_FORM.binds * problem.joint.pressure_span
    held1, held2 = (missed & _on_bound(i, P, near) for i, P in zip(problem.box, (P1, P2), strict=True))
    on_floor = missed & (problem.box.least_sum + near >= P1 + P2) & ~(held1 & held2)
    bound1, bound2 = (_bound_row(problem, i, P) for i, P in enumerate((P1, P2)))
    floor = _row(np.ones(P1.size), 1.0, 0.0, 0.0, 0.0)
    for held, row, direction in (
        (held1, bound1, (0.0, 1.0)),
        (held2, bound2, (1.0, 0.0)),
        (on_floor, floor, (1.0, -1.0)),
    ):
        if held.any():
            along = _rest_row(problem, P1, P2, direction)
            taken = held1 & held2 if row is floor else np.zeros(P1.size, bool)
            first, second = _where(held & ~taken, row, first), _where(held & ~taken, along, second)
    both = [(held1 & held2, bound1, bound2), (held1 & on_floor, bound1, floor), (held2 & on_floor, bound2, floor)]
    for held, row, other in both:
        first, second = _where(held, row, first), _where(held, other, second)
    rows = np.stack([first, second], 1)  # (n, 2, 5): G_P1, G_P2, G_θ, G_K, G_T
    return _solve(rows[:, :, :2], -rows[:, :, 2:])


def _free_rows(problem: Problem, P1: Array, P2: Array) -> tuple[Array, Array]:
    """Return the two equations without active limits."""
    torque, stiffness = _torque_row(problem, P1, P2), _stiffness_row(problem, P1, P2)
    if not problem.pull:
        return torque, stiffness
    if problem.priority == "weighted":
        return _stationary_row(problem, P1, P2, (1.0, 0.0)), _stationary_row(problem, P1, P2, (0.0, 1.0))
    return (torque if problem.priority == "torque" else stiffness), _stationary_row(problem, P1, P2, None)


def _rest_row(problem: Problem, P1: Array, P2: Array, direction: tuple[float, float]) -> Array:
    """Return the remaining equation along the free direction."""
    if problem.priority == "torque":
        return _torque_row(problem, P1, P2)
    if problem.priority == "stiffness":
        return _stiffness_row(problem, P1, P2)
    return _stationary_row(problem, P1, P2, direction)


def _torque_row(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return the row of T(θ, P) - T* = 0; ∂T/∂θ = -K by definition of the isobaric K."""
    one, two = problem.sides
    K = one.isobaric.stiffness(P1) + two.isobaric.stiffness(P2)
    return _row(one.torque_gain(P1), two.torque_gain(P2), -K, 0.0, -1.0)


def _stiffness_row(problem: Problem, P1: Array, P2: Array) -> Array:
    """Return the row of K(θ, P) - K* = 0."""
    K_theta = five_point(lambda h: problem.at(problem.theta + h).stiffness(P1, P2), 0.0, STEP)
    return _row(*problem.stiffness_slopes(P1, P2), K_theta, -1.0, 0.0)


def _stationary_row(problem: Problem, P1: Array, P2: Array, direction: tuple[float, float] | None) -> Array:
    """Return the row of φ = ∇cost·v = 0 along the direction v of pressures; None: along the level with priority."""
    (w_T, w_K), (R1, R2), step = _second_goal(problem), problem.P_ref, STEP * problem.joint.pressure_span

    def phi(dP1: float, dP2: float, dtheta: float) -> Array:
        moved = problem.at(problem.theta + dtheta)
        (one, two), Q1, Q2 = moved.sides, P1 + dP1, P2 + dP2
        e_T = one.torque(Q1) + two.torque(Q2) - problem.T_aim
        e_K = moved.stiffness(Q1, Q2) - problem.K_aim
        t, k = (one.torque_gain(Q1), two.torque_gain(Q2)), moved.stiffness_slopes(Q1, Q2)
        level = t if problem.priority == "torque" else k
        v = (-level[1], level[0]) if direction is None else direction
        slopes = [w_T * e_T * t[i] + w_K * e_K * k[i] for i in (0, 1)]
        return np.asarray((slopes[0] + problem.pull * (Q1 - R1)) * v[0] + (slopes[1] + problem.pull * (Q2 - R2)) * v[1])

    one, two = problem.sides
    t, k = (one.torque_gain(P1), two.torque_gain(P2)), problem.stiffness_slopes(P1, P2)
    level = t if problem.priority == "torque" else k
    v = (-level[1], level[0]) if direction is None else direction
    return _row(
        five_point(lambda h: phi(h, 0, 0), 0.0, step),
        five_point(lambda h: phi(0, h, 0), 0.0, step),
        five_point(lambda h: phi(0, 0, h), 0.0, STEP),
        -w_K * (k[0] * v[0] + k[1] * v[1]),
        -w_T * (t[0] * v[0] + t[1] * v[1]),
    )


def _second_goal(problem: Problem) -> tuple[float, float]:
    """Return the weights of the remaining cost once the target with priority is kept."""
    return {"torque": (0.0, 1.0), "stiffness": (1.0, 0.0)}.get(problem.priority, problem.weights)


def _bound_row(problem: Problem, i: int, P: Array) -> Array:
    """Return the row of P_i - b_i(θ) = 0.

    F(b, ε) = F_min moves with ε' = ±a/l0, as does the greatest pressure of trapped gas; others are constant.
    """
    side, interval = problem.sides[i], (problem.box.agonist, problem.box.antagonist)[i]
    row = np.zeros((P.size, 5))
    row[:, i] = 1.0
    at_low = P - interval.lo <= interval.hi - P
    by_force = np.where(at_low, interval.lo_limit & _BY_FORCE, interval.hi_limit & _BY_FORCE) != 0
    stretch = side.arm / side.rest_length
    gain, slope = side.muscle.gain(P, side.contraction), side.muscle.slope(P, side.contraction)
    row[:, 2] = np.where(by_force & ~interval.empty, slope * stretch / gain, 0.0)
    if problem.shares is not None and not side.affine:
        by_volume = ~at_low & ~by_force & (interval.hi_limit & _BY_VOLUME != 0) & ~interval.empty
        row[:, 2] = np.where(by_volume, -five_point(lambda h: _upper_end(problem, i, h), 0.0, STEP), row[:, 2])
    return row


def _upper_end(problem: Problem, i: int, h: float) -> Array:
    """Return the greatest pressure of a muscle at angles moved by `h` [rad]."""
    box = problem.at(problem.theta + h).box
    return (box.agonist, box.antagonist)[i].hi


def _on_bound(interval: PressureInterval, P: Array, near: float) -> Mask:
    return np.asarray((interval.lo + near >= P) | (interval.hi - near <= P))


def _where(mask: Mask, row: Array, other: Array) -> Array:
    return np.where(mask[:, None], row, other)


def _row(*entries: Array | float) -> Array:
    return np.stack(np.broadcast_arrays(*entries), -1)


def _solve(A: Array, B: Array) -> Array:
    """Return A⁻¹B of stacked 2×2 systems by Cramer's rule, NaN where singular (NumPy's solve would refuse them all).

    They are singular if the stiffness has priority and turns at the answer: its row is then only rounding.
    """
    (a, b), (c, d) = A[:, 0].T, A[:, 1].T
    det = a * d - b * c
    singular = np.abs(det) <= _SINGULAR * np.hypot(a, b) * np.hypot(c, d)
    det = np.where(singular, np.nan, det)[:, None]
    first = d[:, None] * B[:, 0] - b[:, None] * B[:, 1]
    second = a[:, None] * B[:, 1] - c[:, None] * B[:, 0]
    return np.stack([first, second], 1) / det[:, :, None]
