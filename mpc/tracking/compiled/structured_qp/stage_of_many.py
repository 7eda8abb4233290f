"""Algebra of one sample for any number of muscles: `stage` in loops over the sizes.

A pressure depends only on its own command, and approaches it by the share B (m,) of the error in every sample; A
(N, 2n, NXI) is the Jacobian of the next (q, ω) by (q, ω), P and the command. D and its inverse are (N, m, m).
"""

import numpy as np

from allocator.calculus import Array, Mask
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Cost, Signs
from mpc.tracking.compiled.structured_qp.sizes import FREE, JOINTS, NU, NX, NXI, NY

MOVING = 2 * JOINTS  # entries (q, ω)


@inlined_flat
def across(S: Array, A: Array, B: Array, k: int, e: Array, SA: Array, R: Array) -> None:
    """Set SA = S 𝔸 and R[k] (m, NXI), the last lines of M = 𝔸ᵀ S 𝔸 + diag(0, `e`), where `e` (m,) is for w."""
    for i in range(NXI):
        for j in range(NXI):
            SA[i, j] = S[i, 0] * A[k, 0, j]
        for l in range(1, MOVING):  # noqa: E741
            s = S[i, l]
            for j in range(NXI):
                SA[i, j] += s * A[k, l, j]
        for j in range(NU):
            s = S[i, MOVING + j]
            SA[i, MOVING + j] += B[j] * s
            SA[i, NX + j] += (1.0 - B[j]) * s + S[i, NX + j]
    for i in range(NU):
        for j in range(NXI):
            R[k, i, j] = SA[NX + i, j] + (1.0 - B[i]) * SA[MOVING + i, j]
        for l in range(MOVING):  # noqa: E741
            a = A[k, l, NX + i]
            for j in range(NXI):
                R[k, i, j] += a * SA[l, j]
        R[k, i, NX + i] += e[i]


@inlined_flat
def decided(A: Array, B: Array, k: int, SA: Array, R: Array, F: Array, S: Array) -> None:
    """Set S to M + R[k]ᵀ F[k], the cost-to-go after v is chosen by the feedback F[k] (m, …)."""
    for i in range(NXI):
        if i < NX:
            share, line = (0.0, 0) if i < MOVING else (B[i - MOVING], i)
            for j in range(NXI):
                S[i, j] = share * SA[line, j]
            for l in range(MOVING):  # noqa: E741
                a = A[k, l, i]
                for j in range(NXI):
                    S[i, j] += a * SA[l, j]
        else:
            for j in range(NXI):
                S[i, j] = R[k, i - NX, j]
        for c in range(NU):
            r = R[k, c, i]
            for j in range(NXI):
                S[i, j] += r * F[k, c, j]
    for i in range(NXI):
        for j in range(i):  # asymmetric rounding would grow from sample to sample
            S[i, j] = S[j, i]


@inlined
def linear_before(s: Array, A: Array, B: Array, k: int) -> None:
    """Turn s (NXI,) into 𝔸ᵀ s."""
    t = np.zeros(NXI)
    for l in range(MOVING):  # noqa: E741
        factor = s[l]
        for j in range(NXI):
            t[j] += factor * A[k, l, j]
    for i in range(MOVING):
        s[i] = t[i]
    for j in range(NU):
        p = s[MOVING + j]
        s[MOVING + j] = B[j] * p + t[MOVING + j]
        s[NX + j] += (1.0 - B[j]) * p + t[NX + j]


@inlined_flat
def advance(A: Array, B: Array, k: int, xi: Array) -> None:
    """Set the state of ξ[k + 1] from ξ[k] (NXI,), lines of `xi` (N + 1, NXI); w of ξ[k + 1] is already known."""
    for i in range(MOVING):
        x = 0.0
        for j in range(NX):
            x += A[k, i, j] * xi[k, j]
        for j in range(NX, NXI):
            x += A[k, i, j] * xi[k + 1, j]
        xi[k + 1, i] = x
    for j in range(NU):
        xi[k + 1, MOVING + j] = B[j] * xi[k, MOVING + j] + (1.0 - B[j]) * xi[k + 1, NX + j]


@inlined_flat
def charge_square(S: Array, slope: Array, k: int, m: int, w: float) -> None:
    """Add w c cᵀ to S, c = (`slope`[k, m] (NX,), 0)."""
    for i in range(NX):
        c = w * slope[k, m, i]
        for j in range(NX):
            S[i, j] += c * slope[k, m, j]


