"""Arrays of the compiled step, and its call."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.addresses import clock, entry_of
from mpc.codegen.views import flat, in_python, length_of, table_of
from mpc.model.compiled_friction import NO_FRICTION, memory_of
from mpc.model.plant import NU, NX
from mpc.tracking.compiled.records import Given, Setting, given_in
from mpc.tracking.compiled.records import lengths as record_lengths
from mpc.tracking.compiled.sample.layout import (
    Inputs,
    Known,
    Made,
    asked_of,
    lengths,
    made_of,
)
from mpc.tracking.compiled.sample.stages import FEED, LINEARISE, ROLLOUT
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.preview import CORRECTED
from mpc.tracking.rest_memory import Rules

if TYPE_CHECKING:
    from mpc.tracking.compiled.module import CompiledPlant
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP

_CLOCK = clock()
_NO_GATE = np.zeros(NX), np.zeros(NX)
_KINDS = "(int64, int64, float64[::1], float64[::1], float64[:], float64[:], float64[:], float64)"


class Beyond(NamedTuple):
    """Constants of the compensation and the rest mode."""

    friction: Array  # numbers, see `mpc.model.compiled_friction`
    delay: int  # [samples]
    dead_band: float  # [Pa]
    rests: bool  # whether commands come to rest at a constant reference
    rules: Rules  # of that

    @property
    def memory(self) -> int:
        """Number of entries of the friction's memory."""
        return memory_of(self.friction)


_NOTHING = Beyond(flat(NO_FRICTION), 0, 0.0, rests=False, rules=Rules(*9 * (0.0,)))


class StepArrays:
    """Arrays of one controller of N samples; two threads must not use them at the same time.

    Without the `structured` QP they serve only the feed-forward, without the `inverse` dynamics everything else. A
    whole step needs both, and the `gate` of a measured state: least and greatest values (4,).
    """

    def __init__(
        self,
        plant: "CompiledPlant",
        N: int,
        structured: "StructuredQP | None" = None,
        inverse: InverseDynamics | None = None,
        gate: tuple[Array, Array] = _NO_GATE,
        beyond: Beyond = _NOTHING,
    ) -> None:
        asked, self.size, length = lengths(N, beyond.delay, beyond.memory)
        self.nothing = np.full(length, np.nan)  # no result yet
        asks = np.zeros(asked)
        self.ask = asked_of(asks)
        slopes = np.zeros((2, N + 1, N + 1)) if inverse is None else np.stack([D.T for D in inverse.slopes])
        self.fixed = plant.c, plant.p, flat(_known(plant, inverse, gate, beyond)), np.ascontiguousarray(slopes)
        z, guess, counted, address = np.zeros(NU), np.zeros(NU, np.int8), np.zeros(1, np.int64), 0
        numbers, starts = np.zeros(length_of(Setting)), np.zeros(1, np.int64)
        given, path = map(np.zeros, record_lengths(N))
        if structured is not None:
            (numbers, starts, given, path), address = structured.arrays, structured.address
            z, guess, counted = structured.answer, structured.guess, structured.counted
        self.given: Given = in_python(given_in)(given)
        before = *self.fixed, beyond.friction, numbers, asks, given, path, z, np.zeros(6 * beyond.delay + 4)
        self._inputs = Inputs(*before, starts, counted, guess, np.zeros_like(guess), address, *_CLOCK)
        self._table = table_of(self._inputs)
        self.step = entry_of(plant.step.step, _KINDS)
        self.address: int = self._table.ctypes.data  # valid during the lifetime of these arrays

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
        asked = self.ask.x, self.ask.theta, self.ask.K, 0.0
        return self.step(what, self.address, self.nothing, out, *asked), made_of(out[: self.size])


def _known(plant: "CompiledPlant", inverse: InverseDynamics | None, gate: tuple[Array, Array], beyond: Beyond) -> Known:
    steps = plant.h, plant.substeps
    numbers = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *steps, 0.0, 0.0, 0.0
    nothing = Known(*numbers, *gate, beyond.dead_band, beyond.rests, beyond.rules, CORRECTED)
    if inverse is None:
        return nothing
    physical, (alpha1, alpha2) = inverse.plant, inverse.alpha.tolist()
    (lag1, lag2), (left, right) = physical.lags, physical.joint.angle_range
    return nothing._replace(
        inertia=physical.inertia, damping=physical.damping, gravity=physical.gravity_torque, alpha1=alpha1,
        alpha2=alpha2, lag1=lag1, lag2=lag2, left=left, right=right, min_force=inverse.min_force,
    )  # fmt: skip
