"""Algebra of one sample for any number of muscles: `stage` in loops over the sizes.

A (N, MOVING, NXI) is the Jacobian of the next state by (q, ω), P and the command. With gas it has a line for all of
the state. Without it the pressures have none: they depend on their own commands only, and the share B (m,) of their
errors is left after a sample. D and its inverse are (N, m, m).
"""

import numpy as np

from allocator.calculus import Array, Mask
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Cost, Signs
from mpc.tracking.compiled.structured_qp.sizes import FREE, HIGH, MOVING, NU, NX, NXI, NY

ALONE = NX - MOVING  # pressures without a line in A


@inlined_flat
def across(S: Array, A: Array, B: Array, k: int, e: Array, SA: Array, R: Array) -> None:
    """Set SA = S 𝔸 and R[k] (m, NXI), the last lines of M = 𝔸ᵀ S 𝔸 + diag(0, e[k]), where e[k] (m,) is for w."""
    for i in range(NXI):
        for j in range(NXI):
            SA[i, j] = S[i, 0] * A[k, 0, j]
        for l in range(1, MOVING):  # noqa: E741
            s = S[i, l]
            for j in range(NXI):
                SA[i, j] += s * A[k, l, j]
        for j in range(ALONE):
            s = S[i, MOVING + j]
            SA[i, MOVING + j] += B[j] * s
            SA[i, NX + j] += (1.0 - B[j]) * s
        for j in range(NU):
            SA[i, NX + j] += S[i, NX + j]
    for i in range(NU):
        for j in range(NXI):
            R[k, i, j] = SA[NX + i, j]
    for i in range(ALONE):
        for j in range(NXI):
            R[k, i, j] += (1.0 - B[i]) * SA[MOVING + i, j]
    for i in range(NU):
        for l in range(MOVING):  # noqa: E741
            a = A[k, l, NX + i]
            for j in range(NXI):
                R[k, i, j] += a * SA[l, j]
        R[k, i, NX + i] += e[k, i]


@inlined_flat
def decided(A: Array, B: Array, k: int, SA: Array, R: Array, D: Array, F: Array, held: Signs, S: Array) -> None:
    """Set S to the cost-to-go after v is chosen by the feedback F[k] (m, …): M + R[k]ᵀ F[k], and the terms of held
    commands.
    """
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
            if held[k, c] == FREE or abs(held[k, c]) == HIGH:  # F is 0 for held changes, most of a long block's
                r = R[k, c, i]
                for j in range(NXI):
                    S[i, j] += r * F[k, c, j]
    for i in range(NU):
        if abs(held[k, i]) == HIGH:
            for j in range(NX + i, NXI):
                S[NX + i, j] -= R[k, i, j]
                for c in range(NU):
                    S[NX + i, j] -= D[k, i, c] * F[k, c, j]
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
    for j in range(ALONE):
        p = s[MOVING + j]
        s[MOVING + j] = B[j] * p + t[MOVING + j]
        s[NX + j] += (1.0 - B[j]) * p
    for j in range(NU):
        s[NX + j] += t[NX + j]


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
    for j in range(ALONE):
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
def times(D: Array, k: int, i: int, v: Array) -> float:
    """Return line `i` of D[k] times v[k]."""
    total = 0.0
    for j in range(NU):
        total += D[k, i, j] * v[k, j]
    return total


@inlined_flat
def curvature(D: Array, k: int, i: int) -> float:
    """Return the entry of D[k] for the change `i` alone."""
    return float(D[k, i, i])


@inlined_flat
def clear(z: Array, pushes: Array, c: int, k: int) -> None:
    """Set z[c, k] and pushes[c, k] to 0."""
    for i in range(NU):
        z[c, k, i], pushes[c, k, i] = 0.0, 0.0


