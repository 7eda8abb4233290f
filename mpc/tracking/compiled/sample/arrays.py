"""Arrays of the compiled step, and its call."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.addresses import clock, entry_of
from mpc.codegen.tables import table_of
from mpc.codegen.views import flat, in_python, length_of
from mpc.model.compiled_friction import ABSENT, NO_FRICTION, memory_of, rubbing_in
from mpc.tracking.compiled.records import Bounds, Cost, Given, Setting
from mpc.tracking.compiled.sample.calls import stage_of
from mpc.tracking.compiled.sample.layout import Asked, Gains, Inputs, JointInverse, Known, Made, Room, State
from mpc.tracking.compiled.sample.stages import FEED, LINEARISE, ROLLOUT
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.preview import CORRECTED
from mpc.tracking.rest_memory import Rules

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import CompiledPlant
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP

_CLOCK = clock()
_KINDS = "(int64, int64, float64[::1], float64[::1], float64[:], float64[:], float64[:])"


class Allocating(NamedTuple):
    """Memory of an arm's allocation and the addresses for its calls: `mpc.tracking.compiled.arm.inverse_dynamics`."""

    targets: Array  # see `mpc.tracking.compiled.arm.records.ArmTargets`
    side: NDArray[np.int8]
    rounds: NDArray[np.int64]
    calls: tuple[int, int, int, int, int, int]  # as in `Inputs`
    kept: tuple[object, ...]  # everything else at these addresses


_NO_ALLOCATION = Allocating(np.zeros(0), np.zeros(0, np.int8), np.zeros(0, np.int64), (0, 0, 0, 0, 0, 0), ())


class Feeding(NamedTuple):
    """Arrays of a feed-forward."""

    inverse: Array  # numbers
    slopes: tuple[Array, Array]  # (N+1, N+1) derivatives of a preview
    turned: Array  # see `Inputs`
    allocating: Allocating = _NO_ALLOCATION  # of an arm


def feeding_of(readable: InverseDynamics) -> Feeding:
    """Return the arrays of a joint's feed-forward."""
    plant, lags, kept = readable.plant, readable.lags.ravel().tolist(), readable.alpha.ravel().tolist()
    dynamics, ends = (plant.inertia, plant.damping, plant.gravity_torque, plant.hanging_angle), plant.joint.angle_range
    numbers: list[float] = [*dynamics, *lags, *kept, *ends, readable.min_force, readable.dt]
    return Feeding(flat(JointInverse(*numbers)), readable.slopes, np.zeros(0))


class Closed(NamedTuple):
    """Constants of a controller in closed form."""

    bounds: Bounds
    gains: Gains


class Beyond(NamedTuple):
    """Gate of a measured state, and constants of the compensation, the rest mode and a controller without a QP."""

    gate: tuple[Array, Array]  # (2n + m,) least and greatest values
    friction: Array  # numbers (n, …), see `mpc.model.compiled_friction`
    delay: int  # [samples]
    dead_band: float  # [Pa]
    rests: bool  # whether commands come to rest at a constant reference
    rules: Rules  # of that
    closed: Closed | None = None


class _Unused(NamedTuple):
    """Arrays in the place of those of a structured QP."""

    arrays: tuple[Array, NDArray[np.int64], Array, Array]
    given: Given
    answer: Array
    guess: NDArray[np.int8]
    counted: NDArray[np.int64]
    address: int


