"""Layout of the flat arrays of a sample; `mpc.tracking.compiled.sample.views` opens them for the sizes of a machine.

asked  the caller's arguments: state, external torque, previews over the dead time and the horizon
out    the results of a sample: a plan, its properties, and the controller's memory; NaN before the first sample
known  constants of the plant
room   working arrays
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.tables import opened
from mpc.codegen.views import viewer
from mpc.tracking.rest_memory import Rules


class Asked(NamedTuple):
    """Arguments of `mpc.tracking.base.BaseController.step`; previews are flat."""

    x: Annotated[Array, "x"]  # measured
    d: Annotated[Array, "n"]  # [N·m]
    theta: Annotated[Array, "(ahead + 1) * n"]  # [rad]
    K: Annotated[Array, "(ahead + 1) * kk"]  # [N·m/rad]
    torques: Annotated[Array, "(ahead + 1) * n"]  # external and friction torques, to be filled in [N·m]


class Inputs(NamedTuple):
    """All arrays of the compiled step; most of them are constant."""

    c: Array  # numbers of the formulas
    p: Array  # of the kernel
    decay: Array  # of an arm, see `mpc.tracking.compiled.arm.step`; empty for a joint
    inverse: Array  # numbers of the feed-forward
    slopes: Array  # (2, N+1, N+1) of the feed-forward
    turned: Array  # of the feed-forward of a hand, see `mpc.tracking.compiled.arm.feedforward`; else empty
    known: Array
    friction: Array  # of every joint, see `mpc.model.compiled_friction`
    gains: Array  # of a controller in closed form, see `Gains`
    numbers: Array  # of the setting, like the next two: see `mpc.tracking.compiled.records`
    asked: Array
    given: Array
    buffer: Array
    z: Array  # (n + 1,) decisions, and the bound of their suboptimality
    room: Array
    targets: Array  # of an arm's allocation, see `mpc.tracking.compiled.arm.records`; otherwise empty
    starts: NDArray[np.int64]  # (blocks,)
    counted: NDArray[np.int64]  # (1,) exchanges
    rounds: NDArray[np.int64]  # of an arm's allocation, like `side`
    guess: NDArray[np.int8]  # (n,)
    kept: NDArray[np.int8]  # (n,) room for the guess
    side: NDArray[np.int8]
    settle: int  # addresses, see `mpc.tracking.compiled.sample.calls`
    allocate: int  # of an arm's allocation and its arguments, for one target or for all; 0 otherwise
    allocate_one: int
    allocate_all: int
    prove: int
    prove_one: int
    prove_all: int
    rubbed: int  # stages of the step, 0 without friction, without rests, and with a QP
    rested: int
    fed_back: int
    closed: int
    clock: int
    name: int


class Gains(NamedTuple):
    """Gains of a controller in closed form; those that it lacks are 0. See `mpc.yardsticks.baselines`."""

    proportional: float  # [N·m/rad]
    integral: float  # [N·m/rad/s]
    derivative: float  # [N·m·s/rad]
    share: float  # of a sample's slope in the filtered one [-]
    predicted: bool  # whether the errors are those at the end of the dead time
    dt: float  # [s]
    state: Annotated[Array, "m", "xi"]  # of (x - x*, e), in SI units


class Fed(NamedTuple):
    """Memory of a controller in closed form."""

    integral: Annotated[Array, 1]  # [rad·s]
    slope: Annotated[Array, 1]  # filtered [rad/s]
    error: Annotated[Array, 1]  # [rad]
    saturated: Annotated[Array, 1]  # whether a limit is active
    e: Annotated[Array, "m"]  # the last command minus its feed-forward [Pa]


class State(NamedTuple):
    """State of `Ladder`, `Preview`, `RestMode` and `FrictionState`."""

    u: Array  # (N, m) the last plan's commands as they should act, a view into that plan [Pa]
    u_star: Annotated[Array, "m"]  # the feed-forward of the previous sample [Pa]
    sent: Annotated[Array, "m"]  # [Pa]
    expected: Annotated[Array, "x"]  # the state predicted for now
    angle: Annotated[Array, "n"]  # origins of the motion in the frictions' memories [rad]
    rest: Annotated[Array, "rest"]  # numbers of `mpc.tracking.resting`
    fed: Fed
    memory: Annotated[Array, "n", "springs"]  # of friction
    waiting: Annotated[Array, "delay", "m"]  # commands as they will act, oldest first [Pa]


class Made(NamedTuple):
    """Plan made by a sample."""

    u: Annotated[Array, "N", "m"]  # commands as they should act [Pa]
    sent: Annotated[Array, "N", "m"]  # commands to send [Pa]
    x: Annotated[Array, "N + 1", "x"]
    K: Annotated[Array, "N + 1", "s"]  # svec
    F: Annotated[Array, "N + 1", "m"]
    slack: Annotated[Array, 2]  # of the angle [rad], of forces [N]
    moved: Annotated[Array, 3]  # see `mpc.tracking.plan.Moved`
    times: Annotated[Array, 3]  # of feed-forward, linearising, solving [s]
    rests: Annotated[Array, 1]  # whether pressures are held


class Known(NamedTuple):
    """Constants of a controller, and the gate of a measured state."""

    h: float  # step of the integration [s]
    substeps: int
    lower: Annotated[Array, "x"]
    upper: Annotated[Array, "x"]
    dead_band: float  # [Pa]
    rules: Rules  # of the rest mode
    corrected: float  # [-] of an angle error counts as motion that friction opposes


class Room(NamedTuple):
    """Working arrays."""

    loads: Annotated[Array, "n", 3]  # on the sliding surfaces of each joint
    held: Annotated[Array, "x"]  # state at the correction of a rest
    stiffness: Annotated[Array, "n * n"]  # there, and the slopes ∂T/∂P
    gains: Annotated[Array, "n * m"]
    factor: Annotated[Array, "kk"]  # of a stiffness
    y: Annotated[Array, "y"]  # outputs of a state
    path: Annotated[Array, "delay + 1", "x"]  # motion until a command acts
    waiting: Annotated[Array, "delay", "m"]  # commands under way [bar]


class JointInverse(NamedTuple):
    """Numbers of a joint's `mpc.tracking.feedforward.InverseDynamics`."""

    inertia: float
    damping: float
    gravity: float  # torque [N·m]
    hanging: float  # angle [rad]
    up1: float  # lags of rising and of falling pressures [s]
    up2: float
    down1: float
    down2: float
    kept_up1: float  # α of each
    kept_up2: float
    kept_down1: float
    kept_down2: float
    left: float  # joint range [rad]
    right: float
    min_force: float  # [N]
    dt: float  # [s]


inputs_at: Callable[[int], Inputs] = opened(Inputs)
joint_inverse_in: Callable[[Array], JointInverse] = viewer(JointInverse)
