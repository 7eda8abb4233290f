"""The records of the compiled functions lie in flat arrays, which Python hands over in a fraction of the time.

numba opens a record argument field by field; at some dozens of arrays that takes longer than the step itself.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.tracking.compiled.records import Bounds, Cost, Path, Reference, Setting


class Given(NamedTuple):
    """The given is what is new in a step."""

    x: Array  # (4,)
    u: Array  # (N, 2) commands to begin from [Pa]
    d: Array  # (N,) [N·m]
    reference: Reference
    last: Array  # (2, 2) command and feed-forward of the previous sample [Pa]


_GIVEN, _PATH = (12, 15), (45, 19)  # numbers for a sample of the horizon, and beyond: of a `Given`, of a path


def flat(setting: Setting) -> Array:
    """Return the numbers (60,) of `setting`."""
    cost, rest = setting.cost, (setting.curvature, setting.tolerance, setting.accuracy)
    kinds = cost.x, cost.y, cost.e, cost.change, setting.bounds, rest
    return np.concatenate([*kinds, np.ravel(cost.end), setting.slack])


@inlined
def setting_in(numbers: Array, starts: Any) -> Setting:
    """Return the setting of these `numbers`."""
    n = numbers
    cost = Cost(n[0:4], n[4:7], n[7:9], n[9:11], n[20:56].reshape(6, 6))
    return Setting(cost, Bounds(n[11], n[12], n[13], n[14], n[15], n[16]), n[17], n[18], n[19], n[56:60], starts)


@inlined
def given_in(buffer: Array) -> Given:
    """Return views into `buffer` (12 N + 15,)."""
    N = (buffer.size - _GIVEN[1]) // _GIVEN[0]
    M = N + 1
    x, y, rest = buffer[: 4 * M].reshape(M, 4), buffer[4 * M : 7 * M].reshape(M, 3), buffer[7 * M :]
    u_star, u, d = rest[: 2 * N].reshape(N, 2), rest[2 * N : 4 * N].reshape(N, 2), rest[4 * N : 5 * N]
    return Given(rest[5 * N : 5 * N + 4], u, d, Reference(x, y, u_star), rest[5 * N + 4 :].reshape(2, 2))


@inlined
def path_in(buffer: Array) -> tuple[Path, Array]:
    """Return a path and its commands (N, 2) [bar]: views into `buffer` (45 N + 19,)."""
    N = (buffer.size - _PATH[1]) // _PATH[0]
    M = N + 1
    x, y = buffer[: 4 * M].reshape(M, 4), buffer[4 * M : 7 * M].reshape(M, 3)
    slope, rest = buffer[7 * M : 19 * M].reshape(M, 3, 4), buffer[19 * M :]
    A, B = rest[: 16 * N].reshape(N, 4, 4), rest[16 * N : 24 * N].reshape(N, 4, 2)
    return Path(x, y, A, B, slope), rest[24 * N : 26 * N].reshape(N, 2)


def lengths(N: int) -> tuple[int, int]:
    """Return the lengths of the buffers of a `Given` and of a path."""
    return _GIVEN[0] * N + _GIVEN[1], _PATH[0] * N + _PATH[1]
