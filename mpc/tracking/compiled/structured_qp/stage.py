"""Algebra of one sample for a joint: 4 states and 2 commands, written out.

The functions carry matrices and vectors back over a command and its consequences, with ξ = (δx, w) and 𝔸 = [A B; 0 I],
x_{k+1} = A x_k + B w_{k+1} and w_{k+1} = w_k + v_k. D (N, 3) and its inverse have the entries 00, 01, 11. Products are
written out, arrays are indexed by k instead of sliced, and all functions are inlined: three times as fast. A line is
stored after all its columns are computed, so that the compiler computes them together.
"""

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, merged
from mpc.tracking.compiled.records import Cost, Signs
from mpc.tracking.compiled.structured_qp.sizes import FREE, HIGH


@merged
def combined(SA: Array, j: int, c0: float, c1: float, c2: float, c3: float) -> float:
    """Return the column j of the first four lines of SA (6, 6), each times its c."""
    return float(c0 * SA[0, j] + c1 * SA[1, j] + c2 * SA[2, j] + c3 * SA[3, j])


@merged
def across(S: Array, A: Array, B: Array, k: int, e: Array, SA: Array, R: Array) -> None:
    """Set SA (6, 6) = S 𝔸 and R[k] (2, 6), the last lines of M = 𝔸ᵀ S 𝔸 + diag(0, e[k]), where e[k] (2,) is for w.

    The upper triangle of S becomes the lower one as well: asymmetric rounding would grow from sample to sample.
    """
    for i in range(6):
        for j in range(i):
            S[i, j] = S[j, i]
        s0, s1, s2, s3, s4, s5 = S[i, 0], S[i, 1], S[i, 2], S[i, 3], S[i, 4], S[i, 5]
        t0 = s0 * A[k, 0, 0] + s1 * A[k, 1, 0] + s2 * A[k, 2, 0] + s3 * A[k, 3, 0]
        t1 = s0 * A[k, 0, 1] + s1 * A[k, 1, 1] + s2 * A[k, 2, 1] + s3 * A[k, 3, 1]
        t2 = s0 * A[k, 0, 2] + s1 * A[k, 1, 2] + s2 * A[k, 2, 2] + s3 * A[k, 3, 2]
        t3 = s0 * A[k, 0, 3] + s1 * A[k, 1, 3] + s2 * A[k, 2, 3] + s3 * A[k, 3, 3]
        t4 = s4 + s0 * B[k, 0, 0] + s1 * B[k, 1, 0] + s2 * B[k, 2, 0] + s3 * B[k, 3, 0]
        t5 = s5 + s0 * B[k, 0, 1] + s1 * B[k, 1, 1] + s2 * B[k, 2, 1] + s3 * B[k, 3, 1]
        SA[i, 0], SA[i, 1], SA[i, 2], SA[i, 3], SA[i, 4], SA[i, 5] = t0, t1, t2, t3, t4, t5
    for i in range(2):
        b0, b1, b2, b3 = B[k, 0, i], B[k, 1, i], B[k, 2, i], B[k, 3, i]
        for j in range(6):
            R[k, i, j] = SA[4 + i, j] + combined(SA, j, b0, b1, b2, b3) + (e[k, i] if j == 4 + i else 0.0)


@merged
def decided(A: Array, B: Array, k: int, SA: Array, R: Array, D: Array, F: Array, held: Signs, S: Array) -> None:
    """Set the upper triangle of S to the cost-to-go after v is chosen by the feedback F[k] (2, …): M + R[k]ᵀ F[k], and
    the terms of held commands.
    """
    for i in range(4):
        a0, a1, a2, a3, r0, r1 = A[k, 0, i], A[k, 1, i], A[k, 2, i], A[k, 3, i], R[k, 0, i], R[k, 1, i]
        t0 = combined(SA, 0, a0, a1, a2, a3) + r0 * F[k, 0, 0] + r1 * F[k, 1, 0]
        t1 = combined(SA, 1, a0, a1, a2, a3) + r0 * F[k, 0, 1] + r1 * F[k, 1, 1]
        t2 = combined(SA, 2, a0, a1, a2, a3) + r0 * F[k, 0, 2] + r1 * F[k, 1, 2]
        t3 = combined(SA, 3, a0, a1, a2, a3) + r0 * F[k, 0, 3] + r1 * F[k, 1, 3]
        t4 = combined(SA, 4, a0, a1, a2, a3) + r0 * F[k, 0, 4] + r1 * F[k, 1, 4]
        t5 = combined(SA, 5, a0, a1, a2, a3) + r0 * F[k, 0, 5] + r1 * F[k, 1, 5]
        S[i, 0], S[i, 1], S[i, 2], S[i, 3], S[i, 4], S[i, 5] = t0, t1, t2, t3, t4, t5
    for i in range(2):
        for j in range(4 + i, 6):
            S[4 + i, j] = R[k, i, j] + R[k, 0, 4 + i] * F[k, 0, j] + R[k, 1, 4 + i] * F[k, 1, j]
            if abs(held[k, i]) == HIGH:
                S[4 + i, j] -= R[k, i, j] + D[k, i] * F[k, 0, j] + D[k, 1 + i] * F[k, 1, j]


