"""The ordinary stages of a step are those of `Preview` and `Ladder` when nothing is amiss.

Whatever is not ordinary these refuse, and the readable stages answer (`mpc.tracking.base`).
"""

from math import inf, pi
from typing import Any

import numpy as np

from mpc.model.plant import NU
from mpc.tracking.compiled.flat_records import Given
from mpc.tracking.compiled.jit import inlined
from mpc.tracking.compiled.sample.layout import Asked, Known, Made, State

WHOLE, FEED, LINEARISE, ROLLOUT = range(4)  # what of a step is made
_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] as in `mpc.tracking.preview`


@inlined
def plausible(known: Known, asked: Asked) -> bool:
    """Return whether all of the state was measured, and the references and the torque can be meant; fill in torques."""
    for i in range(4):
        if not known.lower[i] <= asked.x[i] <= known.upper[i]:
            return False
    for k in range(asked.theta.size):
        if not (-_TURN <= asked.theta[k] <= _TURN and _LEAST <= asked.K[k] < inf):
            return False
        asked.torques[k] = asked.d[0]
    return bool(np.isfinite(asked.d[0]))


@inlined
def take(asked: Asked, state: State, given: Given) -> None:
    """Set what is new in a step: see `Ladder.previous` and `Ladder.shift`."""
    u_star, N = given.reference.u, given.u.shape[0]
    for k in range(N):
        given.d[k] = asked.torques[k]
    for i in range(4):
        given.x[i] = asked.x[i]
    for i in range(2):
        first = np.isnan(state.u[0, i])
        given.last[0, i] = asked.x[2 + i] if first else state.u[0, i]
        given.last[1, i] = u_star[0, i] if np.isnan(state.u_star[i]) else state.u_star[i]
        for k in range(N):
            given.u[k, i] = u_star[k, i] if first else state.u[min(k + 1, N - 1), i]
    turn0, turn1 = u_star[N - 1, 0] - u_star[N - 2, 0], u_star[N - 1, 1] - u_star[N - 2, 1]
    if not np.isnan(state.u[0, 0]) and np.isfinite(turn0) and np.isfinite(turn1):
        given.u[N - 1, 0] += turn0
        given.u[N - 1, 1] += turn1


@inlined
def shift_set(starts: Any, before: Any, guess: Any) -> None:
    """Set the `guess` (n,) to what it was `before` (n,), one sample later: see `mpc.tracking.compiled.structured`."""
    later = 0
    for block in range(starts.size):
        while later + 1 < starts.size and starts[later + 1] <= starts[block] + 1:
            later += 1
        for i in range(NU):
            guess[NU * block + i] = before[NU * later + i]


@inlined
def copy_set(one: Any, other: Any) -> None:
    """Copy the active set `one` (n,) to the `other` (n,)."""
    for i in range(one.size):
        other[i] = one[i]


@inlined
def remember(given: Given, made: Made, state: State) -> None:
    """Remember the plan."""
    u_star = given.reference.u
    known_star = np.isfinite(u_star[0, 0]) and np.isfinite(u_star[0, 1])
    for i in range(2):
        state.sent[i] = made.u[0, i]
        state.u_star[i] = u_star[0, i] if known_star else state.u_star[i]
        for k in range(made.u.shape[0]):
            state.u[k, i] = made.u[k, i]
    for i in range(4):
        state.expected[i] = made.x[1, i]


__all__ = ["FEED", "LINEARISE", "ROLLOUT", "WHOLE", "copy_set", "plausible", "remember", "shift_set", "take"]
