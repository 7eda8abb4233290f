"""Solution of a step's QP for known held changes by Riccati recursions: O(N) instead of O(N³), in two passes.

The problem is that of `mpc.tracking.qp.condense`, with the state ξ_k = (δx_k, w_k), w_k the deviation of u_{k-1} from
ū_{k-1}, and the change v_k of that deviation as input: w_{k+1} = w_k + v_k, δx_{k+1} = A_k δx_k + B_k w_{k+1}. The cost
of a stage from v_k on is ½ ρ|v|² + ρ Δeᵀv + W_k(δx, w + v), W_k the cost-to-go after the command; hence with
D = W_ww + ρ I

    D v + W_wx δx + W_ww w + g = -λ,        λ = 0 for free changes;

held changes are v = v̄ at a bound of the slew, or v = w̄ - w with their command at a bound of the supply. All variables
are differences from the last known point, so that a repeated sweep removes rounding errors.
"""

from typing import Annotated, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Cost, Indices, Path, Point, Signs
from mpc.tracking.compiled.structured_qp.sizes import FREE, HIGH, JOINTS, LOW, LOWER, NU, NX, NXI, STIFFNESSES
from mpc.tracking.compiled.structured_qp.stage import (
    across,
    advance,
    charge_square,
    charge_state,
    choose,
    decided,
    led_back,
    linear_before,
    new_squares,
    times,
)

BREAKS = 1e-9  # [bar], [rad], [N]: less violates no bound


class Sweep(NamedTuple):
    """Arrays of a sweep."""

    R: Annotated[Array, "N", "m", "xi"]  # [W_wx W_ww]
    D: Annotated[Array, "N", 3]  # entries 00, 01, 11; of an arm (N, m, m)
    g: Annotated[Array, "N", "m"]
    feedback: Annotated[Array, "N", "m", "xi + 1"]  # v by (ξ, 1)
    held: Annotated[Signs, "N + 1", "m"]  # the limit at which each change is held
    gx: Annotated[Array, "N + 1", "xi"]  # gradient of the Lagrangian by ξ at the point
    gv: Annotated[Array, "N", "m"]  # and by v
    inverse: Annotated[Array, "N", 3]  # of D for the free changes: entries 00, 01, 11; of an arm (N, m, m)
    xi: Annotated[Array, "N + 1", "xi"]  # differences from the point
    v: Annotated[Array, "N", "m"]
    e: Annotated[Array, "N", "m"]  # charges of the commands
    change: Annotated[Array, "N", "m"]  # and of their changes
    rows: Annotated[Array, "N + 1", "n + m"]  # of the angle and the forces, beyond the costs


@inlined
def new_sweep(N: int) -> Sweep:
    """Return the arrays of a sweep."""
    R, D, g, feedback = np.empty((N, NU, NXI)), new_squares(N), np.empty((N, NU)), np.empty((N, NU, NXI + 1))
    gx, gv, xi, v = np.empty((N + 1, NXI)), np.empty((N, NU)), np.empty((N + 1, NXI)), np.empty((N, NU))
    held, rows, (e, change) = np.empty((N + 1, NU), np.int8), np.empty((N + 1, JOINTS + NU)), np.empty((2, N, NU))
    return Sweep(R, D, g, feedback, held, gx, gv, new_squares(N), xi, v, e, change, rows)


@inlined_flat
def take_charges(cost: Cost, sweep: Sweep) -> None:
    """Set the charges of commands and changes to those of the cost."""
    sweep.rows[:] = 0.0
    for k in range(sweep.v.shape[0]):
        for i in range(NU):
            sweep.e[k, i], sweep.change[k, i] = cost.e[i], cost.change[i]


@inlined_flat
def charge_rows(S: Array, path: Path, sweep: Sweep, k: int) -> None:
    """Add the charges of soft rows to S (6, 6)."""
    for i in range(JOINTS):
        S[i, i] += sweep.rows[k, i]
    for i in range(NU):
        if sweep.rows[k, JOINTS + i] != 0.0:
            charge_square(S, path.slope, k, STIFFNESSES + i, sweep.rows[k, JOINTS + i])


