"""Records of an observer's compiled sample: names and shapes of its constants, its memory and its working arrays.

Shapes are expressions of the numbers of joints n and muscles m. Compiled code finds the whole record by its address,
and its fields by their names (`mpc.codegen.records`).
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.records import Piece, new_records, numbers_of, piece_of


class Belief:
    """Numbers of a `mpc.observer.filter.Belief`."""

    xi: Annotated[Array, "3 * n + m"]
    covariance: Annotated[Array, "3 * n + m", "3 * n + m"]


class Known:
    """Constants of `mpc.observer.filter.Filter`, its gates and the diagnosis."""

    inner: Annotated[Array, 2, "2 * n + m"]  # range of states for which the muscle models are valid
    outer: Annotated[Array, 2, "3 * n + m"]  # range of possible ξ
    Q: Annotated[Array, "3 * n + m", "3 * n + m"]
    Q_rest: Annotated[Array, "n + m", "3 * n + m", "3 * n + m"]  # by repeating sensor
    possible: Annotated[Array, 2, "n + m"]  # readings
    dt: float  # [s]
    h: float  # step of the integration [s]
    substeps: int
    tolerance: float  # [s]
    dead_band: float  # [Pa]
    older: float  # readings of angles beyond whole samples [s]
    reach: Annotated[Array, 2, "m"]  # see `Filter.reach` [Pa]
    share: Annotated[Array, "m"]  # of a step that a regulator follows in a sample [-]
    shares: Annotated[Array, 2, "m"]  # the same of quick and of slow ones
    learning: float  # change of an offset per sample and innovation [-]
    most_offset: float  # [Pa]
    theta_noise: float  # [rad]
    theta_floor: Annotated[Array, "n"]  # [rad]
    sigma: float  # [Pa]
    seen: Annotated[Array, "m"]  # of `Sound`, as the next nine
    quick: Annotated[Array, "m"]
    slow: Annotated[Array, "m"]
    quick_down: Annotated[Array, "m"]
    slow_down: Annotated[Array, "m"]
    quick_free: Annotated[Array, "m"]
    slow_free: Annotated[Array, "m"]
    most_quick: Annotated[Array, "m"]
    most_slow: Annotated[Array, "m"]
    swelling: Annotated[Array, "m"]
    usual: Annotated[Array, "n"]  # [N·m]
    inertia: Annotated[Array, "n"]  # [kg·m²]


class State:
    """Memory of `mpc.observer.kalman.KalmanObserver` except its `Tail`."""

    belief: Belief
    without: Annotated[list[Belief], "n + m"]  # one for each sensor that repeats itself
    variances: Annotated[Array, "n + m"]  # of the sensors
    floor: Annotated[Array, "n + m"]  # of the gates
    read: Annotated[Array, "n + m"]
    offset: Annotated[Array, "m"]  # of the pressures' sensors [Pa]
    apart: Annotated[Array, 2, "m"]  # of quick and slow regulators from the model's [Pa]
    repeating: Annotated[Array, "n + m"]  # [s]
    repeats: Annotated[Array, "n + m"]  # whether there is a belief without the sensor
    step: Annotated[Array, "n"]  # of the encoders [rad]
    angle: Annotated[Array, "n"]  # last angles of the frictions' memories [rad]
    samples: float  # since the state was last given back
    t: float  # of the diagnosis [s]
    last: Annotated[Array, "n"]  # its last angles [rad]
    lost: Annotated[Array, "n + m"]  # [s]
    said: Annotated[Array, "n + m"]
    found: Annotated[Array, "n + m"]  # whether a sensor is suspected
    large: Annotated[Array, "m"]  # time since which an offset is large [s]


class Work:
    """Working arrays."""

    near: Annotated[Array, "2 * n + m"]  # the nearest state for which the muscle models are valid
    inside: Annotated[Array, "3 * n + m"]  # the nearest possible ξ
    acting: Annotated[Array, "m"]  # commands after dead band and flow, see `Filter.acting` [Pa]
    torque: Annotated[Array, "n"]  # disturbance minus friction [N·m]
    loads: Annotated[Array, "n", 3]  # on the sliding surfaces of each joint
    pulls: Annotated[Array, "2 * m * n + m"]  # see `mpc.observer.pulling`
    read_as: Annotated[Array, "m"]  # readings that the acting commands lead to [Pa]
    taken: Annotated[Array, "n + m"]  # readings without the offsets
    gain: Annotated[Array, "3 * n + m"]
    S: Annotated[Array, "3 * n + m", "3 * n + m + 1"]  # Jacobian of a sample by ξ, and the state at its end
    at: Annotated[Array, "2 * n + m", "3 * n + m + 1"]  # the same at intermediate stages, with slope and their sum
    slope: Annotated[Array, "2 * n + m", "3 * n + m + 1"]
    total: Annotated[Array, "2 * n + m", "3 * n + m + 1"]
    product: Annotated[Array, "3 * n + m", "3 * n + m"]
    ahead: Belief  # present belief; that of the state belongs to the time of the angle's reading


class Places:
    """Places of all numbers of a `State`, of its whole `Tail`, and of the fields of the tail."""

    state: Piece
    tail: Piece
    memories: Annotated[list[Piece], "n"]
    commands: Piece
    held: Piece
    parts: Annotated[list[Piece], "m + 1 + n"]


class Tail(NamedTuple):
    """Memory beyond a `State`: arrays whose lengths differ between observers."""

    memories: Sequence[Array]  # of each joint's friction
    commands: Array  # (delay + age + 1, m) [Pa]
    held: Array  # (age + 1, m) readings of pressures, kept until the angles of the same time arrive [Pa]
    parts: Sequence[Array]  # numbers of the parts of `mpc.observer.diagnosis.Diagnosis`


class Sample:
    """Whole record, including a copy of the previous sample's state."""

    known: Known
    now: State
    past: State
    work: Work
    places: Places  # of the present state
    past_places: Places
    c: Piece  # numbers of the formulas
    decay: Piece  # (substeps, 3, m) of an arm, see `mpc.tracking.compiled.arm.module`
    frictions: Annotated[list[Piece], "n"]  # numbers of `mpc.model.compiled_friction`