class StepArrays:
    """Arrays of one controller of N samples; two threads must not use them at the same time.

    Without the `structured` QP they serve only the feed-forward, without `feeding` everything else. A whole step needs
    both, and what is known `beyond` the model.
    """

    def __init__(
        self,
        plant: "CompiledPlant",
        N: int,
        structured: "StructuredQP | None" = None,
        feeding: Feeding | None = None,
        beyond: Beyond | None = None,
    ) -> None:
        sizes: dict[str, int] = plant.step.SIZES
        beyond = beyond or _nothing(sizes)
        self._made_of = in_python(plant.step.made_in)
        self._state_of, self.memory = in_python(plant.step.state_in), (memory_of(beyond.friction[0]), beyond.delay)
        self.size = length_of(Made, N, known=sizes)
        self.nothing = np.full(self.size + length_of(State, *self.memory, known=sizes), np.nan)  # no result yet
        asked, room = (
            np.zeros(length_of(record, size, known=sizes))
            for record, size in ((Asked, N + beyond.delay), (Room, beyond.delay))
        )
        self.ask: Asked = in_python(plant.step.asked_in)(asked)
        feeding = feeding or Feeding(np.zeros(0), (np.zeros((N + 1, N + 1)),) * 2, np.zeros(0))
        inverse, slopes, self.turned, allocating = feeding
        targets, side, rounds, calls, self._kept = allocating
        qp, closed = structured or _unused(plant, N, beyond.closed), beyond.closed
        gains = np.zeros(0) if closed is None else flat(closed.gains)
        (numbers, starts, given, path), self.given = qp.arrays, qp.given
        known = flat(Known(plant.h, plant.substeps, *beyond.gate, beyond.dead_band, beyond.rules, CORRECTED))
        rubs = any(in_python(rubbing_in)(friction).kind != ABSENT for friction in beyond.friction)
        rubbed = stage_of(plant.step.rubbed) if rubs else 0
        rested = stage_of(plant.step.rested) if beyond.rests else 0
        fed_back = stage_of(plant.step.fed_back) if closed and closed.gains.share > 0 else 0  # of PIDs
        acts = stage_of(plant.step.closed) if closed else 0
        self._inputs = Inputs(
            plant.c, plant.p, plant.decay, inverse, np.ravel([D.T for D in slopes]), self.turned, known,
            beyond.friction.ravel(), gains, numbers, asked, given, path, qp.answer, room, targets, starts, qp.counted,
            rounds, qp.guess, np.zeros_like(qp.guess), side, qp.address, *calls, rubbed, rested, fed_back, acts,
            *_CLOCK,
        )  # fmt: skip
        self._table = table_of(self._inputs)
        self.step = entry_of(plant.step.step, _KINDS)
        self.address: int = self._table.ctypes.data  # valid during the lifetime of these arrays

    def made(self, out: Array) -> Made:
        """Return views into the plan of a result."""
        made: Made = self._made_of(out[: self.size])
        return made

    def state(self, out: Array) -> State:
        """Return views into the state of a result."""
        state: State = self._state_of(out[self.size :], self.made(out).u, *self.memory)
        return state

    def feed_forward(self) -> tuple[bool, Array]:
        """Fill in `given` with the feed-forward of `asked`; return whether it exists, and the distances moved (3,)."""
        sure, made = self._part(FEED)
        return sure, made.moved

    def linearise(self) -> None:
        """Store the linear model about `given` in the structured QP."""
        self._part(LINEARISE)

    def rollout(self) -> tuple[bool, Made]:
        """Return whether the motion of the structured QP's solution is finite, and the motion."""
        return self._part(ROLLOUT)

    def _part(self, what: int) -> tuple[bool, Made]:
        out = np.empty(self.nothing.size)
        return self.step(what, self.address, self.nothing, out, self.ask.x, self.ask.theta, self.ask.K), self.made(out)


def _nothing(sizes: Mapping[str, int]) -> Beyond:
    gate = np.zeros(sizes["x"]), np.zeros(sizes["x"])
    return Beyond(gate, np.tile(flat(NO_FRICTION), (sizes["n"], 1)), 0, 0.0, rests=False, rules=Rules(*9 * (0.0,)))


def _unused(plant: "CompiledPlant", N: int, closed: Closed | None) -> _Unused:
    sizes: dict[str, int] = plant.step.SIZES
    numbers = np.zeros(length_of(Setting, known=sizes) + 2 * sizes["n"])  # bounds of several joints are longer
    if closed is not None:
        begin, bounds = length_of(Cost, known=sizes), flat(closed.bounds)
        numbers[begin : begin + bounds.size] = bounds
    given, starts, m = np.zeros(length_of(Given, N, known=sizes)), np.zeros(1, np.int64), sizes["m"]
    views = in_python(plant.step.given_in)(given)
    return _Unused((numbers, starts, given, np.zeros(0)), views, np.zeros(m), np.zeros(m, np.int8), starts.copy(), 0)
