"""Stages of an ordinary step: those of `Preview` and `Ladder` for valid inputs.

They refuse any other step, which the readable stages then make (`mpc.tracking.base`). The text is that of a joint;
`mpc.tracking.compiled.arm.module` copies it for other sizes.
"""

from math import inf, pi

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import inlined_flat
from mpc.model.compensation import SOFT
from mpc.model.experiment import SYMMETRIC
from mpc.tracking.compiled.commands import limit
from mpc.tracking.compiled.records import Bounds, Given, Indices, Signs
from mpc.tracking.compiled.sample.layout import Asked, Known, Made, State
from mpc.tracking.compiled.sample.views import memory_in
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, NX, TRACKED
from mpc.tracking.rest_memory import HELD

WHOLE, FEED, LINEARISE, ROLLOUT = range(4)  # the part of a step to make
_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] as in `mpc.tracking.preview`


@inlined_flat
def ask(x: Array, theta: Array, K: Array, asked: Asked) -> None:
    """Copy the state and the flat previews, whose sizes are those of `asked`."""
    for i in range(NX):
        asked.x[i] = x[i]
    for k in range(asked.theta.size):
        asked.theta[k] = theta[k]
    for k in range(asked.K.size):
        asked.K[k] = K[k]


@inlined_flat
def plausible(known: Known, asked: Asked, factor: Array) -> bool:
    """Return whether the whole state was measured, and the references and the torques are plausible."""
    for i in range(NX):
        if not known.lower[i] <= asked.x[i] <= known.upper[i]:
            return False
    for theta in asked.theta:
        if not -_TURN <= theta <= _TURN:
            return False
    for i in range(JOINTS):
        if not np.isfinite(asked.d[i]):
            return False
    for k in range(asked.K.size // TRACKED**2):
        if not definite(asked.K[k * TRACKED**2 : (k + 1) * TRACKED**2], factor):
            return False
    return True


@inlined_flat
def definite(K: Array, L: Array) -> bool:
    """Return whether the flat matrix `K` is symmetric and positive definite; `L` is room for its Cholesky factor."""
    for i in range(TRACKED):
        for j in range(i + 1):
            value = K[i * TRACKED + j]
            if not abs(value - K[j * TRACKED + i]) <= SYMMETRIC * K[0]:
                return False
            for c in range(j):
                value -= L[i * TRACKED + c] * L[j * TRACKED + c]
            if i > j:
                L[i * TRACKED + j] = value / L[j * TRACKED + j]
            elif _LEAST <= value < inf:
                L[i * TRACKED + i] = np.sqrt(value)
            else:
                return False
    return True


@inlined_flat
def under_way(state: State, x: Array, waiting: Array) -> None:
    """Fill in the commands (delay, m) [bar] under way; before the first command, the pressures of `x` (2n + m,)."""
    for k in range(waiting.shape[0]):
        for i in range(NU):
            waiting[k, i] = (x[2 * JOINTS + i] if np.isnan(state.waiting[k, i]) else state.waiting[k, i]) / BAR


@inlined_flat
def take(x: Array, asked: Asked, bounds: Bounds, state: State, given: Given) -> None:
    """Set the new data of a step that begins in `x` (2n + m,) after the dead time: see `Ladder.previous` and
    `Ladder.shift`. The first command is near the measured pressures, made `Limits.commandable`.
    """
    least = BAR * min(bounds.low, 0.0)
    u_star, N, turns = given.reference.u, given.u.shape[0], not np.isnan(state.u[0, 0])
    for i in range(NX):
        given.x[i] = x[i]
    for i in range(NU):
        first = np.isnan(state.u[0, i])
        given.last[0, i] = max(asked.x[2 * JOINTS + i], least) if first else state.u[0, i]
        given.last[1, i] = u_star[0, i] if np.isnan(state.u_star[i]) else state.u_star[i]
        for k in range(N):
            given.u[k, i] = u_star[k, i] if first else state.u[min(k + 1, N - 1), i]
        turns = turns and np.isfinite(u_star[N - 1, i] - u_star[N - 2, i])
    if turns:
        for i in range(NU):
            given.u[N - 1, i] += u_star[N - 1, i] - u_star[N - 2, i]


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
    held = memory_in(rest, JOINTS, NU).muscle
    for k in range(made.u.shape[0]):
        for i in range(NU):
            made.u[k, i] = held[i, HELD] / BAR
    limit(bounds.low, bounds.high, bounds.step, state.u[0], BAR, made.u)


@inlined_flat
def invert_dead_band(known: Known, bounds: Bounds, given: Given, state: State, side: float, made: Made) -> None:
    """Fill in the pressures to send so that the plan's commands act, on the `side` of the band: see `Preview.sent`."""
    N, half = made.u.shape[0], known.dead_band / 2
    for k in range(N):
        for i in range(NU):
            v = made.u[k, i]
            edge = side if side != 0.0 or half == 0.0 else np.tanh((v - made.x[k, 2 * JOINTS + i]) / SOFT)
            made.sent[k, i] = v if half == 0.0 else (v + half * edge) / BAR
    if half == 0.0:
        return
    last = given.last[0] if np.isnan(state.sent[0]) else state.sent
    limit(bounds.low, bounds.high, bounds.step, last, BAR, made.sent)
    for k in range(N):
        for i in range(NU):
            made.sent[k, i] = BAR * made.sent[k, i]


@inlined_flat
def remember(asked: Asked, given: Given, path: Array, made: Made, before: State, after: State) -> None:
    """Remember the plan, and the motion `path` (delay + 1, 2n + m) until it acts."""
    u_star, delay, known_star = given.reference.u, path.shape[0] - 1, True
    for i in range(NU):
        known_star = known_star and np.isfinite(u_star[0, i])
    for i in range(NU):
        after.sent[i] = made.sent[0, i]
        after.u_star[i] = u_star[0, i] if known_star else before.u_star[i]
        for k in range(delay):
            later = before.waiting[k + 1, i] if k + 1 < delay else made.u[0, i]
            after.waiting[k, i] = asked.x[2 * JOINTS + i] if np.isnan(later) else later
    for i in range(NX):
        after.expected[i] = path[1, i] if delay > 0 else made.x[1, i]
