"""Records of an observer's compiled sample: name and shape of all that it knows, remembers and reckons with.

Compiled code finds the whole record by its address, and its fields by their names (`mpc.codegen.records`).
"""

from collections.abc import Mapping
from itertools import accumulate, pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.records import Piece, new_records, numbers_of, piece_of
from mpc.model.plant import NU

SIZE, MEASURED = 5, (0, 2, 3)  # of ξ, and of it the places of what is measured


class Belief:
    """The numbers of a `mpc.observer.filter.Belief`."""

    xi: Annotated[Array, SIZE]
    covariance: Annotated[Array, SIZE, SIZE]


class Known:
    """Constants of `mpc.observer.filter.Filter`, its gates and the diagnosis."""

    inner: Annotated[Array, 2, 4]  # states for which the muscles' laws are made
    outer: Annotated[Array, 2, SIZE]  # ξ that is possible
    Q: Annotated[Array, SIZE, SIZE]
    Q_rest: Annotated[Array, SIZE, SIZE]
    possible: Annotated[Array, 2, 3]  # readings
    dt: float  # [s]
    h: float  # step of the integration [s]
    substeps: int
    tolerance: float  # [s]
    dead_band: float  # [Pa]
    learning: float  # share of an innovation by which an offset moves in a sample
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
    """Numbers that `mpc.observer.kalman.KalmanObserver` remembers, but for its `Tail`."""

    belief: Belief
    without: Annotated[list[Belief], 3]  # of a sensor each that repeats itself
    variances: Annotated[Array, 3]  # of the sensors
    floor: Annotated[Array, 3]  # of the gates
    read: Annotated[Array, 3]
    offset: Annotated[Array, 2]  # of the pressures' sensors [Pa]
    repeating: Annotated[Array, 3]  # [s]
    repeats: Annotated[Array, 3]  # whether there is a belief without the sensor
    step: float  # of the encoder [rad]
    angle: float  # to which friction was followed [rad]
    samples: float  # for which the state has not been given back
    t: float  # of the diagnosis [s]
    last: float  # its last angle [rad]
    lost: Annotated[Array, 3]  # [s]
    said: Annotated[Array, 3]
    found: Annotated[Array, 3]  # whether a sensor is suspected
    large: Annotated[Array, 2]  # since when an offset is [s]


class Work:
    """Room to reckon in."""

    near: Annotated[Array, 4]  # the nearest state for which the muscles' laws are made
    inside: Annotated[Array, SIZE]  # the nearest ξ that is possible
    acting: Annotated[Array, 2]  # commands less the dead band [Pa]
    taken: Annotated[Array, 3]  # readings without the offsets
    gain: Annotated[Array, SIZE]
    S: Annotated[Array, SIZE, SIZE + 1]  # Jacobian of a sample by ξ, and the state at its end
    at: Annotated[Array, 4, SIZE + 1]  # the same on the way there, with its slope and the sum of slopes
    slope: Annotated[Array, 4, SIZE + 1]
    total: Annotated[Array, 4, SIZE + 1]
    product: Annotated[Array, SIZE, SIZE]
    ahead: Belief  # of now; the state is that of when the angle was read


class Places:
    """Places of all numbers of a `State`, of all of its `Tail`, and of the fields of that."""

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
    held: Array  # (age + 1, 2) readings of pressures until an angle as old comes [Pa]
    one: Array  # numbers of `mpc.observer.pressure_diagnosis`
    two: Array
    torque: Array  # numbers of `mpc.observer.torque_diagnosis`
    loop: Array  # numbers of `mpc.observer.ringing`


class Sample:
    """The whole record; the state is there once more as it was a sample ago."""

    known: Known
    now: State
    past: State
    work: Work
    places: Places  # of now
    past_places: Places
    c: Piece  # numbers of the formulas
    friction: Piece  # numbers of `mpc.model.compiled_friction`


class Made(NamedTuple):
    """All that one observer's compiled samples work on."""

    records: Any  # (1,), one `Sample`
    tail: Tail
    kept: tuple[Array, ...]  # alive, as long as the records have their addresses

    def take(self, other: "Made") -> None:
        """Take the state of another one of the same sizes."""
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