@inlined_flat
def take_set(starts: Indices, guess: Signs, held: Signs) -> None:
    """Set `held` (N + 1, 2) to a `guess` (n,); the slacks and all changes between the starts of blocks are held."""
    held[:] = LOWER
    for block in range(starts.size):
        for i in range(NU):
            held[starts[block], i] = guess[NU * block + i]


@inlined_flat
def give_set(starts: Indices, held: Signs, guess: Signs) -> None:
    """Set the `guess` (n,) to what is `held`."""
    for block in range(starts.size):
        for i in range(NU):
            guess[NU * block + i] = held[starts[block], i]


@inlined_flat
def end_of(bounded: Bounded, side: int, k: int, i: int) -> float:
    """Return the bound that a change, or its command, is held at."""
    if side == LOW:
        return float(bounded.low[k, i])
    if side == HIGH:
        return float(bounded.high[k, i])
    return float(bounded.lower[k, i] if side == LOWER else bounded.upper[k, i])


@inlined_flat
def within(bounded: Bounded, v: float, w: float, k: int, i: int) -> float:
    """Return the change within slew and supply nearest to `v`, where the command was `w`."""
    v = min(max(v, bounded.low[k, i] - w), bounded.high[k, i] - w)
    return float(min(max(v, bounded.lower[k, i]), bounded.upper[k, i]))


@inlined_flat
def hold(bounded: Bounded, at: Point, sweep: Sweep, k: int, i: int) -> None:
    """Set a held change to the difference from its bound."""
    side = sweep.held[k, i]
    sweep.v[k, i] = end_of(bounded, side, k, i) - (at.xi[k + 1, NX + i] if abs(side) == HIGH else at.v[k, i])


@inlined
def backward(path: Path, cost: Cost, bounded: Bounded, at: Point, sweep: Sweep) -> None:
    """Fill in, for each k, R = [W_wx W_ww], D, g, and the feedback v = feedback (ξ, 1) of the optimal changes."""
    N, R, D, g, feedback = at.v.shape[0], sweep.R, sweep.D, sweep.g, sweep.feedback
    S, SA, s = cost.end.copy(), np.empty((NXI, NXI)), sweep.gx[N].copy()  # of V_{k+1}
    charge_rows(S, path, sweep, N)
    for k in range(N - 1, -1, -1):
        across(S, path.A, path.B, k, sweep.e, SA, R)
        linear_before(s, path.A, path.B, k)
        for i in range(NU):
            g[k, i] = s[NX + i] + sweep.gv[k, i]
            hold(bounded, at, sweep, k, i)
        choose(R, sweep.change, D, g, sweep.v, sweep.held, k, sweep.inverse, feedback)
        decided(path.A, path.B, k, SA, R, D, feedback, sweep.held, S)
        led_back(R, D, g, feedback, sweep.held, k, s)
        if k > 0:
            charge_state(S, path.slope, k, cost)
            charge_rows(S, path, sweep, k)
            for i in range(NXI):
                s[i] += sweep.gx[k, i]


@inlined_flat
def forward(path: Path, sweep: Sweep, at: Point, r: Array) -> None:
    """Move the point by the feedback, and set `r` (N + 1, 2) to the gradient by the held changes, 0 by free ones."""
    v, xi = sweep.v, sweep.xi
    for i in range(NXI):
        xi[0, i] = 0.0
    for k in range(v.shape[0]):
        for i in range(NU):
            v[k, i] = sweep.feedback[k, i, NXI]
            for j in range(NXI):
                v[k, i] += sweep.feedback[k, i, j] * xi[k, j]
        for i in range(NU):
            r[k, i] = 0.0
            if sweep.held[k, i] != FREE:
                r[k, i] = sweep.g[k, i] + times(sweep.D, k, i, v)
                for j in range(NXI):
                    r[k, i] += sweep.R[k, i, j] * xi[k, j]
            at.v[k, i] += v[k, i]
            xi[k + 1, NX + i] = xi[k, NX + i] + v[k, i]
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, xi)
        advance(path.A, path.B, k, at.xi)
