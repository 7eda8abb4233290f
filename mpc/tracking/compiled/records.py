"""What the compiled functions hand to each other. Commands count in bar here, as the decisions do."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array


class Cost(NamedTuple):
    """The weights."""

    theta: float
    omega: float
    K: float
    u: float  # [cost]/[bar]²
    change: float  # of e_k - e_{k-1} [cost]/[bar]²
    end: Array  # (6, 6) of ξ = (x_N - x*_N, e_{N-1})


class Room(NamedTuple):
    """The limits, as `mpc.tracking.limits.Limits`."""

    low: float  # supply [bar]
    high: float  # [bar]
    step: float  # [bar]
    left: float  # joint range [rad]
    right: float  # [rad]
    min_force: float  # [N]


class Setting(NamedTuple):
    """What does not change from step to step."""

    cost: Cost
    room: Room
    tolerance: float  # of rows left out [bar], [rad], [N]
    accuracy: float  # of an answer [bar]
    starts: NDArray[np.int64]  # samples at which the commands may leave ū


class Path(NamedTuple):
    """A motion and the linear model about it."""

    x: Array  # (N+1, 4)
    y: Array  # (N+1, 3): K, F1, F2
    A: Array  # (N, 4, 4)
    B: Array  # (N, 4, 2) per bar
    slope: Array  # (N+1, 3, 4) of y


class Wish(NamedTuple):
    """What is to be followed, as `mpc.tracking.feedforward.FeedForward`; time runs along the first axis."""

    theta: Array  # (N+1,)
    omega: Array  # (N+1,)
    K: Array  # (N+1,)
    P: Array  # (N+1, 2) [Pa]
    u: Array  # (N, 2) [Pa]


class Errors(NamedTuple):
    """What the cost charges for: deviations from the wish along a path."""

    theta: Array  # (N+1,)
    omega: Array  # (N+1,)
    K: Array  # (N+1,)
    e: Array  # (N, 2) of the commands [bar]
    change: Array  # (N, 2) e_k - e_{k-1} [bar]
    end: Array  # (6,) ξ


__all__ = ["Cost", "Errors", "Path", "Room", "Setting", "Wish"]