@merged
def linear_before(s: Array, A: Array, B: Array, k: int) -> None:
    """Turn s (6,) into 𝔸ᵀ s."""
    s0, s1, s2, s3 = s[0], s[1], s[2], s[3]
    s[4] += B[k, 0, 0] * s0 + B[k, 1, 0] * s1 + B[k, 2, 0] * s2 + B[k, 3, 0] * s3
    s[5] += B[k, 0, 1] * s0 + B[k, 1, 1] * s1 + B[k, 2, 1] * s2 + B[k, 3, 1] * s3
    t0 = A[k, 0, 0] * s0 + A[k, 1, 0] * s1 + A[k, 2, 0] * s2 + A[k, 3, 0] * s3
    t1 = A[k, 0, 1] * s0 + A[k, 1, 1] * s1 + A[k, 2, 1] * s2 + A[k, 3, 1] * s3
    t2 = A[k, 0, 2] * s0 + A[k, 1, 2] * s1 + A[k, 2, 2] * s2 + A[k, 3, 2] * s3
    t3 = A[k, 0, 3] * s0 + A[k, 1, 3] * s1 + A[k, 2, 3] * s2 + A[k, 3, 3] * s3
    s[0], s[1], s[2], s[3] = t0, t1, t2, t3


@merged
def advance(A: Array, B: Array, k: int, xi: Array) -> None:
    """Set the state of ξ[k + 1] from ξ[k] (6,), lines of `xi` (N + 1, 6); w of ξ[k + 1] is already known."""
    x0, x1, x2, x3, w0, w1 = xi[k, 0], xi[k, 1], xi[k, 2], xi[k, 3], xi[k + 1, 4], xi[k + 1, 5]
    for i in range(4):
        xi[k + 1, i] = (
            A[k, i, 0] * x0 + A[k, i, 1] * x1 + A[k, i, 2] * x2 + A[k, i, 3] * x3 + B[k, i, 0] * w0 + B[k, i, 1] * w1
        )


@merged
def charge_square(S: Array, slope: Array, k: int, m: int, w: float) -> None:
    """Add w c cᵀ to S (6, 6), c = (`slope`[k, m] (4,), 0)."""
    c0, c1, c2, c3 = slope[k, m, 0], slope[k, m, 1], slope[k, m, 2], slope[k, m, 3]
    for i in range(4):
        c = w * slope[k, m, i]
        t0, t1, t2, t3 = S[i, 0] + c * c0, S[i, 1] + c * c1, S[i, 2] + c * c2, S[i, 3] + c * c3
        S[i, 0], S[i, 1], S[i, 2], S[i, 3] = t0, t1, t2, t3


@merged
def charge_state(S: Array, slope: Array, k: int, cost: Cost) -> None:
    """Add the cost of a state's squared errors to S (6, 6)."""
    for m in range(3):
        if cost.y[m] != 0.0:
            charge_square(S, slope, k, m, cost.y[m])
    for i in range(4):
        S[i, i] += cost.x[i]


@merged
def changed(slope: Array, k: int, m: int, xi: Array) -> float:
    """Return the change of the output m due to ξ[k]."""
    x0, x1, x2, x3 = xi[k, 0], xi[k, 1], xi[k, 2], xi[k, 3]
    return float(slope[k, m, 0] * x0 + slope[k, m, 1] * x1 + slope[k, m, 2] * x2 + slope[k, m, 3] * x3)


@merged
def first_of(limits: float, i: int) -> float:
    """Return the limit of the joint `i`, the only one."""
    return limits


@inlined
def new_squares(N: int) -> Array:
    """Return N uninitialised symmetric matrices of commands."""
    return np.empty((N, 3))


@merged
def times(D: Array, k: int, i: int, v: Array) -> float:
    """Return line `i` of D[k] times v[k]."""
    return float(D[k, i] * v[k, 0] + D[k, 1 + i] * v[k, 1])


@merged
def curvature(D: Array, k: int, i: int) -> float:
    """Return the entry of D[k] for the change `i` alone."""
    return float(D[k, 2 * i])


@merged
def clear(z: Array, pushes: Array, c: int, k: int) -> None:
    """Set z[c, k] and pushes[c, k] to 0."""
    z[c, k, 0], z[c, k, 1], pushes[c, k, 0], pushes[c, k, 1] = 0.0, 0.0, 0.0, 0.0


@merged
def answered(
    R: Array, D: Array, inverse: Array, base: Signs, k: int, c: int, gone: int, p: Array, z: Array, pushes: Array
) -> None:
    """Set z[c, k] to the response at ξ = 0 to the gradient pushes[c, k] by the changes, with 1 for the released change
    `gone` (-1: none), and carry `p` (6,) back over it.
    """
    g0, g1 = pushes[c, k, 0], pushes[c, k, 1]
    d0, d1 = 1.0 if gone == 0 else 0.0, 1.0 if gone == 1 else 0.0
    f0, f1 = g0 + D[k, 0] * d0 + D[k, 1] * d1, g1 + D[k, 1] * d0 + D[k, 2] * d1
    v0, v1 = d0 - inverse[k, 0] * f0 - inverse[k, 1] * f1, d1 - inverse[k, 1] * f0 - inverse[k, 2] * f1
    z[c, k, 0], z[c, k, 1] = v0, v1
    for i in range(6):
        p[i] += R[k, 0, i] * v0 + R[k, 1, i] * v1
    if abs(base[k, 0]) == HIGH:
        p[4] -= g0 + D[k, 0] * v0 + D[k, 1] * v1
    if abs(base[k, 1]) == HIGH:
        p[5] -= g1 + D[k, 1] * v0 + D[k, 2] * v1


