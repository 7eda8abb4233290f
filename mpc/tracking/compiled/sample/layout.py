"""Layout of the flat arrays of a sample, for Python and for compiled code.

asked  the caller's arguments: state, external torque, previews over the dead time and the horizon
out    the results of a sample: a plan, its properties, and the controller's memory; NaN before the first sample
known  constants of the plant
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.codegen.views import in_python, length_of, measure, opened, viewer
from mpc.model.plant import NU
from mpc.tracking import resting
from mpc.tracking.rest_memory import Memory, Rules


class Asked(NamedTuple):
    """Arguments of `mpc.tracking.base.BaseController.step`."""

    x: Annotated[Array, 4]  # measured
    d: Annotated[Array, 1]  # [N·m]
    theta: Annotated[Array, "ahead + 1"]  # [rad]
    K: Annotated[Array, "ahead + 1"]  # [N·m/rad]
    torques: Annotated[Array, "ahead + 1"]  # external and friction torques, to be filled in [N·m]


class Inputs(NamedTuple):
    """All arrays of the compiled step; most of them are constant."""

    c: Array  # numbers of the formulas
    p: Array  # of the kernel
    known: Array
    slopes: Array  # (2, N+1, N+1) of the feed-forward
    friction: Array  # see `mpc.model.compiled_friction`
    numbers: Array  # of the setting, like the next two: see `mpc.tracking.compiled.records`
    asked: Array
    given: Array
    buffer: Array
    z: Array  # (n + 1,) decisions, and the bound of their suboptimality
    work: Array  # (6 m + 4,) room for m samples of delay
    starts: NDArray[np.int64]  # (blocks,)
    counted: NDArray[np.int64]  # (1,) exchanges
    guess: NDArray[np.int8]  # (n,)
    kept: NDArray[np.int8]  # (n,) room for the guess
    settle: int  # addresses, see `mpc.tracking.compiled.sample.calls`
    clock: int
    name: int


class State(NamedTuple):
    """State of `Ladder`, `Preview`, `RestMode` and `FrictionState`."""

    u: Array  # (N, 2) the last plan's commands as they should act, a view into that plan [Pa]
    u_star: Annotated[Array, 2]  # the feed-forward of the previous sample [Pa]
    sent: Annotated[Array, 2]  # [Pa]
    expected: Annotated[Array, 4]  # the state predicted for now
    angle: Annotated[Array, 1]  # origin of the motion in the friction's memory [rad]
    rest: Annotated[Array, resting.size(1, NU)]  # numbers of `mpc.tracking.resting`
    memory: Annotated[Array, "n"]  # of friction
    waiting: Annotated[Array, "m", 2]  # commands as they will act, oldest first [Pa]


class Made(NamedTuple):
    """Plan made by a sample."""

    u: Annotated[Array, "N", 2]  # commands as they should act [Pa]
    sent: Annotated[Array, "N", 2]  # commands to send [Pa]
    x: Annotated[Array, "N + 1", 4]
    K: Annotated[Array, "N + 1"]
    F: Annotated[Array, "N + 1", 2]
    slack: Annotated[Array, 2]  # of the angle [rad], of forces [N]
    moved: Annotated[Array, 3]  # see `mpc.tracking.plan.Moved`
    times: Annotated[Array, 3]  # of feed-forward, linearising, solving [s]
    rests: Annotated[Array, 1]  # whether pressures are held


class Known(NamedTuple):
    """Numbers of the plant, the sample time and the gate of a measured state."""

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
    lower: Annotated[Array, 4]
    upper: Annotated[Array, 4]
    dead_band: float  # [Pa]
    rests: bool  # whether commands come to rest at a constant reference
    rules: Rules
    corrected: float  # [-] of an angle error counts as motion that friction opposes


asked_in: Callable[[Array], Asked] = viewer(Asked)
memory_in: Callable[[Array, int, int], Memory] = inlined(resting.memory_in)
inputs_at: Callable[[int], Inputs] = opened(Inputs)
known_in: Callable[[Array], Known] = viewer(Known)
made_in: Callable[[Array], Made] = viewer(Made)
state_in: Callable[[Array, Array, int, int], State] = viewer(State)
plan_length: Callable[[int], int] = measure(Made)
asked_of, made_of = in_python(asked_in), in_python(made_in)


def lengths(N: int, delay: int, memory: int) -> tuple[int, int, int]:
    """Return the lengths of `asked`, of the plan in `out`, and of `out`."""
    plan = length_of(Made, N)
    return length_of(Asked, N + delay), plan, plan + length_of(State, memory, delay)


def state_of(out: Array, plan: int, memory: int, delay: int) -> State:
    """Return views into `out`, for so many entries of `plan` and friction `memory`, and `delay` waiting commands."""
    return in_python(state_in)(out[plan:], made_of(out[:plan]).u, memory, delay)
