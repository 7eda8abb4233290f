"""Dense QP of an arm's step: its cost without rows, the proof that an answer satisfies the rows, and the rows.

`mpc.tracking.compiled.arm.module` combines this file with `step`, which defines a path, for the sizes of the arm.
Decisions z count in bar, as in `mpc.tracking.qp.condense`.
"""

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.records import Indices
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, NX, STIFFNESSES

n, m = JOINTS, NU


@compiled
def condense(
    weights: Array, L: Array, starts: Indices, risen: Array, constant: Array, dt: float, bounds: Array,
    x: Array, S: Array, y: Array, slope: Array, u: Array,
    x_ref: Array, y_ref: Array, u_ref: Array, u_last: Array, e_last: Array,
    G: Array, H: Array, f: Array, lower: Array, upper: Array,
) -> None:  # fmt: skip
    """Fill in G (N+1, 2n, z) = ∂(q, ω)/∂z and the QP without rows and slacks.

    `weights` (2n + stiffnesses + 2m,) are those of angles, velocities, stiffnesses, commands and their rates; `risen`
    (N+1, blocks, m) [Pa/bar] is the response of the pressures to the change of a block, `constant` (z, z) the part of H
    due to commands, `L` the terminal factor.
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
    weights: Array, starts: Indices, dt: float, bounds: Array, u: Array, u_ref: Array, u_last: Array, e_last: Array,
    f: Array, lower: Array, upper: Array,
) -> None:  # fmt: skip
    """Fill in the gradient of the cost of commands and their rate, and the bounds of the changes."""
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
    """Fill in the next G from this one, for the blocks that are `acting` so far."""
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
    """Fill in `J` (z,), the gradient of an output with respect to the decisions, times `root`."""
    for b in range(acting):
        for j in range(m):
            J[b * m + j] = root * slope[n + j, row] * risen[b, j]
    for l in range(n):  # noqa: E741
        factor = root * slope[l, row]
        for z in range(acting * m):
            J[z] += factor * G[l, z]


@inlined
def charge(J: Array, r: Array, acting: int, H: Array, f: Array) -> None:
    """Add ½|r + J z|² to the cost, to the lower half of H; J has its first `acting` columns."""
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
        for i in range(NX):
            r[row] += L[row, i] * (x[i] - x_ref[i])
        for j in range(m):
            r[row] += L[row, NX + j] * (u[j] - u_ref[j])
            for b in range(blocks):
                J[row, b * m + j] = L[row, 2 * n + j] * risen[b, j] + L[row, NX + j] * BAR
        for i in range(2 * n):
            for z in range(f.size):
                J[row, z] += L[row, i] * G[i, z]
    charge(J, r, f.size, H, f)


@inlined
def proved(H: Array, f: Array, lower: Array, upper: Array, z: Array, allowed: float) -> bool:
    """Return whether `z` is within its bounds and the gradient there, except for pushes at bounds, is almost zero."""
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
    bounds: Array, soft: Array, ranges: Array, starts: Indices, risen: Array, u: Array, x: Array, y: Array,
    slope: Array, G: Array, z: Array, moved: Array,
) -> bool:  # fmt: skip
    """Return whether the linear model respects supply, ranges and least forces under z; `moved` becomes E z [Pa]."""
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
    bounds: Array, least: float, ranges: Array, starts: Indices, risen: Array, u: Array, x: Array, y: Array,
    slope: Array, G: Array, R: Array, below: Array, above: Array,
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
