"""The template has the step of an arm: linearisation, condensing, and the rollout of an answer.

`mpc.tracking.compiled.arm.module` puts the sizes and formulas of the arm in the place of the lines below that begin
with `FORMULAS`: n joints, m muscles, the numbers of entries of svec K and of states, and functions that
fill flat arrays, matrices by columns:

    dynamics         (q, ω, P, d) ↦ M, τ - C - Dω - g + d
    dynamics_slopes  (q, ω, P, ω') ↦ the Jacobian of the latter less M ω', by q, ω and P
    output_slopes    (q, P) ↦ y = (svec K, F), its Jacobian by q and P

The array c holds the numbers of all of them. Pressures are in Pa, decisions z in bar, as in `mpc.tracking.qp.condense`.
The motion is that of `mpc.model.arm.model`; ∂ω' = M⁻¹ ∂(τ - C - Dω - g + d - M ω') at fixed ω' differentiates it.
A path is a motion and its derivatives: x (N+1, 2n + m), S (N, 2n, 2n + 2m) the Jacobian of the next (q, ω) by (q, ω),
P and u, y (N+1, p) and slope (N+1, n + m, p) of y by (q, P). The pressures follow commands as they do on every path.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.model.integration import NODES, SHARES
from mpc.tracking.compiled.structured_qp.certificate import finite

FORMULAS: Any = None
n = m = STIFFNESSES = SIZE = dynamics = dynamics_slopes = output_slopes = FORMULAS

PLACES = 0, 1, 1, 2  # of the stages in `decay`
SOLVED, ROWS, REFUSED = 0, 1, 2


@compiled
def linearise(
    c: Array, h: float, decay: Array, bounds: Array, u_last: Array, x0: Array, asked: Array, d: Array,
    u: Array, x: Array, S: Array, y: Array, slope: Array,
) -> None:  # fmt: skip
    """Fill in the commands `asked` (N, m) [Pa], moved to within the limits, as `u`, and the path of them.

    `decay` (substeps, 3, m) is what is left of a pressure's error at beginning, middle and end of each step `h` [s];
    `bounds` (3,) the supply and the greatest change [Pa].
    """
    limit(bounds, u_last, asked, u)
    for i in range(SIZE):
        x[0, i] = x0[i]
    for k in range(u.shape[0]):
        advance(c, h, decay, x[k], u[k], d[k], x[k + 1], S[k])
    for k in range(x.shape[0]):
        output_slopes(x[k, :n], x[k, 2 * n :], c, y[k], slope[k].reshape(-1))


@inlined
def limit(bounds: Array, u_last: Array, asked: Array, u: Array) -> None:
    """Fill in commands `u` (N, m), each the nearest to `asked` that slew and supply allow after the one before."""
    low, high, step = bounds[0], bounds[1], bounds[2]
    for j in range(m):
        last = u_last[j]
        for k in range(u.shape[0]):
            last = min(max(min(max(asked[k, j], low), high), last - step), last + step)
            u[k, j] = last


@inlined
def advance(c: Array, h: float, decay: Array, x: Array, u: Array, d: Array, after: Array, S: Array) -> None:
    """Fill in the state a sample later and the Jacobian `S` (2n, 2n + 2m) of its (q, ω)."""
    columns = 2 * n + 2 * m
    s, K, total, P = np.empty(2 * n), np.zeros(2 * n), np.empty(2 * n), np.empty(m)
    SK, St = np.zeros((2 * n, columns)), np.empty((2 * n, columns))
    here, now = np.empty((2 * n, columns)), np.empty(2 * n)
    M, a, R = np.empty(n * n), np.empty(n), np.empty((SIZE, n))
    for i in range(2 * n):
        s[i] = x[i]
        for j in range(columns):
            S[i, j] = 1.0 if i == j else 0.0
    for step in range(decay.shape[0]):
        total[:], St[:] = 0.0, 0.0
        for stage in range(4):
            reach, share, left = h * NODES[stage], h * SHARES[stage], decay[step, PLACES[stage]]
            for i in range(2 * n):
                now[i] = s[i] + reach * K[i] if stage else s[i]
                for j in range(columns):
                    here[i, j] = S[i, j] + reach * SK[i, j] if stage else S[i, j]
            for j in range(m):
                P[j] = u[j] + left[j] * (x[2 * n + j] - u[j])
            accelerate(c, now, P, d, M, a)
            dynamics_slopes(now[:n], now[n:], P, a, c, R.reshape(-1))
            for j in range(SIZE):
                solve(M, R[j])
            for i in range(n):
                K[i], K[n + i] = now[n + i], a[i]
                for j in range(columns):
                    SK[i, j], SK[n + i, j] = here[n + i, j], 0.0
                for l in range(2 * n):  # noqa: E741
                    factor = R[l, i]
                    for j in range(columns):
                        SK[n + i, j] += factor * here[l, j]
                for j in range(m):
                    SK[n + i, 2 * n + j] += R[2 * n + j, i] * left[j]
                    SK[n + i, 2 * n + m + j] += R[2 * n + j, i] * (1 - left[j])
            for i in range(2 * n):
                total[i] += share * K[i]
                for j in range(columns):
                    St[i, j] += share * SK[i, j]
        for i in range(2 * n):
            s[i] += total[i]
            for j in range(columns):
                S[i, j] += St[i, j]
    settle(decay, x, u, s, after)


@inlined
def settle(decay: Array, x: Array, u: Array, s: Array, after: Array) -> None:
    """Fill in the state a sample later: (q, ω) = `s`, and the pressures."""
    for i in range(2 * n):
        after[i] = s[i]
    for j in range(m):
        after[2 * n + j] = u[j] + decay[decay.shape[0] - 1, 2, j] * (x[2 * n + j] - u[j])


@inlined
def accelerate(c: Array, s: Array, P: Array, d: Array, M: Array, a: Array) -> None:
    """Fill in the acceleration `a` (n,) and the Cholesky factor of the mass matrix, flat in `M`."""
    dynamics(s[:n], s[n:], P, d, c, M, a)
    for j in range(n):
        for i in range(j, n):
            value = M[j * n + i]
            for l in range(j):  # noqa: E741
                value -= M[l * n + i] * M[l * n + j]
            M[j * n + i] = np.sqrt(value) if i == j else value / M[j * n + j]
    solve(M, a)


@inlined
def solve(M: Array, v: Array) -> None:
    """Put M⁻¹ v in the place of v (n,), by the factor in `M`."""
    for i in range(n):
        for l in range(i):  # noqa: E741
            v[i] -= M[l * n + i] * v[l]
        v[i] /= M[i * n + i]
    for i in range(n - 1, -1, -1):
        for l in range(i + 1, n):  # noqa: E741
            v[i] -= M[i * n + l] * v[l]
        v[i] /= M[i * n + i]


@inlined
def roll(c: Array, h: float, decay: Array, x0: Array, u: Array, d: Array, x: Array, y: Array) -> None:
    """Fill in the motion from `x0` under `u` without derivatives."""
    s, K, total, now = np.empty(2 * n), np.empty(2 * n), np.empty(2 * n), np.empty(2 * n)
    P, M, a = np.empty(m), np.empty(n * n), np.empty(n)
    for i in range(SIZE):
        x[0, i] = x0[i]
    for k in range(u.shape[0]):
        for i in range(2 * n):
            s[i] = x[k, i]
        for step in range(decay.shape[0]):
            for i in range(2 * n):
                total[i], K[i] = 0.0, 0.0
            for stage in range(4):
                reach, share, left = h * NODES[stage], h * SHARES[stage], decay[step, PLACES[stage]]
                for i in range(2 * n):
                    now[i] = s[i] + reach * K[i]
                for j in range(m):
                    P[j] = u[k, j] + left[j] * (x[k, 2 * n + j] - u[k, j])
                accelerate(c, now, P, d[k], M, a)
                for i in range(n):
                    K[i], K[n + i] = now[n + i], a[i]
                for i in range(2 * n):
                    total[i] += share * K[i]
            for i in range(2 * n):
                s[i] += total[i]
        settle(decay, x[k], u[k], s, x[k + 1])
    slope = np.empty((n + m) * y.shape[1])  # not needed, but a second formula would have to be compiled
    for k in range(x.shape[0]):
        output_slopes(x[k, :n], x[k, 2 * n :], c, y[k], slope)


@compiled
def condense(
    weights: Array, L: Array, starts: Any, risen: Array, constant: Array, dt: float, bounds: Array,
    x: Array, S: Array, y: Array, slope: Array, u: Array,
    x_ref: Array, y_ref: Array, u_ref: Array, u_last: Array, e_last: Array,
    G: Array, H: Array, f: Array, lower: Array, upper: Array,
) -> None:  # fmt: skip
    """Fill in G (N+1, 2n, z) = ∂(q, ω)/∂z and the QP without rows and slacks.

    `weights` (2n + stiffnesses + 2m,) are those of angles, velocities, stiffnesses, commands and their rates; `risen`
    (N+1, blocks, m) [Pa/bar] how far pressures have followed the change of a block, `constant` (z, z) what of H the
    commands are charged, `L` the terminal factor.
    """
    N, size = u.shape[0], f.size
    rows = 2 * n + STIFFNESSES
    J, r, root = np.empty((rows, size)), np.empty(rows), np.sqrt(weights)
    H[:] = constant
    of_commands(weights, starts, dt, bounds, u, u_ref, u_last, e_last, f, lower, upper)
    acting = 0
    G[0] = 0.0
    for k in range(N):
        if acting < starts.size and starts[acting] == k:
            acting += 1
        move(S[k], risen[k], acting, G[k], G[k + 1])
        if k == N - 1:
            break
        for i in range(n):
            r[i], r[n + i] = (
                root[i] * (x[k + 1, i] - x_ref[k + 1, i]),
                root[n + i] * (x[k + 1, n + i] - x_ref[k + 1, n + i]),
            )
            for z in range(acting * m):
                J[i, z], J[n + i, z] = root[i] * G[k + 1, i, z], root[n + i] * G[k + 1, n + i, z]
        for i in range(STIFFNESSES):
            r[2 * n + i] = root[2 * n + i] * (y[k + 1, i] - y_ref[k + 1, i])
            read(slope[k + 1], i, root[2 * n + i], risen[k + 1], acting, G[k + 1], J[2 * n + i])
        charge(J, r, acting * m, H, f)
    end(L, risen[N], G[N], x[N], x_ref[N], u[N - 1], u_ref[N - 1], H, f)
    for i in range(size):
        for j in range(i):
            H[j, i] = H[i, j]


@inlined
def of_commands(
    weights: Array, starts: Any, dt: float, bounds: Array, u: Array, u_ref: Array, u_last: Array, e_last: Array,
    f: Array, lower: Array, upper: Array,
) -> None:  # fmt: skip
    """Fill in the gradient of what commands and their rate are charged, and how far changes may go."""
    N, step, first_command = u.shape[0], bounds[2] / BAR, 2 * n + STIFFNESSES
    for b in range(starts.size):
        first = starts[b]
        for j in range(m):
            pushed = 0.0
            for k in range(first, N):
                pushed += u[k, j] - u_ref[k, j]
            before = e_last[j] if first == 0 else u[first - 1, j] - u_ref[first - 1, j]
            turned = u[first, j] - u_ref[first, j] - before
            command, rate = weights[first_command + j], weights[first_command + m + j]
            f[b * m + j] = BAR * (command * pushed + rate * turned / dt**2)
            change = (u[first, j] - (u_last[j] if first == 0 else u[first - 1, j])) / BAR
            lower[b * m + j], upper[b * m + j] = min(-step - change, 0.0), max(step - change, 0.0)


@inlined
def move(S: Array, risen: Array, acting: int, G: Array, after: Array) -> None:
    """Fill in the next G from this one, of the blocks that are `acting` so far."""
    for i in range(2 * n):
        for z in range(after.shape[1]):
            after[i, z] = 0.0
        for l in range(2 * n):  # noqa: E741
            factor = S[i, l]
            for z in range(acting * m):
                after[i, z] += factor * G[l, z]
        for b in range(acting):
            for j in range(m):
                after[i, b * m + j] += S[i, 2 * n + j] * risen[b, j] + S[i, 2 * n + m + j] * BAR


@inlined
def read(slope: Array, row: int, root: float, risen: Array, acting: int, G: Array, J: Array) -> None:
    """Fill in `J` (z,), the gradient of an output by the decisions, times `root`."""
    for b in range(acting):
        for j in range(m):
            J[b * m + j] = root * slope[n + j, row] * risen[b, j]
    for l in range(n):  # noqa: E741
        factor = root * slope[l, row]
        for z in range(acting * m):
            J[z] += factor * G[l, z]


@inlined
def charge(J: Array, r: Array, acting: int, H: Array, f: Array) -> None:
    """Add ½|r + J z|² to the cost, to the lower half of H, whose first `acting` columns J has."""
    for row in range(J.shape[0]):
        for i in range(acting):
            factor = J[row, i]
            f[i] += factor * r[row]
            for j in range(i + 1):
                H[i, j] += factor * J[row, j]


@inlined
def end(L: Array, risen: Array, G: Array, x: Array, x_ref: Array, u: Array, u_ref: Array, H: Array, f: Array) -> None:
    """Add the terminal cost ½|L (ξ + ∂ξ/∂z z)|², ξ = (x_N - x*_N, e_{N-1})."""
    J, r, blocks = np.zeros((L.shape[0], f.size)), np.zeros(L.shape[0]), risen.shape[0]
    for row in range(L.shape[0]):
        for i in range(SIZE):
            r[row] += L[row, i] * (x[i] - x_ref[i])
        for j in range(m):
            r[row] += L[row, SIZE + j] * (u[j] - u_ref[j])
            for b in range(blocks):
                J[row, b * m + j] = L[row, 2 * n + j] * risen[b, j] + L[row, SIZE + j] * BAR
        for i in range(2 * n):
            for z in range(f.size):
                J[row, z] += L[row, i] * G[i, z]
    charge(J, r, f.size, H, f)


@compiled
def finish(
    c: Array, h: float, decay: Array, bounds: Array, soft: Array, ranges: Array, starts: Any, risen: Array,
    x0: Array, d: Array, u_last: Array, u: Array, x: Array, y: Array, slope: Array, G: Array,
    H: Array, f: Array, lower: Array, upper: Array, z: Array, moved: Array, x_next: Array, y_next: Array,
) -> int:  # fmt: skip
    """Return SOLVED if `z` is proved to solve the whole QP, and fill in what it leads to; else why not.

    `soft` (3,): what a row may be broken by, how far the gradient may be from 0, the least force; `ranges` (2, n).
    """
    if not proved(H, f, lower, upper, z, soft[1]):
        return REFUSED
    if not keeps_rows(bounds, soft, ranges, starts, risen, u, x, y, slope, G, z, moved):
        return ROWS
    for k in range(u.shape[0]):
        for j in range(m):
            moved[k, j] += u[k, j]
    limit(bounds, u_last, moved, moved)
    roll(c, h, decay, x0, moved, d, x_next, y_next)
    return SOLVED if finite(x_next) and finite(y_next) else REFUSED


@compiled
def rollout(
    c: Array, h: float, decay: Array, bounds: Array, u_last: Array, x0: Array, d: Array, u: Array, starts: Any,
    z: Array, moved: Array, x: Array, y: Array,
) -> bool:  # fmt: skip
    """Fill in the commands that `z` makes of `u`, `moved` to within the limits, and their motion; return whether that
    is finite.
    """
    for j in range(m):
        change, block = 0.0, 0
        for k in range(u.shape[0]):
            if block < starts.size and starts[block] == k:
                change += BAR * z[block * m + j]
                block += 1
            moved[k, j] = u[k, j] + change
    limit(bounds, u_last, moved, moved)
    roll(c, h, decay, x0, moved, d, x, y)
    return finite(x) and finite(y)


@inlined
def proved(H: Array, f: Array, lower: Array, upper: Array, z: Array, allowed: float) -> bool:
    """Return whether `z` is within its bounds and the gradient there, but for pushes at bounds, is next to nothing."""
    square = 0.0
    for i in range(f.size):
        gradient = f[i]
        for j in range(f.size):
            gradient += H[i, j] * z[j]
        z[i] = min(max(z[i], lower[i]), upper[i])
        pushes = (z[i] == lower[i] and gradient >= 0.0) or (z[i] == upper[i] and gradient <= 0.0)
        square += 0.0 if pushes else gradient * gradient
    return square <= allowed * allowed  # False for NaN


@inlined
def keeps_rows(
    bounds: Array, soft: Array, ranges: Array, starts: Any, risen: Array, u: Array, x: Array, y: Array, slope: Array,
    G: Array, z: Array, moved: Array,
) -> bool:  # fmt: skip
    """Return whether the linear model keeps supply, ranges and least forces under z; `moved` becomes E z [Pa]."""
    N, tolerance, acting = u.shape[0], soft[0], 0
    dq, dP = np.empty(n), np.empty(m)
    for k in range(N):
        if acting < starts.size and starts[acting] == k:
            acting += 1
        for j in range(m):
            change, risen_so_far = 0.0, 0.0
            for b in range(acting):
                change += z[b * m + j] * BAR
                risen_so_far += z[b * m + j] * risen[k + 1, b, j]
            moved[k, j], dP[j] = change, risen_so_far
            below, above = min(bounds[0] - u[k, j], 0.0), max(bounds[1] - u[k, j], 0.0)
            if not below - tolerance * BAR <= change <= above + tolerance * BAR:
                return False
        for i in range(n):
            dq[i] = 0.0
            for w in range(acting * m):
                dq[i] += G[k + 1, i, w] * z[w]
            if not ranges[0, i] - tolerance <= x[k + 1, i] + dq[i] <= ranges[1, i] + tolerance:
                return False
        for j in range(m):
            row = STIFFNESSES + j
            F = y[k + 1, row] + slope[k + 1, n + j, row] * dP[j]
            for i in range(n):
                F += slope[k + 1, i, row] * dq[i]
            if not F >= soft[2] - tolerance:
                return False
    return True


@compiled
def rows_of(
    bounds: Array, least: float, ranges: Array, starts: Any, risen: Array, u: Array, x: Array, y: Array, slope: Array,
    G: Array, R: Array, below: Array, above: Array,
) -> None:  # fmt: skip
    """Fill in the rows of `mpc.tracking.qp.condense`: supply (N m), upper, lower angles (N n) each, forces (N m)."""
    N, acting, size = u.shape[0], 0, starts.size * m
    R[:], below[:], above[:] = 0.0, -np.inf, np.inf
    for k in range(N):
        if acting < starts.size and starts[acting] == k:
            acting += 1
        for j in range(m):
            command, force, row = k * m + j, N * (m + 2 * n) + k * m + j, STIFFNESSES + j
            below[command] = min((bounds[0] - u[k, j]) / BAR, 0.0)
            above[command] = max((bounds[1] - u[k, j]) / BAR, 0.0)
            below[force], R[force, size + 1] = least - y[k + 1, row], 1.0
            for i in range(n):
                for w in range(acting * m):
                    R[force, w] += slope[k + 1, i, row] * G[k + 1, i, w]
            for b in range(acting):
                R[command, b * m + j] = 1.0
                R[force, b * m + j] += slope[k + 1, n + j, row] * risen[k + 1, b, j]
        for i in range(n):
            right, left = N * m + k * n + i, N * (m + n) + k * n + i
            above[right], below[left] = ranges[1, i] - x[k + 1, i], ranges[0, i] - x[k + 1, i]
            R[right, size], R[left, size] = -1.0, 1.0
            for w in range(acting * m):
                R[right, w] = R[left, w] = G[k + 1, i, w]