@inlined_flat
def charge_state(S: Array, slope: Array, k: int, cost: Cost) -> None:
    """Add the cost of a state's squared errors to S."""
    for i in range(NX):
        S[i, i] += cost.x[i]
    for m in range(NY):
        if cost.y[m] != 0.0:
            charge_square(S, slope, k, m, cost.y[m])


@inlined_flat
def changed(slope: Array, k: int, m: int, xi: Array) -> float:
    """Return the change of the output m due to ξ[k]."""
    change = 0.0
    for i in range(NX):
        change += slope[k, m, i] * xi[k, i]
    return change


@inlined_flat
def first_of(limits: Array, i: int) -> float:
    """Return the limit of the joint `i`."""
    return float(limits[i])


@inlined
def new_squares(N: int) -> Array:
    """Return N uninitialised symmetric matrices of commands."""
    return np.empty((N, NU, NU))


@inlined_flat
def entry(D: Array, k: int, i: int, j: int) -> float:
    """Return an entry of D[k]."""
    return float(D[k, i, j])


@inlined_flat
def times(D: Array, k: int, i: int, v: Array) -> float:
    """Return line `i` of D[k] times v[k]."""
    total = 0.0
    for j in range(NU):
        total += D[k, i, j] * v[k, j]
    return total


@inlined_flat
def along(border: Array, k: int, j: int, v: Array) -> float:
    """Return column `j` of `border`[k] times v[k]."""
    total = 0.0
    for i in range(NU):
        total += border[k, i, j] * v[k, i]
    return total


@inlined
def turned(inverse: Array, k: int, z: Array, c: int) -> None:
    """Turn z[c, k] into -D⁻¹ z[c, k]."""
    answer = np.zeros(NU)
    for i in range(NU):
        for j in range(NU):
            answer[i] -= inverse[k, i, j] * z[c, k, j]
    for i in range(NU):
        z[c, k, i] = answer[i]


@inlined_flat
def clear(z: Array, pushes: Array, c: int, k: int) -> None:
    """Set z[c, k] and pushes[c, k] to 0."""
    for i in range(NU):
        z[c, k, i], pushes[c, k, i] = 0.0, 0.0


@inlined_flat
def gone_back(inverse: Array, R: Array, k: int, c: int, p: Array, z: Array, pushes: Array) -> None:
    """Set pushes[c, k] to the gradient by the changes, z[c, k] to the response, and add its effect to `p` (NXI,)."""
    for i in range(NU):
        pushes[c, k, i] = p[NX + i]
    for i in range(NU):
        change = 0.0
        for j in range(NU):
            change -= inverse[k, i, j] * pushes[c, k, j]
        z[c, k, i] = change
        for j in range(NXI):
            p[j] += R[k, i, j] * change


@inlined_flat
def gone_along(
    R: Array, D: Array, feedback: Array, base: Signs, k: int, c: int, xi: Array, z: Array, pushes: Array
) -> None:
    """Add to the changes z[c, k] the feedback of ξ[k], set pushes[c, k] to the gradient then, and w of ξ[k + 1]."""
    for i in range(NU):
        change = z[c, k, i]
        for j in range(NXI):
            change += feedback[k, i, j] * xi[k, j]
        z[c, k, i] = change
        xi[k + 1, NX + i] = xi[k, NX + i] + change
    for i in range(NU):
        push = pushes[c, k, i]
        if base[k, i] != FREE:
            for j in range(NXI):
                push += R[k, i, j] * xi[k, j]
            for j in range(NU):
                push += D[k, i, j] * z[c, k, j]
        pushes[c, k, i] = 0.0 if base[k, i] == FREE else push


@inlined
def answered(inverse: Array, feedback: Array, k: int, v: Array, p: Array) -> None:
    """Turn v[k], a gradient, into -D⁻¹ v[k], and add the effect of that to `p` (NXI,)."""
    answer = np.zeros(NU)
    for i in range(NU):
        g = v[k, i]
        for j in range(NXI):
            p[j] += feedback[k, i, j] * g
        for j in range(NU):
            answer[j] -= inverse[k, i, j] * g
    for i in range(NU):
        v[k, i] = answer[i]


@inlined_flat
def led_back(R: Array, feedback: Array, k: int, s: Array) -> None:
    """Add to `s` (NXI,) the effect of the feedback's changes at ξ = 0."""
    for i in range(NU):
        f = feedback[k, i, NXI]
        for j in range(NXI):
            s[j] += R[k, i, j] * f