class Numbers(NamedTuple):
    """Numbers of the formulas and models of one observer."""

    c: Array
    decay: Array
    frictions: Sequence[Array]


class Made(NamedTuple):
    """Data of one observer's compiled samples."""

    records: Any  # (1,), one `Sample`
    tail: Tail
    kept: tuple[Array, ...]  # kept alive while the records have their addresses

    def take(self, other: "Made") -> None:
        """Copy the state of another one of the same sizes."""
        self.records["now"], self.kept[0][...] = other.records["now"], other.kept[0]


def made(known: Mapping[str, object], numbers: Numbers, sizes: Sequence[int], n: int, m: int) -> Made:
    """Return the data of a sample with these constants and `numbers`, and the `sizes` (2n + m + 3,) of a `Tail`."""
    records, ends = new_records(Sample, n=n, m=m), [*accumulate(sizes, initial=0)]
    flat, past = np.full((2, ends[-1]), np.nan)
    record = records[0]
    for name, value in known.items():
        record.known[name] = value
    record.c, record.decay = piece_of(numbers.c), piece_of(numbers.decay)
    record.frictions = [piece_of(one) for one in numbers.frictions]

    def divided(array: Array) -> Tail:
        parts = [array[first:last] for first, last in pairwise(ends)]
        return Tail(parts[:n], parts[n], parts[n + 1], parts[n + 2 :])

    for places, state, array in (("places", "now", flat), ("past_places", "past", past)):
        memories, commands, held, parts = divided(array)
        fields = ([*map(piece_of, memories)], piece_of(commands), piece_of(held), [*map(piece_of, parts)])
        record[places] = (numbers_of(records, state), piece_of(array), *fields)
    tail = divided(flat)
    tail = tail._replace(commands=tail.commands.reshape(-1, m), held=tail.held.reshape(-1, m))
    return Made(records, tail, (flat, past, numbers.c, numbers.decay, *numbers.frictions))
