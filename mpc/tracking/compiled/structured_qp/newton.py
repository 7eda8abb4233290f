"""A Newton step of `interior` is a problem without rows: its matrices, and its solution.

With W = λ/t of the rows, σ = (s, s_F) carried beside S as a border, P = ∂²V/∂ξ∂σ and Σ = ∂²V/∂σ², which is equal to two
constant states more and takes less. All is in differences from the iterate, which keeps digits.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat, merged
from mpc.tracking.compiled.records import Cost, Errors, Path, Point
from mpc.tracking.compiled.structured_qp.stage import (
    across,
    advance,
    changed,
    charge_square,
    charge_state,
    decided,
    linear_before,
)

BOUNDS, SUPPLY, ALL = 4, 8, 12  # rows of a sample: of the changes alone, with those of the commands, and all


class Factors(NamedTuple):
    """The factors are what the quadratic part of a step leaves to its linear part."""

    R: Array  # (N, 2, 6)
    feedback: Array  # (N, 2, 7) of v by ξ, and one that it does not need
    border: Array  # (N, 2, 2) of v by σ
    inverse: Array  # (N, 3) of D: entries 00, 01, 11
    sigma: Array  # (3,) Σ: entries 00, 01, 11


@inlined_flat
def gradients(path: Path, errors: Errors, cost: Cost, at: Point, gx: Array, gv: Array) -> None:
    """Set the gradient of the cost without rows at a point: `gx` (N+1, 6) by ξ_k, k > 0, `gv` (N, 2) by v_k."""
    N, xi = gv.shape[0], at.xi
    for k in range(1, N):
        for i in range(4):
            gx[k, i] = cost.x[i] * (errors.x[k, i] + xi[k, i])
        for m in range(3):
            if cost.y[m] != 0.0:
                y = cost.y[m] * (errors.y[k, m] + changed(path.slope, k, m, xi))
                for i in range(4):
                    gx[k, i] += y * path.slope[k, m, i]
        for i in range(2):
            gx[k, 4 + i] = cost.e[i] * (errors.e[k - 1, i] + xi[k, 4 + i])
    for i in range(6):
        gx[N, i] = cost.e[i - 4] * (errors.e[N - 1, i - 4] + xi[N, i]) if i > 3 else 0.0
        for j in range(6):
            gx[N, i] += cost.end[i, j] * (errors.end[j] + xi[N, j])
    for k in range(N):
        for i in range(2):
            gv[k, i] = cost.change[i] * (errors.change[k, i] + at.v[k, i])


@inlined
def adjoint(path: Path, gx: Array, gv: Array, r: Array) -> None:
    """Set `r` (N, 2) to the gradient by v alone, ξ following from it."""
    N = gv.shape[0]
    p = gx[N].copy()
    for k in range(N - 1, -1, -1):
        linear_before(p, path.A, path.B, k)
        r[k, 0], r[k, 1] = p[4] + gv[k, 0], p[5] + gv[k, 1]
        if k > 0:
            for i in range(6):
                p[i] += gx[k, i]


@merged
def pressed(p: Array, slope: Array, k: int, push: Array) -> None:
    """Add to `p` (6,), a gradient by ξ[k + 1], what the multipliers `push`[k] (12,) of the soft rows do to it."""
    p[0] += push[k, 8] - push[k, 9]
    for i in range(2):
        for j in range(4):
            p[j] -= push[k, 10 + i] * slope[k + 1, 1 + i, j]


@inlined
def left_over(
    path: Path, slack: Array, at: Point, gx: Array, gv: Array, push: Array, count: int, r: Array
) -> tuple[float, float]:
    """Set `r` (N, 2) to the gradient of the Lagrangian by v with the multipliers `push` (N + 1, 12) of the first
    `count` rows; return that by s and s_F.
    """
    N = gv.shape[0]
    p = gx[N].copy()
    c0, c1 = slack[0] + slack[1] * at.sigma[0] - push[N, 0], slack[2] + slack[3] * at.sigma[1] - push[N, 1]
    for k in range(N - 1, -1, -1):
        if count == ALL:
            pressed(p, path.slope, k, push)
            c0 -= push[k, 8] + push[k, 9]
            c1 -= push[k, 10] + push[k, 11]
        if count >= SUPPLY:
            p[4] += push[k, 4] - push[k, 6]
            p[5] += push[k, 5] - push[k, 7]
        linear_before(p, path.A, path.B, k)
        for i in range(2):
            r[k, i] = p[4 + i] + gv[k, i] + push[k, i] - push[k, 2 + i]
        if k > 0:
            for i in range(6):
                p[i] += gx[k, i]
    return c0, c1


@inlined
def factorise(path: Path, cost: Cost, slack: Array, W: Array, there: Any, count: int, f: Factors) -> None:
    """Fill in the factors of a step for `W` (N + 1, 12) = λ/t of the first `count` rows."""
    N = there.size
    S, SA, P, G, e = cost.end.copy(), np.empty((6, 6)), np.zeros((6, 2)), np.zeros((2, 2)), cost.e.copy()
    f.sigma[0], f.sigma[1], f.sigma[2] = slack[1] + W[N, 0], 0.0, slack[3] + W[N, 1]
    for k in range(N - 1, -1, -1):
        if count == ALL:
            press(S, P, f.sigma, path.slope, k, W)
            border_before(P, path.A, path.B, k)
        if count >= SUPPLY:
            e[0], e[1] = cost.e[0] + W[k, 4] + W[k, 6], cost.e[1] + W[k, 5] + W[k, 7]
        across(S, path.A, path.B, k, e, SA, f.R)
        if there[k]:
            invert(f.R, k, cost.change[0] + W[k, 0] + W[k, 2], cost.change[1] + W[k, 1] + W[k, 3], f.inverse)
        else:
            f.inverse[k, 0], f.inverse[k, 1], f.inverse[k, 2] = 0.0, 0.0, 0.0
        a, b, c = -f.inverse[k, 0], -f.inverse[k, 1], -f.inverse[k, 2]
        for j in range(6):
            f.feedback[k, 0, j] = a * f.R[k, 0, j] + b * f.R[k, 1, j]
            f.feedback[k, 1, j] = b * f.R[k, 0, j] + c * f.R[k, 1, j]
        decided(path.A, k, SA, f.R, f.feedback, S)
        if count == ALL:
            decided_border(P, G, k, f)
        if k > 0:
            charge_state(S, path.slope, k, cost)


@merged
def press(S: Array, P: Array, sigma: Array, slope: Array, k: int, W: Array) -> None:
    """Add the rows of the state k + 1 to S, P and Σ."""
    S[0, 0] += W[k, 8] + W[k, 9]
    P[0, 0] += W[k, 9] - W[k, 8]
    sigma[0] += W[k, 8] + W[k, 9]
    for i in range(2):
        w = W[k, 10 + i]
        sigma[2] += w
        charge_square(S, slope, k + 1, 1 + i, w)
        for j in range(4):
            P[j, 1] += w * slope[k + 1, 1 + i, j]


@merged
def border_before(P: Array, A: Array, B: Array, k: int) -> None:
    """Turn P (6, 2) into 𝔸ᵀ P."""
    for j in range(2):
        p0, p1, p2, p3 = P[0, j], P[1, j], P[2, j], P[3, j]
        P[4, j] += B[k, 0, 0] * p0 + B[k, 1, 0] * p1 + B[k, 2, 0] * p2 + B[k, 3, 0] * p3
        P[5, j] += B[k, 0, 1] * p0 + B[k, 1, 1] * p1 + B[k, 2, 1] * p2 + B[k, 3, 1] * p3
        for i in range(4):
            P[i, j] = A[k, 0, i] * p0 + A[k, 1, i] * p1 + A[k, 2, i] * p2 + A[k, 3, i] * p3


@merged
def invert(R: Array, k: int, least0: float, least1: float, inverse: Array) -> None:
    """Set `inverse`[k] (3,) of D by LDLᵀ, the larger pivot first; the second is no less than its own charge."""
    d0, d1, off = R[k, 0, 4] + least0, R[k, 1, 5] + least1, R[k, 0, 5]
    if d0 >= d1:
        ratio = off / d0
        second = 1.0 / max(d1 - ratio * off, least1)
        inverse[k, 0], inverse[k, 1], inverse[k, 2] = 1.0 / d0 + ratio * ratio * second, -ratio * second, second
    else:
        ratio = off / d1
        second = 1.0 / max(d0 - ratio * off, least0)
        inverse[k, 0], inverse[k, 1], inverse[k, 2] = second, -ratio * second, 1.0 / d1 + ratio * ratio * second


@merged
def decided_border(P: Array, G: Array, k: int, f: Factors) -> None:
    """Set the border of stage `k`, and P and Σ to what is left of them once v is chosen."""
    a, b, c = -f.inverse[k, 0], -f.inverse[k, 1], -f.inverse[k, 2]
    for j in range(2):
        G[0, j], G[1, j] = P[4, j], P[5, j]
        f.border[k, 0, j], f.border[k, 1, j] = a * G[0, j] + b * G[1, j], b * G[0, j] + c * G[1, j]
    for j in range(2):
        for i in range(6):
            P[i, j] += f.R[k, 0, i] * f.border[k, 0, j] + f.R[k, 1, i] * f.border[k, 1, j]
    f.sigma[0] += G[0, 0] * f.border[k, 0, 0] + G[1, 0] * f.border[k, 1, 0]
    f.sigma[1] += G[0, 0] * f.border[k, 0, 1] + G[1, 0] * f.border[k, 1, 1]
    f.sigma[2] += G[0, 1] * f.border[k, 0, 1] + G[1, 1] * f.border[k, 1, 1]


@inlined
def direction(
    path: Path, f: Factors, slack: Array, at: Point, gx: Array, gv: Array, push: Array, count: int, by: Point
) -> None:
    """Set the step `by` from the point `at`, its gradients being `gx` and `gv`, for the multipliers `push`."""
    N = gv.shape[0]
    p = gx[N].copy()
    c0, c1 = slack[0] + slack[1] * at.sigma[0] - push[N, 0], slack[2] + slack[3] * at.sigma[1] - push[N, 1]
    for k in range(N - 1, -1, -1):
        if count == ALL:
            pressed(p, path.slope, k, push)
            c0 -= push[k, 8] + push[k, 9]
            c1 -= push[k, 10] + push[k, 11]
        if count >= SUPPLY:
            p[4] += push[k, 4] - push[k, 6]
            p[5] += push[k, 5] - push[k, 7]
        linear_before(p, path.A, path.B, k)
        g0, g1 = p[4] + gv[k, 0] + push[k, 0] - push[k, 2], p[5] + gv[k, 1] + push[k, 1] - push[k, 3]
        by.v[k, 0] = -f.inverse[k, 0] * g0 - f.inverse[k, 1] * g1
        by.v[k, 1] = -f.inverse[k, 1] * g0 - f.inverse[k, 2] * g1
        for i in range(6):
            p[i] += f.feedback[k, 0, i] * g0 + f.feedback[k, 1, i] * g1
        if count == ALL:
            c0 += f.border[k, 0, 0] * g0 + f.border[k, 1, 0] * g1
            c1 += f.border[k, 0, 1] * g0 + f.border[k, 1, 1] * g1
        if k > 0:
            for i in range(6):
                p[i] += gx[k, i]
    by.sigma[0], by.sigma[1] = 0.0, 0.0
    if count == ALL:
        ratio = f.sigma[1] / f.sigma[0]
        by.sigma[1] = -(c1 - ratio * c0) / max(f.sigma[2] - ratio * f.sigma[1], slack[3])
        by.sigma[0] = -c0 / f.sigma[0] - ratio * by.sigma[1]
    follow(path, f, count, by)


@inlined_flat
def follow(path: Path, f: Factors, count: int, by: Point) -> None:
    """Add the feedback to the changes of the step `by`, and set where they lead."""
    xi, v = by.xi, by.v
    for i in range(6):
        xi[0, i] = 0.0
    for k in range(v.shape[0]):
        for i in range(2):
            change = v[k, i]
            for j in range(6):
                change += f.feedback[k, i, j] * xi[k, j]
            if count == ALL:
                change += f.border[k, i, 0] * by.sigma[0] + f.border[k, i, 1] * by.sigma[1]
            v[k, i] = change
            xi[k + 1, 4 + i] = xi[k, 4 + i] + change
        advance(path.A, path.B, k, xi)