@merged
def gone_along(
    R: Array, D: Array, feedback: Array, base: Signs, k: int, c: int, xi: Array, z: Array, pushes: Array
) -> None:
    """Add to the changes z[c, k] the feedback of ξ[k], set pushes[c, k] to the gradient then, and w of ξ[k + 1]."""
    v0, v1, g0, g1 = z[c, k, 0], z[c, k, 1], pushes[c, k, 0], pushes[c, k, 1]
    for i in range(6):
        v0 += feedback[k, 0, i] * xi[k, i]
        v1 += feedback[k, 1, i] * xi[k, i]
        g0 += R[k, 0, i] * xi[k, i]
        g1 += R[k, 1, i] * xi[k, i]
    z[c, k, 0], z[c, k, 1] = v0, v1
    pushes[c, k, 0] = 0.0 if base[k, 0] == FREE else g0 + D[k, 0] * v0 + D[k, 1] * v1
    pushes[c, k, 1] = 0.0 if base[k, 1] == FREE else g1 + D[k, 1] * v0 + D[k, 2] * v1
    xi[k + 1, 4], xi[k + 1, 5] = xi[k, 4] + v0, xi[k, 5] + v1


@merged
def led_back(R: Array, D: Array, g: Array, feedback: Array, held: Signs, k: int, s: Array) -> None:
    """Carry `s` (6,) back over the changes of the feedback at ξ = 0."""
    f0, f1 = feedback[k, 0, 6], feedback[k, 1, 6]
    for i in range(6):
        s[i] += R[k, 0, i] * f0 + R[k, 1, i] * f1
    if abs(held[k, 0]) == HIGH:
        s[4] -= g[k, 0] + D[k, 0] * f0 + D[k, 1] * f1
    if abs(held[k, 1]) == HIGH:
        s[5] -= g[k, 1] + D[k, 1] * f0 + D[k, 2] * f1


@merged
def choose(
    R: Array, charge: Array, D: Array, g: Array, v: Array, held: Signs, k: int, inverse: Array, F: Array
) -> None:
    """Set D, its inverse and the feedback F[k] (2, 7), D v + R ξ + g = 0 for the free inputs; held ones are v, or v - w
    if their command is held; charge[k] (2,) of the changes.
    """
    D[k, 0], D[k, 1], D[k, 2] = R[k, 0, 4] + charge[k, 0], R[k, 0, 5], R[k, 1, 5] + charge[k, 1]
    a, b, c = 0.0, 0.0, 0.0  # of the inverse of D, negative
    g0, g1 = g[k, 0], g[k, 1]
    if held[k, 0] == FREE and held[k, 1] == FREE:
        det = D[k, 0] * D[k, 2] - D[k, 1] * D[k, 1]
        a, b, c = -D[k, 2] / det, D[k, 1] / det, -D[k, 0] / det
    elif held[k, 0] == FREE:
        a = -1.0 / D[k, 0]
        g0 += D[k, 1] * v[k, 1]
    elif held[k, 1] == FREE:
        c = -1.0 / D[k, 2]
        g1 += D[k, 1] * v[k, 0]
    inverse[k, 0], inverse[k, 1], inverse[k, 2] = -a, -b, -c
    for i in range(2):
        c0, c1 = a if i == 0 else b, b if i == 0 else c
        t0, t1 = c0 * R[k, 0, 0] + c1 * R[k, 1, 0], c0 * R[k, 0, 1] + c1 * R[k, 1, 1]
        t2, t3 = c0 * R[k, 0, 2] + c1 * R[k, 1, 2], c0 * R[k, 0, 3] + c1 * R[k, 1, 3]
        t4, t5 = c0 * R[k, 0, 4] + c1 * R[k, 1, 4], c0 * R[k, 0, 5] + c1 * R[k, 1, 5]
        F[k, i, 0], F[k, i, 1], F[k, i, 2], F[k, i, 3], F[k, i, 4], F[k, i, 5] = t0, t1, t2, t3, t4, t5
    F[k, 0, 6] = a * g0 + b * g1 if held[k, 0] == FREE else v[k, 0]
    F[k, 1, 6] = b * g0 + c * g1 if held[k, 1] == FREE else v[k, 1]
    if abs(held[k, 0]) == HIGH:
        F[k, 0, 4] = -1.0
        F[k, 1, 4] -= c * D[k, 1]
    if abs(held[k, 1]) == HIGH:
        F[k, 1, 5] = -1.0
        F[k, 0, 5] -= a * D[k, 1]
