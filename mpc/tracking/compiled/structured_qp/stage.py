"""The algebra of one sample: how matrices and vectors go back over the command and its consequences.

With ξ = (δx, w) and 𝔸 = [A B; 0 I], where x_{k+1} = A x_k + B w_{k+1} and w_{k+1} = w_k + v_k. Products are written
out, arrays are indexed by k and not cut, and all is compiled into its callers: it is three times as fast so.
"""

from allocator.calculus import Array
from mpc.codegen.jit import merged
from mpc.tracking.compiled.records import Cost


@merged
def across(S: Array, A: Array, B: Array, k: int, e: Array, SA: Array, R: Array) -> None:
    """Set SA (6, 6) = S 𝔸 and R[k] (2, 6), the last lines of M = 𝔸ᵀ S 𝔸 + diag(0, `e`), where `e` (2,) is for w."""
    for i in range(6):
        s0, s1, s2, s3 = S[i, 0], S[i, 1], S[i, 2], S[i, 3]
        t0 = s0 * A[k, 0, 0] + s1 * A[k, 1, 0] + s2 * A[k, 2, 0] + s3 * A[k, 3, 0]
        t1 = s0 * A[k, 0, 1] + s1 * A[k, 1, 1] + s2 * A[k, 2, 1] + s3 * A[k, 3, 1]
        t2 = s0 * A[k, 0, 2] + s1 * A[k, 1, 2] + s2 * A[k, 2, 2] + s3 * A[k, 3, 2]
        t3 = s0 * A[k, 0, 3] + s1 * A[k, 1, 3] + s2 * A[k, 2, 3] + s3 * A[k, 3, 3]
        t4 = S[i, 4] + s0 * B[k, 0, 0] + s1 * B[k, 1, 0] + s2 * B[k, 2, 0] + s3 * B[k, 3, 0]
        t5 = S[i, 5] + s0 * B[k, 0, 1] + s1 * B[k, 1, 1] + s2 * B[k, 2, 1] + s3 * B[k, 3, 1]
        SA[i, 0], SA[i, 1], SA[i, 2], SA[i, 3], SA[i, 4], SA[i, 5] = t0, t1, t2, t3, t4, t5
    for i in range(2):
        b0, b1, b2, b3 = B[k, 0, i], B[k, 1, i], B[k, 2, i], B[k, 3, i]
        for j in range(6):
            R[k, i, j] = SA[4 + i, j] + b0 * SA[0, j] + b1 * SA[1, j] + b2 * SA[2, j] + b3 * SA[3, j]
        R[k, i, 4 + i] += e[i]


@merged
def decided(A: Array, k: int, SA: Array, R: Array, F: Array, S: Array) -> None:
    """Set S to M + R[k]ᵀ F[k], what the cost-to-go is once v is chosen by the feedback F[k] (2, …)."""
    for i in range(6):
        r0, r1 = R[k, 0, i], R[k, 1, i]
        if i < 4:
            a0, a1, a2, a3 = A[k, 0, i], A[k, 1, i], A[k, 2, i], A[k, 3, i]
            for j in range(i, 6):
                M = a0 * SA[0, j] + a1 * SA[1, j] + a2 * SA[2, j] + a3 * SA[3, j]
                S[i, j] = M + r0 * F[k, 0, j] + r1 * F[k, 1, j]
        else:
            for j in range(i, 6):
                S[i, j] = R[k, i - 4, j] + r0 * F[k, 0, j] + r1 * F[k, 1, j]
    for i in range(6):
        for j in range(i):  # rounding that is not symmetric would grow from sample to sample
            S[i, j] = S[j, i]


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
    """Go on with ξ[k] (6,), the lines of `xi` (N + 1, 6): set the state of ξ[k + 1], in which w is already known."""
    x0, x1, x2, x3, w0, w1 = xi[k, 0], xi[k, 1], xi[k, 2], xi[k, 3], xi[k + 1, 4], xi[k + 1, 5]
    for i in range(4):
        xi[k + 1, i] = (
            A[k, i, 0] * x0 + A[k, i, 1] * x1 + A[k, i, 2] * x2 + A[k, i, 3] * x3 + B[k, i, 0] * w0 + B[k, i, 1] * w1
        )


@merged
def charge_square(S: Array, slope: Array, k: int, m: int, w: float) -> None:
    """Add w c cᵀ to S (6, 6), c = (`slope`[k, m] (4,), 0)."""
    for i in range(4):
        c = w * slope[k, m, i]
        for j in range(4):
            S[i, j] += c * slope[k, m, j]


@merged
def charge_state(S: Array, slope: Array, k: int, cost: Cost) -> None:
    """Add to S (6, 6) what the square of the errors of a state costs."""
    for i in range(4):
        S[i, i] += cost.x[i]
    for m in range(3):
        if cost.y[m] != 0.0:
            charge_square(S, slope, k, m, cost.y[m])


@merged
def changed(slope: Array, k: int, m: int, xi: Array) -> float:
    """Return by how much ξ[k] changes the output m."""
    x0, x1, x2, x3 = xi[k, 0], xi[k, 1], xi[k, 2], xi[k, 3]
    return float(slope[k, m, 0] * x0 + slope[k, m, 1] * x1 + slope[k, m, 2] * x2 + slope[k, m, 3] * x3)
