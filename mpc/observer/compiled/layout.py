"""The layout says what lies where in the flat arrays of an observer, for Python and for compiled code.

known  what does not change, and the numbers of the formulas
state  what is remembered from sample to sample, places to reckon in, and all of it once more as it was a sample ago
asked  what a caller asks: readings y (4,), and the command u (2,) sent last

A belief is ξ (5,) and its covariance (5, 5), row by row. Compiled code takes numbers by their places: a record of views
would take numba longer to compile than all the rest.
"""

from collections.abc import Iterator
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array

ASKED = 6
SIZE, MEASURED = 5, (0, 2, 3)  # of ξ, and of it the places of what is measured
COVARIANCE, BELIEF = 5, 30  # in a belief, and the length of one


class Known(NamedTuple):
    """What is known of `mpc.observer.filter.Filter`, its gates and the diagnosis."""

    inner: Array  # (2, 4) states for which the muscles' laws are made
    outer: Array  # (2, 5) ξ that is possible
    Q: Array  # (5, 5)
    Q_rest: Array  # (5, 5)
    possible: Array  # (2, 3) readings
    dt: float  # [s]
    h: float  # step of the integration [s]
    substeps: float
    tolerance: float  # [s]
    dead_band: float  # [Pa]
    theta_noise: float  # [rad]
    theta_floor: float  # [rad]
    sigma: float  # [Pa]
    seen: float  # of `Sound`, as the next two
    quick: Array  # (2,)
    slow: Array  # (2,)
    usual: float  # [N·m]
    places: Array  # (5,) in the state: of COMMANDS, ONE, TWO, TORQUE and its length
    friction_at: float  # place of `friction`
    numbers: Array  # of the formulas
    friction: Array  # numbers of `mpc.model.compiled_friction`


(
    INNER, OUTER, Q, Q_REST, POSSIBLE, DT, H, SUBSTEPS, TOLERANCE, DEAD_BAND, THETA_NOISE, THETA_FLOOR, SIGMA, SEEN,
    QUICK, SLOW, USUAL, COMMANDS, ONE, TWO, TORQUE, LENGTH, FRICTION,
    NUMBERS,
) = accumulate((8, 10, 25, 25, 6, 1, 1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 1, 1, 1, 1, 1, 1, 1), initial=0)  # fmt: skip


class State(NamedTuple):
    """The state is what `mpc.observer.kalman.KalmanObserver` remembers."""

    belief: Array  # (30,)
    without: Array  # (3, 30) of a sensor each that repeats itself
    variances: Array  # (3,) of the sensors
    floor: Array  # (3,) of the gates
    read: Array  # (3,)
    repeating: Array  # (3,) [s]
    repeats: Array  # (3,) whether there is a belief without the sensor
    step: Array  # (1,) of the encoder [rad]
    angle: Array  # (1,) to which friction was followed [rad]
    samples: Array  # (1,) for which the state has not been given back
    t: Array  # (1,) of the diagnosis [s]
    last: Array  # (1,) its last angle [rad]
    lost: Array  # (3,) [s]
    said: Array  # (3,)
    found: Array  # (3,) whether a sensor is suspected
    memory: Array  # of friction
    commands: Array  # (delay + 1, 2) [Pa]
    one: Array  # numbers of `mpc.observer.pressure_diagnosis`
    two: Array
    torque: Array  # numbers of `mpc.observer.torque_diagnosis`


(
    XI, WITHOUT, VARIANCES, FLOOR, READ, REPEATING, REPEATS, STEP, ANGLE, SAMPLES, TIME, LAST, LOST, SAID, FOUND,
    NEAR, INSIDE, ACTING, GAIN, S, AT, K, TOTAL, PRODUCT, MEMORY,  # up to here places to reckon in
) = accumulate(
    (30, 90, 3, 3, 3, 3, 3, 1, 1, 1, 1, 1, 3, 3, 3, 4, 5, 2, 5, 30, 24, 24, 24, 25), initial=0
)  # fmt: skip


def places(memory: int, delay: int, pressure: int, torque: int) -> Array:
    """Return where commands and what the diagnoses remember lie in a state, and the length of it.

    They are (delay + 1, 2) commands, and as many numbers as friction, a `pressure` and the `torque` remember.
    """
    return np.cumsum([MEMORY + memory, 2 * (delay + 1), pressure, pressure, torque]).astype(float)


def known_of(known: Known) -> Array:
    """Return the numbers of `known`."""
    return np.concatenate([np.ravel(value) for value in known]).astype(float)


def state_of(flat: Array, at: Array) -> State:
    """Return views into a state with these `places`."""
    fixed = [*_slices(flat, (XI, WITHOUT, VARIANCES, FLOOR, READ, REPEATING, REPEATS, STEP, ANGLE, SAMPLES, TIME, LAST,
                             LOST, SAID, FOUND, NEAR))]  # fmt: skip
    rest = [*_slices(flat, (MEMORY, *at.astype(int).tolist()))]
    fixed[1], rest[1] = fixed[1].reshape(-1, BELIEF), rest[1].reshape(-1, 2)
    return State(*fixed, *rest)


def _slices(flat: Array, at: tuple[int, ...]) -> Iterator[Array]:
    """Yield the parts of `flat` between the places."""
    for first, last in pairwise(at):
        yield flat[first:last]
