"""How the records of the compiled functions lie in flat arrays, which Python hands over in a fraction of the time.

numba opens a record argument field by field; at some dozens of arrays that takes longer than the step itself.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.compiled.jit import inlined
from mpc.tracking.compiled.records import Cost, Path, Room, Setting, Wish


class Given(NamedTuple):
    """What is new in a step."""

    x: Array  # (4,)
    u: Array  # (N, 2) commands to begin from [Pa]
    d: Array  # (N,) [N·m]
    wish: Wish
    last: Array  # (2, 2) command and feed-forward of the sample before [Pa]


_GIVEN, _PATH = (10, 13), (45, 19)  # numbers for a sample of the horizon, and beyond: of a `Given`, of a path


def flat(setting: Setting) -> Array:
    """The numbers (49,) of `setting`."""
    rest = setting.tolerance, setting.accuracy
    return np.concatenate([setting.cost[:5], setting.room, rest, np.ravel(setting.cost.end)])


@inlined
def setting_in(numbers: Array, starts: Any) -> Setting:
    """The setting of these `numbers`."""
    n = numbers
    cost = Cost(n[0], n[1], n[2], n[3], n[4], n[13:49].reshape(6, 6))
    return Setting(cost, Room(n[5], n[6], n[7], n[8], n[9], n[10]), n[11], n[12], starts)


@inlined
def given_in(memory: Array) -> Given:
    """Views into `memory` (10 N + 13,)."""
    N = (memory.size - _GIVEN[1]) // _GIVEN[0]
    M = N + 1
    theta, omega, K = memory[:M], memory[M : 2 * M], memory[2 * M : 3 * M]
    P, rest = memory[3 * M : 5 * M].reshape(M, 2), memory[5 * M :]
    u_star, u, d = rest[: 2 * N].reshape(N, 2), rest[2 * N : 4 * N].reshape(N, 2), rest[4 * N : 5 * N]
    return Given(rest[5 * N : 5 * N + 4], u, d, Wish(theta, omega, K, P, u_star), rest[5 * N + 4 :].reshape(2, 2))


@inlined
def path_in(memory: Array) -> tuple[Path, Array]:
    """A path and its commands (N, 2) [bar]: views into `memory` (45 N + 19,)."""
    N = (memory.size - _PATH[1]) // _PATH[0]
    M = N + 1
    x, y = memory[: 4 * M].reshape(M, 4), memory[4 * M : 7 * M].reshape(M, 3)
    slope, rest = memory[7 * M : 19 * M].reshape(M, 3, 4), memory[19 * M :]
    A, B = rest[: 16 * N].reshape(N, 4, 4), rest[16 * N : 24 * N].reshape(N, 4, 2)
    return Path(x, y, A, B, slope), rest[24 * N : 26 * N].reshape(N, 2)


def lengths(N: int) -> tuple[int, int]:
    """Of the memories of a `Given` and of a path."""
    return _GIVEN[0] * N + _GIVEN[1], _PATH[0] * N + _PATH[1]


__all__ = ["Given", "flat", "given_in", "lengths", "path_in", "setting_in"]