@inlined_flat
def fed_back(inverse: Array, R: Array, k: int, feedback: Array) -> None:
    """Set the feedback[k] to -D⁻¹ R[k]."""
    for i in range(NU):
        for j in range(NXI):
            feedback[k, i, j] = 0.0
        for c in range(NU):
            share = inverse[k, i, c]
            for j in range(NXI):
                feedback[k, i, j] -= share * R[k, c, j]


@inlined
def choose(
    R: Array, charge: Array, D: Array, g: Array, v: Array, held: Signs, k: int, inverse: Array, feedback: Array
) -> None:
    """Set D, its inverse and the feedback (m, NXI + 1) of stage `k`, D v + R ξ + g = 0 for the free inputs, v for those
    held; `charge` (m,) is the cost of the changes.
    """
    free, wanted = np.empty(NU, np.bool_), np.empty((NU, NXI + 1))
    for i in range(NU):
        free[i] = held[k, i] == FREE
        for j in range(NU):
            D[k, i, j] = R[k, i, NX + j]
            inverse[k, i, j] = D[k, i, j]
        D[k, i, i] += charge[i]
        inverse[k, i, i] = D[k, i, i]
        for j in range(NXI):
            wanted[i, j] = R[k, i, j]
        wanted[i, NXI] = g[k, i]
    for c in range(NU):
        if not free[c]:
            for i in range(NU):
                wanted[i, NXI] += D[k, i, c] * v[k, c]
    turn_inside_out(inverse, k, free, charge)
    for i in range(NU):
        for j in range(NXI + 1):
            feedback[k, i, j] = 0.0
        if not free[i]:
            feedback[k, i, NXI] = v[k, i]
        else:
            for c in range(NU):
                share = inverse[k, i, c]
                for j in range(NXI + 1):
                    feedback[k, i, j] -= share * wanted[c, j]


@inlined
def invert(R: Array, k: int, charge: Array, W: Array, allowed: bool, inverse: Array) -> None:
    """Set `inverse`[k] of D, with W of the changes' rows. Without a change the inverse is 0."""
    free, least = np.empty(NU, np.bool_), np.empty(NU)
    for i in range(NU):
        free[i], least[i] = allowed, charge[i] + W[k, i] + W[k, NU + i]
        for j in range(NU):
            inverse[k, i, j] = R[k, i, NX + j]
        inverse[k, i, i] += least[i]
    turn_inside_out(inverse, k, free, least)


@inlined_flat
def turn_inside_out(a: Array, k: int, free: Mask, least: Array) -> None:
    """Turn a[k] (m, m) into the inverse of its `free` part, 0 elsewhere: the greatest pivot first, none less than its
    own charge (J. H. Goodnight's sweep, The American Statistician 33, 1979).
    """
    left = 0
    for i in range(NU):
        if free[i]:
            left |= 1 << i
    while left:
        p = -1
        for i in range(NU):
            if left >> i & 1 and (p < 0 or a[k, i, i] > a[k, p, p]):
                p = i
        left &= ~(1 << p)
        share = 1.0 / max(a[k, p, p], least[p])
        for i in range(NU):
            if free[i] and i != p:
                factor = a[k, i, p] * share
                for j in range(NU):
                    if j != p:
                        a[k, i, j] -= factor * a[k, p, j]
                a[k, i, p] = factor
        for j in range(NU):
            a[k, p, j] *= share
        a[k, p, p] = -share
    for i in range(NU):
        for j in range(NU):
            a[k, i, j] = -a[k, i, j] if free[i] and free[j] else 0.0


@inlined
def border_before(P: Array, A: Array, B: Array, k: int) -> None:
    """Turn P (NXI, 2) into 𝔸ᵀ P."""
    s = np.empty(NXI)
    for j in range(2):
        for i in range(NXI):
            s[i] = P[i, j]
        linear_before(s, A, B, k)
        for i in range(NXI):
            P[i, j] = s[i]


@inlined_flat
def decided_border(P: Array, G: Array, k: int, inverse: Array, R: Array, border: Array, sigma: Array) -> None:
    """Set the border of stage `k`, and P and Σ to their values after v is chosen."""
    for j in range(2):
        for i in range(NU):
            G[i, j] = P[NX + i, j]
            border[k, i, j] = 0.0
        for i in range(NU):
            for c in range(NU):
                border[k, i, j] -= inverse[k, i, c] * P[NX + c, j]
    for j in range(2):
        for c in range(NU):
            for i in range(NXI):
                P[i, j] += R[k, c, i] * border[k, c, j]
    for c in range(NU):
        sigma[0] += G[c, 0] * border[k, c, 0]
        sigma[1] += G[c, 0] * border[k, c, 1]
        sigma[2] += G[c, 1] * border[k, c, 1]
