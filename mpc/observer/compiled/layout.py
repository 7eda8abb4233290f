"""Records of an observer's compiled sample: names and shapes of its constants, its memory and its working arrays.

Compiled code finds the whole record by its address, and its fields by their names (`mpc.codegen.records`).
"""

from collections.abc import Mapping
from itertools import accumulate, pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.records import Piece, new_records, numbers_of, piece_of
from mpc.model.plant import NU

SIZE, MEASURED = 5, (0, 2, 3)  # of ξ, and the measured entries of ξ


class Belief:
    """Numbers of a `mpc.observer.filter.Belief`."""

    xi: Annotated[Array, SIZE]
    covariance: Annotated[Array, SIZE, SIZE]


class Known:
    """Constants of `mpc.observer.filter.Filter`, its gates and the diagnosis."""

    inner: Annotated[Array, 2, 4]  # range of states for which the muscle models are valid
    outer: Annotated[Array, 2, SIZE]  # range of possible ξ
    Q: Annotated[Array, SIZE, SIZE]
    Q_rest: Annotated[Array, SIZE, SIZE]
    possible: Annotated[Array, 2, 3]  # readings
    dt: float  # [s]
    h: float  # step of the integration [s]
    substeps: int
    tolerance: float  # [s]
    dead_band: float  # [Pa]
    learning: float  # change of an offset per sample and innovation [-]
    most_offset: float  # [Pa]
    theta_noise: float  # [rad]
    theta_floor: float  # [rad]
    sigma: float  # [Pa]
    seen: float  # of `Sound`, as the next two
    quick: Annotated[Array, 2]
    slow: Annotated[Array, 2]
    usual: float  # [N·m]
    inertia: float  # [kg·m²]


class State:
    """Memory of `mpc.observer.kalman.KalmanObserver` except its `Tail`."""

    belief: Belief
    without: Annotated[list[Belief], 3]  # one for each sensor that repeats itself
    variances: Annotated[Array, 3]  # of the sensors
    floor: Annotated[Array, 3]  # of the gates
    read: Annotated[Array, 3]
    offset: Annotated[Array, 2]  # of the pressures' sensors [Pa]
    repeating: Annotated[Array, 3]  # [s]
    repeats: Annotated[Array, 3]  # whether there is a belief without the sensor
    step: float  # of the encoder [rad]
    angle: float  # last angle of the friction's memory [rad]
    samples: float  # since the state was last given back
    t: float  # of the diagnosis [s]
    last: float  # its last angle [rad]
    lost: Annotated[Array, 3]  # [s]
    said: Annotated[Array, 3]
    found: Annotated[Array, 3]  # whether a sensor is suspected
    large: Annotated[Array, 2]  # time since which an offset is large [s]


class Work:
    """Working arrays."""

    near: Annotated[Array, 4]  # the nearest state for which the muscle models are valid
    inside: Annotated[Array, SIZE]  # the nearest possible ξ
    acting: Annotated[Array, 2]  # commands minus the dead band [Pa]
    taken: Annotated[Array, 3]  # readings without the offsets
    gain: Annotated[Array, SIZE]
    S: Annotated[Array, SIZE, SIZE + 1]  # Jacobian of a sample by ξ, and the state at its end
    at: Annotated[Array, 4, SIZE + 1]  # the same at intermediate stages, with its slope and the sum of slopes
    slope: Annotated[Array, 4, SIZE + 1]
    total: Annotated[Array, 4, SIZE + 1]
    product: Annotated[Array, SIZE, SIZE]
    ahead: Belief  # present belief; that of the state belongs to the time of the angle's reading


class Places:
    """Places of all numbers of a `State`, of its whole `Tail`, and of the fields of the tail."""

    state: Piece
    tail: Piece
    memory: Piece
    commands: Piece
    held: Piece
    one: Piece
    two: Piece
    torque: Piece
    loop: Piece


class Tail(NamedTuple):
    """Memory beyond a `State`: arrays whose lengths differ between observers."""

    memory: Array  # of friction
    commands: Array  # (delay + age + 1, 2) [Pa]
    held: Array  # (age + 1, 2) readings of pressures, kept until the angle of the same time arrives [Pa]
    one: Array  # numbers of `mpc.observer.pressure_diagnosis`
    two: Array
    torque: Array  # numbers of `mpc.observer.torque_diagnosis`
    loop: Array  # numbers of `mpc.observer.ringing`


class Sample:
    """Whole record, including a copy of the previous sample's state."""

    known: Known
    now: State
    past: State
    work: Work
    places: Places  # of the present state
    past_places: Places
    c: Piece  # numbers of the formulas
    friction: Piece  # numbers of `mpc.model.compiled_friction`


class Made(NamedTuple):
    """Data of one observer's compiled samples."""

    records: Any  # (1,), one `Sample`
    tail: Tail
    kept: tuple[Array, ...]  # kept alive while the records have their addresses

    def take(self, other: "Made") -> None:
        """Copy the state of another one of the same sizes."""
        self.records["now"], self.kept[0][...] = other.records["now"], other.kept[0]


def made(known: Mapping[str, object], c: Array, friction: Array, sizes: tuple[int, ...]) -> Made:
    """Return the data of a sample: the numbers `known`, the formulas' numbers `c`, and the `sizes` (7,) of a `Tail`."""
    records, ends = new_records(Sample), [*accumulate(sizes, initial=0)]
    flat, past = np.full((2, ends[-1]), np.nan)
    record = records[0]
    for name, value in known.items():
        record.known[name] = value
    record.c, record.friction = piece_of(c), piece_of(friction)
    for places, state, numbers in (("places", "now", flat), ("past_places", "past", past)):
        parts = (numbers[first:last] for first, last in pairwise(ends))
        record[places] = (numbers_of(records, state), piece_of(numbers), *map(piece_of, parts))
    memory, commands, held, *diagnoses = (flat[first:last] for first, last in pairwise(ends))
    pairs = commands.reshape(-1, NU), held.reshape(-1, NU)
    return Made(records, Tail(memory, *pairs, *diagnoses), (flat, past, c, friction))
