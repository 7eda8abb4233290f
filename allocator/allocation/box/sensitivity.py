"""Derivatives of a mechanism's pressures by posture, stiffness and torque, with the active set held.

Pressures on a limit move with it. The others are, level after level, the least-squares solution of their rows in the
null space of the earlier rows, nearest to the reference:

    x ← x + (A_k Z)⁺ (b_k - A_k x),     Z ← Z (1 - (A_k Z)⁺ A_k Z),     from x = x_ref, Z = 1 on free ones

which is linear in the targets. Along the posture A, b and the limits are differentiated by five points.
"""

from dataclasses import replace

import numpy as np

from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.status import CLOSED_FORM
from allocator.calculus import STEP, Array, Mask, five_point
from allocator.errors import InvalidInput

_RANK = 1e-9  # of the rows' size: a smaller remainder is rounding


def jacobian(problem: BoxProblem, P: Array) -> Array:
    """Return dP/d(q, K, T) (N, m, n + n(n+1)/2 + n) at pressures (N, m) [Pa]. Raises `InvalidInput`."""
    mechanism = problem.mechanism
    mechanism.check_affine("jacobian()")
    if problem.endpoint is not None:
        raise InvalidInput("jacobian() is of targets in joints; an endpoint was given")
    (lo, hi), near = problem.bounds, CLOSED_FORM.binds * mechanism.pressure_span
    ends = lo + near >= P, hi - near <= P
    free = replace(problem, mechanism=replace(mechanism, angle_limits=None), asked=problem.q)
    columns, n = [], mechanism.n
    for i in range(n):
        inside = ~np.broadcast_to(problem.outside, (problem.size, n))[:, i]  # beyond the range the answer is constant
        columns.append(five_point(lambda h, i=i: _moved(free, i, h, ends), 0.0, STEP) * inside[:, None])  # type: ignore[misc]  # a lambda
    here = _held(free, *ends)
    for i in [*range(n, problem.y.shape[1]), *range(n)]:
        step = np.where(np.arange(problem.y.shape[1]) == i, 1.0, 0.0)
        columns.append(_held(replace(free, y=problem.y + step), *ends) - here)
    return np.stack(columns, axis=-1)


def _moved(problem: BoxProblem, joint: int, h: float, ends: tuple[Mask, Mask]) -> Array:
    """Return the pressures (N, m) [Pa] at postures with one joint moved by `h` [rad]."""
    asked = problem.asked + np.where(np.arange(problem.mechanism.n) == joint, h, 0.0)
    return _held(replace(problem, asked=asked), *ends)


def _held(problem: BoxProblem, at_low: Mask, at_high: Mask) -> Array:
    """Return the pressures (N, m) [Pa] that are optimal while some stay at their lower and upper limits."""
    lo, hi, centre = problem.x_bounds
    x = np.where(at_low, lo, np.where(at_high, hi, centre))
    free = (~(at_low | at_high)).astype(float)
    rows, b = problem.A[problem.which], problem.b
    if problem.pull:
        A = rows * free[:, None]
        H = A.swapaxes(1, 2) @ A + problem.pull * np.eye(A.shape[2])
        return (x + np.linalg.solve(H, A.swapaxes(1, 2) @ _left(rows, b, x)[:, :, None])[:, :, 0]) * problem.unit
    Z, begin = free[:, :, None] * np.eye(x.shape[1]), 0
    for end in problem.rows[1].tolist():
        A, left = rows[:, begin:end], _left(rows[:, begin:end], b[:, begin:end], x)
        inverse = _pseudo_inverse(A @ Z, np.linalg.norm(A, axis=(1, 2)))
        x = x + (Z @ inverse @ left[:, :, None])[:, :, 0]
        Z, begin = Z - Z @ inverse @ A @ Z, end
    return np.asarray(x * problem.unit)


def _left(A: Array, b: Array, x: Array) -> Array:
    return np.asarray(b - (A @ x[:, :, None])[:, :, 0])


def _pseudo_inverse(A: Array, size: Array) -> Array:
    """Return A⁺ (N, m, p) of matrices (N, p, m) that were of this size (N,) before they were projected."""
    U, s, V = np.linalg.svd(A, full_matrices=False)
    kept = s > _RANK * size[:, None]
    inverse = np.where(kept, 1.0 / np.where(kept, s, 1.0), 0.0)
    return np.asarray((V.swapaxes(1, 2) * inverse[:, None, :]) @ U.swapaxes(1, 2))
