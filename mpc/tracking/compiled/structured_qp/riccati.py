"""Solution of a step's QP without its rows by Riccati recursions: O(N) instead of O(N³), in one compiled call.

The problem is that of `mpc.tracking.qp.condense`, with the state ξ_k = (δx_k, w_k), w_k the deviation of u_{k-1} from
ū_{k-1}, and the change v_k of that deviation as input: w_{k+1} = w_k + v_k, δx_{k+1} = A_k δx_k + B_k w_{k+1}. The cost
of a stage from v_k on is ½ ρ|v|² + ρ Δeᵀv + W_k(δx, w + v), W_k the cost-to-go after the command; hence with
D = W_ww + ρ I

    D v + W_wx δx + W_ww w + g = -λ,        λ = 0 for free changes, v at its bound for the others

A primal–dual active-set method: sweep backward and forward with the bounds held that are guessed to be active, then
guess anew: hold changes that violate a bound, release those held with λ of the wrong sign. A guess that repeats itself
is the solution. That takes a sweep or two from the last sample's set; if no guess repeats itself, `interior` solves the
QP. The caller has to prove the answer.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Cost, Indices, Path, Point, Setting, Signs
from mpc.tracking.compiled.structured_qp.sizes import FREE, LOWER, NU, NX, NXI, UPPER
from mpc.tracking.compiled.structured_qp.stage import (
    across,
    advance,
    charge_state,
    choose,
    decided,
    led_back,
    linear_before,
    new_squares,
    times,
)


class Sweep(NamedTuple):
    """Arrays of a sweep."""

    R: Array  # (N, 2, 6) [W_wx W_ww]
    D: Array  # (N, 3): entries 00, 01, 11
    g: Array  # (N, 2)
    feedback: Array  # (N, 2, 7) v by (ξ, 1)
    held: Signs  # (N, 2) the bound at which each change is held
    gx: Array  # (N+1, 6) gradient of the cost by ξ
    gv: Array  # (N, 2) and by v
    r: Array  # (N, 2) by v alone, with ξ as a function of v
    inverse: Array  # (N, 3) of D for the free changes: entries 00, 01, 11


@inlined
def new_sweep(N: int) -> Sweep:
    """Return the arrays of a sweep."""
    R, D, g, feedback = np.empty((N, NU, NXI)), new_squares(N), np.empty((N, NU)), np.empty((N, NU, NXI + 1))
    gx, gv, r = np.empty((N + 1, NXI)), np.empty((N, NU)), np.empty((N, NU))
    return Sweep(R, D, g, feedback, np.empty((N, NU), np.int8), gx, gv, r, new_squares(N))


@inlined
def settled(
    path: Path, setting: Setting, gx: Array, gv: Array, bounded: Bounded, guess: Signs, sweeps: int, at: Point,
    sweep: Sweep
) -> bool:  # fmt: skip
    """Return whether a guess repeated itself within so many sweeps; then `at` is the solution, within its bounds.

    `gx` and `gv` are the cost's gradients at the origin; `guess` (n,) becomes the set found. Between the starts of the
    blocks, all changes are held at 0.
    """
    starts, N, lower, upper, held = setting.starts, path.A.shape[0], bounded.lower, bounded.upper, sweep.held
    take_set(starts, guess, held)
    for _ in range(sweeps):
        for k in range(N):
            for i in range(NU):
                at.v[k, i] = lower[k, i] if held[k, i] == LOWER else upper[k, i]  # of the held changes
        backward(path, setting.cost, gx, gv, at.v, sweep)
        if not forward(path, lower, upper, sweep, at):
            give_set(starts, held, guess)
            return True
    return False


@inlined_flat
def take_set(starts: Indices, guess: Signs, held: Signs) -> None:
    """Set `held` (N, 2) to a `guess` (n,), and hold all other changes."""
    held[:] = LOWER
    for block in range(starts.size):
        for i in range(NU):
            held[starts[block], i] = guess[NU * block + i]


@inlined_flat
def give_set(starts: Indices, held: Signs, guess: Signs) -> None:
    """Set the `guess` (n,) to the changes `held` (N, 2)."""
    for block in range(starts.size):
        for i in range(NU):
            guess[NU * block + i] = held[starts[block], i]


@inlined
def backward(path: Path, cost: Cost, gx: Array, gv: Array, v: Array, sweep: Sweep) -> None:
    """Fill in, for each k, R = [W_wx W_ww], D, g, and the feedback v = feedback (ξ, 1) of the optimal changes."""
    N, R, D, g, feedback = v.shape[0], sweep.R, sweep.D, sweep.g, sweep.feedback
    S, SA, s = cost.end.copy(), np.empty((NXI, NXI)), gx[N].copy()  # of V_{k+1}
    for k in range(N - 1, -1, -1):
        across(S, path.A, path.B, k, cost.e, SA, R)
        linear_before(s, path.A, path.B, k)
        for i in range(NU):
            g[k, i] = s[NX + i] + gv[k, i]
        choose(R, cost.change, D, g, v, sweep.held, k, sweep.inverse, feedback)
        decided(path.A, path.B, k, SA, R, feedback, S)
        led_back(R, feedback, k, s)
        if k > 0:
            charge_state(S, path.slope, k, cost)
            for i in range(NXI):
                s[i] += gx[k, i]


@inlined_flat
def forward(path: Path, lower: Array, upper: Array, sweep: Sweep, at: Point) -> bool:
    """Set the point by the feedback and guess `held` anew; return whether the guess has changed."""
    v, xi, changed = at.v, at.xi, False
    R, D, g, feedback, held = sweep.R, sweep.D, sweep.g, sweep.feedback, sweep.held
    for i in range(NXI):
        xi[0, i] = 0.0
    for k in range(v.shape[0]):
        for i in range(NU):
            v[k, i] = feedback[k, i, NXI]
            for j in range(NXI):
                v[k, i] += feedback[k, i, j] * xi[k, j]
        for i in range(NU):
            if held[k, i] == FREE:
                guess = LOWER if v[k, i] < lower[k, i] else UPPER if v[k, i] > upper[k, i] else FREE
            else:
                push = g[k, i] + times(D, k, i, v)  # -λ
                for j in range(NXI):
                    push += R[k, i, j] * xi[k, j]
                wrong = lower[k, i] < upper[k, i] and (push < 0.0 if held[k, i] == LOWER else push > 0.0)
                guess = FREE if wrong else held[k, i]
            changed |= guess != held[k, i]
            held[k, i] = guess
            xi[k + 1, NX + i] = xi[k, NX + i] + v[k, i]
        advance(path.A, path.B, k, xi)
    return changed
