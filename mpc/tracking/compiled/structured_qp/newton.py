"""Newton step of `interior`, a problem without rows: its matrices and its solution.

With W = λ/t of the rows, σ = (s, s_F) is a border of S, P = ∂²V/∂ξ∂σ and Σ = ∂²V/∂σ². This is equivalent to two more
constant states and takes less time. All quantities are differences from the iterate, which preserves digits.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from mpc.codegen.jit import inlined, inlined_flat, merged
from mpc.tracking.compiled.records import Cost, Errors, Path, Point
from mpc.tracking.compiled.structured_qp.sizes import ALL, BOUNDS, FORCE, JOINTS, NU, NX, NXI, NY, STIFFNESSES, SUPPLY
from mpc.tracking.compiled.structured_qp.stage import (
    across,
    advance,
    along,
    answered,
    border_before,
    changed,
    charge_square,
    charge_state,
    decided,
    decided_border,
    fed_back,
    invert,
    linear_before,
)


class Factors(NamedTuple):
    """Results of the quadratic part of a step for its linear part."""

    R: Array  # (N, 2, 6)
    feedback: Array  # (N, 2, 7) of v by ξ; the last column is unused
    border: Array  # (N, 2, 2) of v by σ
    inverse: Array  # (N, 3) of D: entries 00, 01, 11
    sigma: Array  # (3,) Σ: entries 00, 01, 11


@inlined_flat
def gradients(path: Path, errors: Errors, cost: Cost, at: Point, gx: Array, gv: Array) -> None:
    """Set the gradient of the cost without rows at a point: `gx` (N+1, 6) by ξ_k, k > 0, `gv` (N, 2) by v_k."""
    N, xi = gv.shape[0], at.xi
    for k in range(1, N):
        for i in range(NX):
            gx[k, i] = cost.x[i] * (errors.x[k, i] + xi[k, i])
        for m in range(NY):
            if cost.y[m] != 0.0:
                y = cost.y[m] * (errors.y[k, m] + changed(path.slope, k, m, xi))
                for i in range(NX):
                    gx[k, i] += y * path.slope[k, m, i]
        for i in range(NU):
            gx[k, NX + i] = cost.e[i] * (errors.e[k - 1, i] + xi[k, NX + i])
    for i in range(NXI):
        gx[N, i] = cost.e[i - NX] * (errors.e[N - 1, i - NX] + xi[N, i]) if i >= NX else 0.0
        for j in range(NXI):
            gx[N, i] += cost.end[i, j] * (errors.end[j] + xi[N, j])
    for k in range(N):
        for i in range(NU):
            gv[k, i] = cost.change[i] * (errors.change[k, i] + at.v[k, i])


@inlined
def adjoint(path: Path, gx: Array, gv: Array, r: Array) -> None:
    """Set `r` (N, 2) to the gradient by v alone, with ξ as a function of v."""
    N = gv.shape[0]
    p = gx[N].copy()
    for k in range(N - 1, -1, -1):
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            r[k, i] = p[NX + i] + gv[k, i]
        if k > 0:
            for i in range(NXI):
                p[i] += gx[k, i]


@merged
def pressed(p: Array, slope: Array, k: int, push: Array) -> None:
    """Add to `p` (6,), a gradient by ξ[k + 1], the part of the multipliers `push`[k] (12,) of the soft rows."""
    for i in range(JOINTS):
        p[i] += push[k, SUPPLY + i] - push[k, SUPPLY + JOINTS + i]
    for i in range(NU):
        for j in range(NX):
            p[j] -= push[k, FORCE + i] * slope[k + 1, STIFFNESSES + i, j]


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
            for i in range(2 * JOINTS):
                c0 -= push[k, SUPPLY + i]
            for i in range(NU):
                c1 -= push[k, FORCE + i]
        if count >= SUPPLY:
            for i in range(NU):
                p[NX + i] += push[k, BOUNDS + i] - push[k, BOUNDS + NU + i]
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            r[k, i] = p[NX + i] + gv[k, i] + push[k, i] - push[k, NU + i]
        if k > 0:
            for i in range(NXI):
                p[i] += gx[k, i]
    return c0, c1


@inlined
def factorise(path: Path, cost: Cost, slack: Array, W: Array, there: Mask, count: int, f: Factors) -> None:
    """Fill in the factors of a step for `W` (N + 1, 12) = λ/t of the first `count` rows."""
    N = there.size
    S, SA, P, G, e = cost.end.copy(), np.empty((NXI, NXI)), np.zeros((NXI, 2)), np.zeros((NU, 2)), cost.e.copy()
    f.sigma[0], f.sigma[1], f.sigma[2] = slack[1] + W[N, 0], 0.0, slack[3] + W[N, 1]
    for k in range(N - 1, -1, -1):
        if count == ALL:
            press(S, P, f.sigma, path.slope, k, W)
            border_before(P, path.A, path.B, k)
        if count >= SUPPLY:
            for i in range(NU):
                e[i] = cost.e[i] + W[k, BOUNDS + i] + W[k, BOUNDS + NU + i]
        across(S, path.A, path.B, k, e, SA, f.R)
        invert(f.R, k, cost.change, W, there[k], f.inverse)
        fed_back(f.inverse, f.R, k, f.feedback)
        decided(path.A, path.B, k, SA, f.R, f.feedback, S)
        if count == ALL:
            decided_border(P, G, k, f.inverse, f.R, f.border, f.sigma)
        if k > 0:
            charge_state(S, path.slope, k, cost)


@merged
def press(S: Array, P: Array, sigma: Array, slope: Array, k: int, W: Array) -> None:
    """Add the rows of the state k + 1 to S, P and Σ."""
    for i in range(JOINTS):
        above, below = W[k, SUPPLY + i], W[k, SUPPLY + JOINTS + i]
        S[i, i] += above + below
        P[i, 0] += below - above
        sigma[0] += above + below
    for i in range(NU):
        w = W[k, FORCE + i]
        sigma[2] += w
        charge_square(S, slope, k + 1, STIFFNESSES + i, w)
        for j in range(NX):
            P[j, 1] += w * slope[k + 1, STIFFNESSES + i, j]


@inlined
def direction(
    path: Path, f: Factors, slack: Array, at: Point, gx: Array, gv: Array, push: Array, count: int, by: Point
) -> None:
    """Set the step `by` from the point `at` with the gradients `gx` and `gv`, for the multipliers `push`."""
    N = gv.shape[0]
    p = gx[N].copy()
    c0, c1 = slack[0] + slack[1] * at.sigma[0] - push[N, 0], slack[2] + slack[3] * at.sigma[1] - push[N, 1]
    for k in range(N - 1, -1, -1):
        if count == ALL:
            pressed(p, path.slope, k, push)
            for i in range(2 * JOINTS):
                c0 -= push[k, SUPPLY + i]
            for i in range(NU):
                c1 -= push[k, FORCE + i]
        if count >= SUPPLY:
            for i in range(NU):
                p[NX + i] += push[k, BOUNDS + i] - push[k, BOUNDS + NU + i]
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            by.v[k, i] = p[NX + i] + gv[k, i] + push[k, i] - push[k, NU + i]
        if count == ALL:
            c0 += along(f.border, k, 0, by.v)
            c1 += along(f.border, k, 1, by.v)
        answered(f.inverse, f.feedback, k, by.v, p)
        if k > 0:
            for i in range(NXI):
                p[i] += gx[k, i]
    by.sigma[0], by.sigma[1] = 0.0, 0.0
    if count == ALL:
        ratio = f.sigma[1] / f.sigma[0]
        by.sigma[1] = -(c1 - ratio * c0) / max(f.sigma[2] - ratio * f.sigma[1], slack[3])
        by.sigma[0] = -c0 / f.sigma[0] - ratio * by.sigma[1]
    follow(path, f, count, by)


@inlined_flat
def follow(path: Path, f: Factors, count: int, by: Point) -> None:
    """Add the feedback to the changes of the step `by`, and set the states that follow."""
    xi, v = by.xi, by.v
    for i in range(NXI):
        xi[0, i] = 0.0
    for k in range(v.shape[0]):
        for i in range(NU):
            change = v[k, i]
            for j in range(NXI):
                change += f.feedback[k, i, j] * xi[k, j]
            if count == ALL:
                change += f.border[k, i, 0] * by.sigma[0] + f.border[k, i, 1] * by.sigma[1]
            v[k, i] = change
            xi[k + 1, NX + i] = xi[k, NX + i] + change
        advance(path.A, path.B, k, xi)
