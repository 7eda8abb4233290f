"""Flat records of a compiled closed loop, in addition to those of the compiled step and observer."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array


class Plant(NamedTuple):
    """Plant under test, see `mpc.trials.many.process`."""

    c: Array
    durations: Array
    steps: NDArray[np.int64]
    sensors: Array
    full: Array
    waiting: Array
    angles: Array  # (a, n)
    noise: Array  # (M, n + m)
    torques: Array  # (M, n)


class Answers(NamedTuple):
    """Record of M samples, see `mpc.trials.simulation.Run`."""

    x: Array  # (M+1, 4)
    estimate: Array  # (M, 5)
    u: Array  # (M, 2)
    rung: NDArray[np.int64]
    status: NDArray[np.int64]
    slack: Array
    slack_force: Array
    moved: Array  # (M, 3)
