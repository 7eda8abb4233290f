"""The layout says what lies where in the flat arrays of a sample, for Python and for compiled code.

asked  what a caller asks: the state, the torque from outside, previews over the dead time and the horizon
out    what a sample makes: a plan, what is said of it, and what the controller remembers; NaN where nothing is yet
known  what is known of the plant, and does not change
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.addresses import floats_at, integers_at, signs_at
from mpc.codegen.jit import inlined

_ASKED, _STATE, _TAIL = 5, 11, 8


class Asked(NamedTuple):
    """Asked is what `mpc.tracking.base.BaseController.step` is given."""

    x: Array  # (4,) measured
    d: Array  # (1,) [N·m]
    theta: Array  # (ahead + 1,) [rad]
    K: Array  # (ahead + 1,) [N·m/rad]
    torques: Array  # (ahead + 1,) from outside and of friction, to be filled in [N·m]


class Inputs(NamedTuple):
    """The inputs are all that the compiled step works on; most of it never changes."""

    c: Array  # numbers of the formulas
    p: Array  # of the kernel
    known: Array
    slopes: Array  # (2, N+1, N+1) of the feed-forward
    friction: Array  # see `mpc.model.compiled_friction`
    numbers: Array  # of the setting, as what follows: see `mpc.tracking.compiled.flat_records`
    asked: Array
    given: Array
    buffer: Array
    z: Array  # (n,) decisions
    work: Array  # (6 m + 4,) room for m samples of delay
    starts: Any  # (blocks,) integers
    counted: Any  # (1,) iterations of the interior point
    guess: Any  # (n,) signs
    kept: Any  # (n,) room for them
    settle: int  # addresses, see `mpc.tracking.compiled.sample.calls`
    clock: int
    name: int


class State(NamedTuple):
    """The state is what `Ladder`, `Preview`, `RestMode` and `FrictionState` remember."""

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
    tail: Array  # (8,) slack [rad], slack of forces [N], `Moved` (3,), times of feed-forward, linearising, solving [s]


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
    """Return the lengths of `asked`, of the plan in `out`, and of `out`."""
    plan: int = _python(length_of)(N)
    return _ASKED + 3 * (N + delay + 1), plan, plan + _STATE + memory + 2 * delay


@inlined
def length_of(N: int) -> int:
    """Return the length of a plan."""
    return 4 * N + 7 * (N + 1) + _TAIL


def table_of(inputs: Inputs) -> Array:
    """Return where all `inputs` lie, which compiled code is told by one address: (address, length) of arrays, numbers.

    Raises a `TypeError` for an array that does not lie there as it is read.
    """
    table: list[int] = []
    kinds = 11 * (np.float64,) + 2 * (np.int64,) + 2 * (np.int8,)
    for array, kind in zip(inputs[:15], kinds, strict=True):
        if array.dtype != kind or not (array.flags.c_contiguous and array.flags.aligned):
            raise TypeError(f"numbers of the kind {array.dtype} are not {kind.__name__} in one piece")
        table += [array.ctypes.data, array.size]
    return np.array([*table, *inputs[15:]], np.int64)


@inlined
def inputs_at(table: int) -> Inputs:
    """Return the inputs of the `table_of` them that stands at this address."""
    t = integers_at(table, 33)
    return Inputs(
        floats_at(t[0], t[1]), floats_at(t[2], t[3]), floats_at(t[4], t[5]), floats_at(t[6], t[7]),
        floats_at(t[8], t[9]), floats_at(t[10], t[11]), floats_at(t[12], t[13]), floats_at(t[14], t[15]),
        floats_at(t[16], t[17]), floats_at(t[18], t[19]), floats_at(t[20], t[21]), integers_at(t[22], t[23]),
        integers_at(t[24], t[25]), signs_at(t[26], t[27]), signs_at(t[28], t[29]), t[30], t[31], t[32],
    )  # fmt: skip


@inlined
def asked_in(asked: Array) -> Asked:
    """Return views into `asked`."""
    n = (asked.size - _ASKED) // 3
    previews = asked[_ASKED:]
    return Asked(asked[0:4], asked[4:5], previews[:n], previews[n : 2 * n], previews[2 * n : 3 * n])


@inlined
def state_in(out: Array, N: int, plan: int, memory: int) -> State:
    """Return views into `out`, in which a `plan` has so many numbers, and friction `memory`."""
    u, state = out[: 2 * N].reshape(N, 2), out[plan:]
    felt, rest = state[_STATE : _STATE + memory], state[_STATE + memory :]
    waiting = rest.reshape(rest.size // 2, 2)
    return State(state[0:2], state[2:4], state[4:8], state[8:9], state[9:11], felt, waiting, u)


@inlined
def made_in(out: Array) -> Made:
    """Return views into the plan in `out`, which has nothing else."""
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


def state_of(out: Array, N: int, plan: int, memory: int) -> State:
    """Return views into `out`, in Python."""
    return _python(state_in)(out, N, plan, memory)  # type: ignore[no-any-return]


def made_of(out: Array) -> Made:
    """Return views into the plan in `out`, which has nothing else, in Python."""
    return _python(made_in)(out)  # type: ignore[no-any-return]


def _python(views: Any) -> Any:
    return views.py_func


def known_of(known: Known) -> Array:
    """Return the numbers (22,) of `known`."""
    return np.hstack(known).astype(float)
