"""These are the flat values that a compiled closed loop works on: what is known, and what is remembered.

They are filled from the readable parts by `mpc.trials.many.taken`, whose names they have.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array


class Plant(NamedTuple):
    """A `Plant` is the plant under test, see `mpc.trials.many.process`."""

    c: Array
    durations: Array
    substeps: int
    sensors: Array
    full: Array
    waiting: Array
    noise: Array  # (M, 2)
    torques: Array  # (M,)


class Known(NamedTuple):
    """What is known of a `mpc.tracking.controller.TrackingMPC`."""

    c: Array  # numbers of the formulas
    lower: Array  # (4,) of a state that counts as measured
    upper: Array  # (4,)
    delay: int
    frictionless: bool
    rests: bool
    dead_band: float  # [Pa]
    limits: tuple[float, ...]  # (6,) least and greatest pressure, step [Pa], joint range [rad], least force [N]
    resting: Array  # (8,), see `mpc.trials.many.rest`


class Step(NamedTuple):
    """What the compiled step takes, see `mpc.tracking.compiled.sample.arrays`."""

    settle: int  # address of the QP's solution
    c: Array
    h: float
    substeps: int
    numbers: Array
    starts: NDArray[np.int64]
    given: Array
    buffer: Array
    guess: NDArray[np.int8]
    shifted: NDArray[np.intp]
    z: Array
    p: Any
    known: Array
    slopes: Array
    out: Array


class Memory(NamedTuple):
    """What preview, ladder and rest mode of a controller remember."""

    waiting: Array  # (delay, 2) commands as they will act [Pa]
    sent: Array  # (2,) [Pa]
    expected: Array  # (1,) angle [rad]
    memory: Array  # of friction
    theta: Array  # (1,) that it has followed to [rad]
    u: Array  # (N, 2) the last plan [Pa]
    u_star: Array  # (2,) [Pa]
    rest: Array  # numbers of the rest mode, see `mpc.trials.many.rest`
    reference: Array  # (2,) that stands still
    p: Array  # (2,) pressures that are held [Pa]
    quarters: Array  # (4, 5)
    total: Array  # (3,)


class Answers(NamedTuple):
    """What is recorded of M samples: see `mpc.trials.simulation.Run`."""

    x: Array  # (M+1, 4)
    estimate: Array  # (M, 5)
    u: Array  # (M, 2)
    rung: NDArray[np.int64]
    status: NDArray[np.int64]
    slack: Array
    slack_force: Array
    moved: Array  # (M, 3)
