"""Stages of an ordinary step: those of `Preview` and `Ladder` for valid inputs.

They refuse any other step, which the readable stages then make (`mpc.tracking.base`).
"""

from math import inf, pi

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import inlined_flat
from mpc.model.compensation import SOFT
from mpc.model.plant import NU
from mpc.tracking.compiled.commands import limit
from mpc.tracking.compiled.records import Bounds, Given, Indices, Signs
from mpc.tracking.compiled.sample.layout import Asked, Known, Made, State, memory_in
from mpc.tracking.rest_memory import HELD

WHOLE, FEED, LINEARISE, ROLLOUT = range(4)  # the part of a step to make
_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] as in `mpc.tracking.preview`


@inlined_flat
def ask(x: Array, theta: Array, K: Array, d: float, asked: Asked) -> None:
    """Copy the arguments, whose shapes are those of `asked`."""
    for i in range(4):
        asked.x[i] = x[i]
    for k in range(asked.theta.size):
        asked.theta[k], asked.K[k] = theta[k], K[k]
    asked.d[0] = d


@inlined_flat
def plausible(known: Known, asked: Asked) -> bool:
    """Return whether the whole state was measured, and the references and the torque are plausible."""
    for i in range(4):
        if not known.lower[i] <= asked.x[i] <= known.upper[i]:
            return False
    for k in range(asked.theta.size):
        if not (-_TURN <= asked.theta[k] <= _TURN and _LEAST <= asked.K[k] < inf):
            return False
    return bool(np.isfinite(asked.d[0]))


@inlined_flat
def under_way(state: State, x: Array, waiting: Array) -> None:
    """Fill in the commands (m, 2) [bar] under way; before the first command, the pressures of `x` (4,)."""
    for k in range(waiting.shape[0]):
        for i in range(2):
            waiting[k, i] = (x[2 + i] if np.isnan(state.waiting[k, i]) else state.waiting[k, i]) / BAR


@inlined_flat
def take(x: Array, torques: Array, state: State, given: Given) -> None:
    """Set the new data of a step that begins in `x` (4,): see `Ladder.previous` and `Ladder.shift`."""
    u_star, N = given.reference.u, given.u.shape[0]
    for k in range(N):
        given.d[k] = torques[k]
    for i in range(4):
        given.x[i] = x[i]
    for i in range(2):
        first = np.isnan(state.u[0, i])
        given.last[0, i] = x[2 + i] if first else state.u[0, i]
        given.last[1, i] = u_star[0, i] if np.isnan(state.u_star[i]) else state.u_star[i]
        for k in range(N):
            given.u[k, i] = u_star[k, i] if first else state.u[min(k + 1, N - 1), i]
    turn0, turn1 = u_star[N - 1, 0] - u_star[N - 2, 0], u_star[N - 1, 1] - u_star[N - 2, 1]
    if not np.isnan(state.u[0, 0]) and np.isfinite(turn0) and np.isfinite(turn1):
        given.u[N - 1, 0] += turn0
        given.u[N - 1, 1] += turn1


@inlined_flat
def shift_set(starts: Indices, before: Signs, guess: Signs) -> None:
    """Set the `guess` (n,) to that of `before` (n,), shifted by one sample: see `structured_qp.structured`."""
    later = 0
    for block in range(starts.size):
        while later + 1 < starts.size and starts[later + 1] <= starts[block] + 1:
            later += 1
        for i in range(NU):
            guess[NU * block + i] = before[NU * later + i]


@inlined_flat
def copy_set(one: Signs, other: Signs) -> None:
    """Copy the active set `one` (n,) to the `other` (n,)."""
    for i in range(one.size):
        other[i] = one[i]


@inlined_flat
def hold(rest: Array, bounds: Bounds, state: State, made: Made) -> None:
    """Fill in the approach [bar] to the pressures of a `rest`: see `BaseController._approach`."""
    held = memory_in(rest, 1, NU).muscle
    for k in range(made.u.shape[0]):
        for i in range(NU):
            made.u[k, i] = held[i, HELD] / BAR
    limit(bounds.low, bounds.high, bounds.step, state.u[0], BAR, made.u)


@inlined_flat
def invert_dead_band(known: Known, bounds: Bounds, asked: Asked, state: State, side: float, made: Made) -> None:
    """Fill in the pressures to send so that the plan's commands act, on the `side` of the band: see `Preview.sent`."""
    N, half = made.u.shape[0], known.dead_band / 2
    for k in range(N):
        for i in range(2):
            v = made.u[k, i]
            edge = side if side != 0.0 or half == 0.0 else np.tanh((v - made.x[k, 2 + i]) / SOFT)
            made.sent[k, i] = v if half == 0.0 else (v + half * edge) / BAR
    if half == 0.0:
        return
    last = asked.x[2:] if np.isnan(state.sent[0]) else state.sent
    limit(bounds.low, bounds.high, bounds.step, last, BAR, made.sent)
    for k in range(N):
        made.sent[k, 0], made.sent[k, 1] = BAR * made.sent[k, 0], BAR * made.sent[k, 1]


@inlined_flat
def remember(asked: Asked, given: Given, path: Array, angle: float, made: Made, before: State, after: State) -> None:
    """Remember the plan, the motion `path` (m+1, 4) until it acts, and the `angle` of the friction's memory."""
    u_star, m = given.reference.u, path.shape[0] - 1
    known_star = np.isfinite(u_star[0, 0]) and np.isfinite(u_star[0, 1])
    for i in range(2):
        after.sent[i] = made.sent[0, i]
        after.u_star[i] = u_star[0, i] if known_star else before.u_star[i]
        for k in range(m):
            later = before.waiting[k + 1, i] if k + 1 < m else made.u[0, i]
            after.waiting[k, i] = asked.x[2 + i] if np.isnan(later) else later
    for i in range(4):
        after.expected[i] = path[1, i] if m > 0 else made.x[1, i]
    after.angle[0] = angle