@inlined
def answered(
    R: Array, D: Array, inverse: Array, base: Signs, k: int, c: int, gone: int, p: Array, z: Array, pushes: Array
) -> None:
    """Set z[c, k] to the response at ξ = 0 to the gradient pushes[c, k] by the changes, with 1 for the released change
    `gone` (-1: none), and carry `p` (NXI,) back over it.
    """
    for i in range(NU):
        z[c, k, i] = 1.0 if i == gone else 0.0
    for j in range(NU):
        g = pushes[c, k, j] + (D[k, j, gone] if gone >= 0 else 0.0)
        for i in range(NU):
            z[c, k, i] -= inverse[k, i, j] * g
    for i in range(NU):
        change = z[c, k, i]
        for j in range(NXI):
            p[j] += R[k, i, j] * change
    for i in range(NU):
        if abs(base[k, i]) == HIGH:
            p[NX + i] -= pushes[c, k, i]
            for j in range(NU):
                p[NX + i] -= D[k, i, j] * z[c, k, j]


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


@inlined_flat
def led_back(R: Array, D: Array, g: Array, feedback: Array, held: Signs, k: int, s: Array) -> None:
    """Carry `s` (NXI,) back over the changes of the feedback at ξ = 0."""
    for i in range(NU):
        f = feedback[k, i, NXI]
        for j in range(NXI):
            s[j] += R[k, i, j] * f
    for i in range(NU):
        if abs(held[k, i]) == HIGH:
            s[NX + i] -= g[k, i]
            for j in range(NU):
                s[NX + i] -= D[k, i, j] * feedback[k, j, NXI]


@inlined
def choose(
    R: Array, charge: Array, D: Array, g: Array, v: Array, held: Signs, k: int, inverse: Array, feedback: Array
) -> None:
    """Set D, its inverse and the feedback (m, NXI + 1) of stage `k`, D v + R ξ + g = 0 for the free inputs; held
    ones are v, or v - w if their command is held; charge[k] (m,) of the changes.
    """
    free, wanted = np.empty(NU, np.bool_), np.empty((NU, NXI + 1))
    for i in range(NU):
        free[i] = held[k, i] == FREE
        for j in range(NU):
            D[k, i, j] = R[k, i, NX + j]
            inverse[k, i, j] = D[k, i, j]
        D[k, i, i] += charge[k, i]
        inverse[k, i, i] = D[k, i, i]
        for j in range(NXI):
            wanted[i, j] = R[k, i, j]
        wanted[i, NXI] = g[k, i]
    for c in range(NU):
        if not free[c]:
            for i in range(NU):
                wanted[i, NXI] += D[k, i, c] * v[k, c]
                if abs(held[k, c]) == HIGH:
                    wanted[i, NX + c] -= D[k, i, c]
    turn_inside_out(inverse, k, free, charge)
    for i in range(NU):
        for j in range(NXI + 1):
            feedback[k, i, j] = 0.0
        if not free[i]:
            feedback[k, i, NXI] = v[k, i]
            if abs(held[k, i]) == HIGH:
                feedback[k, i, NX + i] = -1.0
        else:
            for c in range(NU):
                share = inverse[k, i, c]
                for j in range(NXI + 1):
                    feedback[k, i, j] -= share * wanted[c, j]


@inlined_flat
def turn_inside_out(inverse: Array, k: int, free: Mask, charges: Array) -> None:
    """Turn inverse[k] (m, m) into the inverse of its `free` part, 0 elsewhere: the greatest pivot first, none less than
    its own charge (J. H. Goodnight's sweep, The American Statistician 33, 1979).
    """
    left = 0
    for i in range(NU):
        if free[i]:
            left |= 1 << i
    while left:
        p = -1
        for i in range(NU):
            if left >> i & 1 and (p < 0 or inverse[k, i, i] > inverse[k, p, p]):
                p = i
        left &= ~(1 << p)
        share = 1.0 / max(inverse[k, p, p], charges[k, p])
        for i in range(NU):
            if free[i] and i != p:
                factor = inverse[k, i, p] * share
                for j in range(NU):
                    if j != p:
                        inverse[k, i, j] -= factor * inverse[k, p, j]
                inverse[k, i, p] = factor
        for j in range(NU):
            inverse[k, p, j] *= share
        inverse[k, p, p] = -share
    for i in range(NU):
        for j in range(NU):
            inverse[k, i, j] = -inverse[k, i, j] if free[i] and free[j] else 0.0
