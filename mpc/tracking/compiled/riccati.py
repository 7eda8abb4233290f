"""The QP of a step without its rows is solved by Riccati recursions: O(N) instead of O(N³), in one compiled call.

The same problem as `mpc.tracking.qp.condense` states, with the state ξ_k = (δx_k, w_k), w_k the deviation of u_{k-1}
from ū_{k-1}, and the change v_k of that deviation as input: w_{k+1} = w_k + v_k, δx_{k+1} = A_k δx_k + B_k w_{k+1}.
What every stage costs from v_k on is ½ ρ|v|² + ρ Δeᵀv + W_k(δx, w + v), W_k the cost-to-go after the command; hence
with D = W_ww + ρ I

    D v + W_wx δx + W_ww w + g = -λ,        λ = 0 for what is free, v at its bound for what is not

An active-set method of the primal–dual kind: sweep backward and forward with the bounds held that are guessed to bind,
then guess anew: what breaks a bound is held, what is held with λ of the wrong sign is let go. A guess that repeats
itself is the solution; that takes a sweep or two from the last sample's set, and sometimes does not come about. It is
the caller's business to prove the answer, and to have a solver that finds a better set to begin from.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.commands import advance
from mpc.tracking.compiled.jit import inlined
from mpc.tracking.compiled.records import Cost, Errors, Path

FREE, LOWER, UPPER = 0, -1, 1


@inlined
def settled(
    path: Path, errors: Errors, cost: Cost, starts: Any, lower: Array, upper: Array, guess: Any, sweeps: int, z: Array
) -> bool:
    """Return whether a guess repeated itself within so many sweeps; then `z` (n,) is the solution, within its bounds.

    `guess` (n,) becomes the set found. Between the `starts` nothing may change: all is held there, at 0.
    """
    N = path.A.shape[0]
    low, high, v, held = np.zeros((N, 2)), np.zeros((N, 2)), np.empty((N, 2)), np.full((N, 2), LOWER, np.int8)
    for block in range(starts.size):
        for i in range(2):
            at, k = 2 * block + i, starts[block]
            low[k, i], high[k, i], held[k, i] = lower[at], upper[at], guess[at]
    rows, D, g, feedback = np.empty((N, 2, 6)), np.empty((N, 2, 2)), np.empty((N, 2)), np.empty((N, 2, 7))
    for _ in range(sweeps):
        for k in range(N):
            for i in range(2):
                v[k, i] = low[k, i] if held[k, i] == LOWER else high[k, i]  # of those held
        backward(path, errors, cost, v, held, rows, D, g, feedback)
        if not forward(path, v, low, high, held, rows, D, g, feedback):
            for block in range(starts.size):
                for i in range(2):
                    at = 2 * block + i
                    guess[at] = held[starts[block], i]
                    z[at] = min(max(v[starts[block], i], lower[at]), upper[at])
            return True
    return False


@inlined
def moved(path: Path, errors: Errors, starts: Any, z: Array) -> Errors:
    """Return the errors that the linear model has under the decisions `z`."""
    N, block = path.A.shape[0], 0
    x, y, end = errors.x.copy(), errors.y.copy(), errors.end.copy()
    e, change = errors.e.copy(), errors.change.copy()
    dx, after, du = np.zeros(4), np.empty(4), np.zeros(2)
    for k in range(N):
        if block < starts.size and starts[block] == k:
            for i in range(2):
                du[i] += z[2 * block + i]
                change[k, i] += z[2 * block + i]
            block += 1
        advance(path.A[k], path.B[k], dx, du, after)
        for i in range(4):
            x[k + 1, i] += dx[i]
            for m in range(3):
                y[k + 1, m] += path.slope[k + 1, m, i] * dx[i]
        e[k, 0] += du[0]
        e[k, 1] += du[1]
    for i in range(4):
        end[i] += dx[i]
    end[4] += du[0]
    end[5] += du[1]
    return Errors(x, y, e, change, end)


@inlined
def backward(
    path: Path, errors: Errors, cost: Cost, v: Array, held: Any, rows: Array, D: Array, g: Array, feedback: Array
) -> None:
    """Fill in, for each k, `rows` = [W_wx W_ww], D, g, and the feedback v = feedback (ξ, 1) of the optimal changes."""
    S, s, M, m = cost.end.copy(), np.zeros(6), np.empty((6, 6)), np.empty(6)  # of V_{k+1}, of W_k
    for i in range(6):
        for j in range(6):
            s[i] += cost.end[i, j] * errors.end[j]
    for k in range(v.shape[0] - 1, -1, -1):
        after_command(S, s, path.A[k], path.B[k], M, m)
        for i in range(2):
            m[4 + i] += cost.e[i] * errors.e[k, i]
            M[4 + i, 4 + i] += cost.e[i]
        for i in range(2):
            for j in range(6):
                rows[k, i, j] = M[4 + i, j]
            for j in range(2):
                D[k, i, j] = M[4 + i, 4 + j]
            D[k, i, i] += cost.change[i]
            g[k, i] = m[4 + i] + cost.change[i] * errors.change[k, i]
        choose(rows[k], D[k], g[k], v[k], held[k], feedback[k])
        for i in range(6):
            for j in range(i, 6):  # rounding that is not symmetric would grow from sample to sample
                S[i, j] = M[i, j] + rows[k, 0, i] * feedback[k, 0, j] + rows[k, 1, i] * feedback[k, 1, j]
                S[j, i] = S[i, j]
            s[i] = m[i] + rows[k, 0, i] * feedback[k, 0, 6] + rows[k, 1, i] * feedback[k, 1, 6]
        if k > 0:
            charge_state(S, s, path.slope[k], cost, errors.x[k], errors.y[k])


@inlined
def after_command(S: Array, s: Array, A: Array, B: Array, M: Array, m: Array) -> None:
    """Set M = [A B; 0 I]ᵀ S [A B; 0 I] and m = [A B; 0 I]ᵀ s."""
    SA = np.empty((6, 6))
    for i in range(6):
        for j in range(4):
            SA[i, j] = S[i, 0] * A[0, j] + S[i, 1] * A[1, j] + S[i, 2] * A[2, j] + S[i, 3] * A[3, j]
        for j in range(2):
            SA[i, 4 + j] = S[i, 4 + j]
            for n in range(4):
                SA[i, 4 + j] += S[i, n] * B[n, j]
    for j in range(6):
        for i in range(4):
            M[i, j] = A[0, i] * SA[0, j] + A[1, i] * SA[1, j] + A[2, i] * SA[2, j] + A[3, i] * SA[3, j]
        for i in range(2):
            M[4 + i, j] = SA[4 + i, j]
            for n in range(4):
                M[4 + i, j] += B[n, i] * SA[n, j]
    for i in range(4):
        m[i] = A[0, i] * s[0] + A[1, i] * s[1] + A[2, i] * s[2] + A[3, i] * s[3]
    for i in range(2):
        m[4 + i] = s[4 + i] + B[0, i] * s[0] + B[1, i] * s[1] + B[2, i] * s[2] + B[3, i] * s[3]


@inlined
def charge_state(S: Array, s: Array, slope: Array, cost: Cost, x: Array, y: Array) -> None:
    """Add what the errors `x` (4,) and `y` (3,) of a state cost."""
    for i in range(4):
        S[i, i] += cost.x[i]
        s[i] += cost.x[i] * x[i]
    for m in range(3):
        w = cost.y[m]
        if w == 0.0:
            continue
        for i in range(4):
            for j in range(4):
                S[i, j] += w * slope[m, i] * slope[m, j]
            s[i] += w * y[m] * slope[m, i]


@inlined
def choose(rows: Array, D: Array, g: Array, v: Array, held: Any, feedback: Array) -> None:
    """Set the feedback (2, 7) of one stage, D v + rows ξ + g = 0 for the free inputs, v for those held."""
    free0, free1 = held[0] == FREE, held[1] == FREE
    if free0 and free1:
        det = D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0]
        for j in range(7):
            a = rows[0, j] if j < 6 else g[0]
            b = rows[1, j] if j < 6 else g[1]
            feedback[0, j] = (D[0, 1] * b - D[1, 1] * a) / det
            feedback[1, j] = (D[1, 0] * a - D[0, 0] * b) / det
        return
    for i in range(2):
        for j in range(7):
            feedback[i, j] = 0.0
    for i in range(2):
        other = 1 - i
        if held[i] != FREE:
            feedback[i, 6] = v[i]
        elif held[other] != FREE:
            for j in range(6):
                feedback[i, j] = -rows[i, j] / D[i, i]
            feedback[i, 6] = -(g[i] + D[i, other] * v[other]) / D[i, i]


@inlined
def forward(
    path: Path, v: Array, lower: Array, upper: Array, held: Any, rows: Array, D: Array, g: Array, feedback: Array
) -> bool:
    """Set `v` (N, 2) by the feedback and guess `held` anew; return whether the guess has changed."""
    xi, after = np.zeros(6), np.zeros(4)
    changed = False
    for k in range(v.shape[0]):
        for i in range(2):
            v[k, i] = feedback[k, i, 6]
            for j in range(6):
                v[k, i] += feedback[k, i, j] * xi[j]
        for i in range(2):
            if held[k, i] == FREE:
                guess = LOWER if v[k, i] < lower[k, i] else UPPER if v[k, i] > upper[k, i] else FREE
            else:
                push = g[k, i] + D[k, i, 0] * v[k, 0] + D[k, i, 1] * v[k, 1]  # -λ
                for j in range(6):
                    push += rows[k, i, j] * xi[j]
                wrong = lower[k, i] < upper[k, i] and (push < 0.0 if held[k, i] == LOWER else push > 0.0)
                guess = FREE if wrong else held[k, i]
            changed |= guess != held[k, i]
            held[k, i] = guess
        xi[4] += v[k, 0]
        xi[5] += v[k, 1]
        advance(path.A[k], path.B[k], xi[:4], xi[4:], after)
    return changed


__all__ = ["FREE", "LOWER", "UPPER", "moved", "settled"]
