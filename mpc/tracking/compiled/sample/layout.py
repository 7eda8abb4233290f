"""The layout says what lies where in the flat arrays of a sample, for Python and for compiled code.

asked  what a caller asks: the state, the torque from outside, previews over the dead time and the horizon
state  what a controller remembers from sample to sample; NaN where there is nothing yet
out    what a sample makes: a plan, and what is said of it
known  what is known of the plant, and does not change
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined

_ASKED, _STATE, _TAIL = 5, 11, 9


class Asked(NamedTuple):
    """Asked is what `mpc.tracking.base.BaseController.step` is given."""

    x: Array  # (4,) measured
    d: Array  # (1,) [N·m]
    theta: Array  # (ahead + 1,) [rad]
    K: Array  # (ahead + 1,) [N·m/rad]
    torques: Array  # (ahead + 1,) from outside and of friction, to be filled in [N·m]


class State(NamedTuple):
    """The state is what `Ladder`, `Preview` and `FrictionState` remember, with n numbers and a delay of m samples."""

    u_star: Array  # (2,) the feed-forward of the previous sample [Pa]
    sent: Array  # (2,) [Pa]
    expected: Array  # (4,) the state that was predicted for now
    angle: Array  # (1,) from which the motion counts that friction remembers [rad]
    rest: Array  # (2,) the reference while it stands still [rad], [N·m/rad]
    memory: Array  # (n,) of friction
    waiting: Array  # (m, 2) commands as they will act, oldest first [Pa]
    u: Array  # (N, 2) the last plan's commands as they should act [Pa]


class Made(NamedTuple):
    """What is made is a plan."""

    u: Array  # (N, 2) as it should act [Pa]
    sent: Array  # (N, 2) what has to be sent for that [Pa]
    x: Array  # (N+1, 4)
    K: Array  # (N+1,)
    F: Array  # (N+1, 2)
    tail: Array  # (9,) slack [rad], slack of forces [N], `Moved` (3,), and `Times` without the total (4,)


class Known(NamedTuple):
    """What is known is numbers of the plant, the sample time and the gate of a measured state."""

    inertia: float
    damping: float
    gravity: float
    alpha1: float
    alpha2: float
    lag1: float  # [s]
    lag2: float
    h: float  # step of the integration [s]
    substeps: int
    left: float  # joint range [rad]
    right: float
    min_force: float  # [N]
    lower: Array  # (4,)
    upper: Array  # (4,)
    dead_band: float  # [Pa]
    rests: bool  # whether commands come to rest at a constant reference


def lengths(N: int, delay: int, memory: int) -> tuple[int, int, int]:
    """Return the lengths of `asked`, `state` and `out`."""
    previews = N + delay + 1
    return _ASKED + 3 * previews, _STATE + memory + 2 * (delay + N), _python(length_of)(N)


@inlined
def length_of(N: int) -> int:
    """Return the length of `out`."""
    return 4 * N + 7 * (N + 1) + _TAIL


@inlined
def asked_in(asked: Array) -> Asked:
    """Return views into `asked`."""
    n = (asked.size - _ASKED) // 3
    previews = asked[_ASKED:]
    return Asked(asked[0:4], asked[4:5], previews[:n], previews[n : 2 * n], previews[2 * n : 3 * n])


@inlined
def state_in(state: Array, memory: int, delay: int) -> State:
    """Return views into `state`, with `memory` numbers of friction and a `delay` [samples]."""
    rest, n = state[_STATE + memory :], 2 * delay
    N = (rest.size - n) // 2
    waiting, u = rest[:n].reshape(delay, 2), rest[n:].reshape(N, 2)
    return State(
        state[0:2], state[2:4], state[4:8], state[8:9], state[9:11], state[_STATE : _STATE + memory], waiting, u
    )


@inlined
def made_in(out: Array) -> Made:
    """Return views into `out`."""
    N = (out.size - _TAIL - 7) // 11
    M, n, rest = N + 1, 2 * N, out[4 * N :]
    x, K, F = rest[: 4 * M].reshape(M, 4), rest[4 * M : 5 * M], rest[5 * M : 7 * M].reshape(M, 2)
    return Made(out[:n].reshape(N, 2), out[n : 2 * n].reshape(N, 2), x, K, F, rest[7 * M :])


@inlined
def known_in(known: Array) -> Known:
    """Return what `known_of` has written."""
    k = known
    lags = k[3], k[4], k[5], k[6]
    return Known(k[0], k[1], k[2], *lags, k[7], int(k[8]), k[9], k[10], k[11], k[12:16], k[16:20], k[20], k[21] != 0.0)


def asked_of(asked: Array) -> Asked:
    """Return views into `asked`, in Python."""
    return _python(asked_in)(asked)  # type: ignore[no-any-return]


def state_of(state: Array, memory: int, delay: int) -> State:
    """Return views into `state`, in Python."""
    return _python(state_in)(state, memory, delay)  # type: ignore[no-any-return]


def made_of(out: Array) -> Made:
    """Return views into `out`, in Python."""
    return _python(made_in)(out)  # type: ignore[no-any-return]


def _python(views: Any) -> Any:
    return views.py_func


def known_of(known: Known) -> Array:
    """Return the numbers (22,) of `known`."""
    return np.hstack(known).astype(float)


__all__ = [
    "Asked", "Known", "Made", "State", "asked_in", "asked_of", "known_in", "known_of", "length_of", "lengths",
    "made_in", "made_of", "state_in", "state_of",
]  # fmt: skip
