"""Observer of the state and the disturbance torque, for any readings of the sensors.

`KalmanObserver` is the extended Kalman filter of `mpc.observer.filter` behind the gates of `mpc.observer.gating`, which
reject impossible motion. The covariance begins at the stationary one (Riccati equation at rest in the middle of the
range).

A sensor that repeats its reading exactly may be frozen, or at rest, since the steps of an encoder hide small motions.
From the first repetition on, a second belief is kept without the readings of that sensor and of others that repeat or
are not believed. If its expected reading differs by five standard deviations for some time, the sensor is frozen: the
second belief takes over, and the sensor counts as silent until its reading changes.

While readings are rejected, a rival belief uses them (`mpc.observer.rivalry`).
"""

from collections import deque
from collections.abc import Iterator
from copy import deepcopy
from math import nan, sqrt
from typing import TYPE_CHECKING, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask, Value
from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.machine import Machine, sample_time
from mpc.observer.base import units_shown
from mpc.observer.compiled.factory import Readable, compiled_estimate
from mpc.observer.compiled.layout import State, Tail
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import Belief, Filter, Noise, settings
from mpc.observer.gating import DOUBT, ROUGH, ROUNDING, Gate, SensorGate, Verdict
from mpc.observer.health import Health
from mpc.observer.rivalry import Readings, Rivalry

if TYPE_CHECKING:
    from mpc.observer.compiled.factory import CompiledEstimate  # which imports numba

FIRST = 3  # samples up to which rejected readings may be right, because nothing has confirmed the first reading
COARSEST = 1 * DEG  # step of an encoder


class KalmanObserver:
    """Extended Kalman filter with `plant`, a `Plant` or an `Arm`, as its model.

    A sensor may be silent (NaN, or rejected by the `gate`) or frozen for `tolerance` seconds. After that, its quantity
    is NaN in the estimate until the sensor returns, and `TrackingMPC` reports the missing measurement in the status of
    its plans. No number makes the observer raise. Before the first plausible angle, only the pressures are not NaN.

    Angles are read `Compensation.reading_age` late. Readings of pressures are delayed by the same time, the filter
    estimates the state at that time, and the result is predicted from it with the commands since.

    Ordinary samples, in which all readings are believed, are compiled (`implementation`). This takes some seconds for
    the first observer of a kind of plant. If `wait` is false, another process compiles for the next run. With
    `compiled` False nothing is compiled, for an observer that is only exported. Raises `InvalidInput`.
    """

    def __init__(
        self,
        plant: Machine,
        dt: float,
        noise: Noise | None = None,
        compensation: Compensation | None = None,
        tolerance: float = 0.1,
        gate: Gate | None = None,
        wait: bool = True,
        compiled: bool = True,
    ) -> None:
        self.plant, self.wait = plant, checks.flag("wait", wait)
        self.dt, self.tolerance = dt, tolerance = sample_time(dt), checks.not_negative("tolerance", tolerance, "s")
        self.noise, self.compensation, self.gate = settings(plant, self.dt, noise, compensation, gate)
        self.filter = Filter(plant, dt, self.noise, self.compensation, self.gate)
        self._measured, self._angles = self.filter.measured, slice(plant.n)
        self._gates = [SensorGate(self.gate, sensor, dt) for sensor in range(self._measured.size)]
        self.rivalry = Rivalry(self.filter, self._gates, self.gate, dt, tolerance)
        self.age = self.compensation.age(dt)  # of the angle's readings [samples]
        self.diagnosis = Diagnosis(plant, dt, self.noise.pressure, self.compensation, tolerance)
        self.compiled: CompiledEstimate | None = None
        self._compiles = checks.flag("compiled", compiled)
        self.reset()
        self._compile()

    def __repr__(self) -> str:
        return f"KalmanObserver: samples of {1e3 * self.dt:g} ms, {self.implementation}; model: {self.plant.summary}"

    def reset(self) -> None:
        """Forget the past samples: the next measurement is the state, and there is no disturbance torque."""
        self._catch_up()
        self._belief: Belief | None = None
        self._verdicts = [Verdict.SILENT] * self._measured.size  # on the last readings of angles and pressures
        self._units_shown = False  # whether a pressure since the beginning has shown its unit
        self.rebuilt = 0  # number of times that the state was not finite and was rebuilt
        self._read = np.full(self._measured.size, np.nan)  # readings of the previous sample
        self._offset = np.zeros(self.plant.m)  # of the pressure sensors against the regulators [Pa]
        self._apart = np.zeros((2, self.plant.m))  # see `Filter.apart`
        self._silent, self._repeating = np.zeros((2, self._measured.size))  # durations [s]
        self._frozen = np.zeros(self._measured.size, bool)
        self._without: dict[int, Belief] = {}  # by repeating sensor: belief without it
        self.rivalry.reset()
        self._samples = 0  # since the beginning, up to FIRST + 1
        self._step = np.full(self.plant.n, COARSEST)  # the least change of each angle's reading so far [rad]
        self._variances = np.diag(self.filter.R).copy()  # of the sensors
        self._frictions = tuple(map(FrictionState, self.filter.frictions))
        self._commands: deque[Array] = deque(maxlen=self.compensation.delay(self.dt) + self.age + 1)
        self._held: deque[Array] = deque(maxlen=self.age + 1)  # readings of pressures that wait for an angle
        for gate, floor in zip(self._gates, self.gate.floor, strict=True):
            gate.reset()
            gate.floor = floor
        self.diagnosis.reset()

    @property
    def belief(self) -> Belief | None:
        """Belief of the filter, None before the first plausible angle."""
        self._catch_up()
        return self._belief

    @belief.setter
    def belief(self, belief: Belief | None) -> None:
        self._catch_up()
        self._belief = belief

    @property
    def verdicts(self) -> list[Verdict]:
        """Verdicts on the last readings of angles and pressures."""
        ordinary = self.compiled is not None and self.compiled.ahead
        return [Verdict.BELIEVED] * self._measured.size if ordinary else self._verdicts

    @property
    def offset(self) -> Array:
        """Offset of each pressure sensor above the pressure that commands lead to (m,) [Pa]."""
        self._catch_up()
        return self._offset.copy()

    @property
    def encoder_step(self) -> float:
        """Least change of an angle's reading so far [rad], at most `COARSEST`."""
        self._catch_up()
        return float(self._step.min())

    @property
    def implementation(self) -> str:
        """Implementation of ordinary samples: "compiled", or "readable", which is about a hundred times slower."""
        return "readable" if self.compiled is None else "compiled"

    @property
    def health(self) -> Health:
        """Suspected faults, as of the last estimate."""
        return self.diagnosis.health

    def estimate(self, y: Array, u: Array) -> tuple[Array, Value]:
        """Return the state (2n + m,) and disturbance torque [N·m], (n,) of an arm, from `y` (2n + m,), NaN where
        unmeasured.

        `u` (m,) [Pa] is the last command sent. Raises `InvalidInput` for wrong shapes and types. Warns (`BadNumbers`)
        if the first pressures above 0 look like bar.
        """
        try:
            y, u = np.asarray(y, float), np.asarray(u, float)
        except (TypeError, ValueError):  # tried first, as the check takes a microsecond
            y, u = checks.floats("y", y, "rad, rad/s, Pa"), checks.floats("u", u, "Pa")
        if not self._units_shown and y.shape == (self.plant.size,):
            self._units_shown = units_shown("y", y[2 * self.plant.n :], stacklevel=2)
        if self.compiled is not None:
            if (found := self.compiled.answer(y, u)) is not None:
                return found
            self.compiled.give()
        if y.shape != (self.plant.size,) or u.shape != (self.plant.m,):
            raise InvalidInput(
                f"y and u have the shapes {y.shape} and {u.shape}, not ({self.plant.size},) and ({self.plant.m},)"
            )
        return self._estimated(self._simultaneous(y[self._measured]), u)

    def _simultaneous(self, said: Array) -> Array:
        """Return the new angles of the readings `said` (n + m,), with the pressures at the time of these angles."""
        angles, pressures = said[self._angles], said[self.plant.n :]
        self._held.extend([pressures] * (1 if self._held else self.age + 1))
        return np.append(angles, self._held[0])

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # `Belief.sound` detects numbers out of range
    def _estimated(self, said: Array, u: Array) -> tuple[Array, Value]:
        """Return the result of `estimate` for any readings `said` (n + m,)."""
        if self._belief is None:
            self._begin(said, u)
        else:
            self._learn_steps(np.abs(said - self._read)[self._angles].tolist())
            self._commands.append(np.where(self.filter.can_be_sent(u), u, self._commands[-1]))
            self._go_on(self._belief, said)
        there = self._believed
        self._silent = np.where(there, 0.0, np.maximum(self._silent, self._frozen * self._repeating) + self.dt)
        self._read = said
        if self._belief is not None:
            self.diagnosis.follow(said, self._verdicts, self._commands[0], self._belief.xi, self._offset)
        return self._answer(said, there)

    @property
    def _believed(self) -> Mask:
        """Mask (n + m,) of the readings that count."""
        return np.array([verdict.counts for verdict in self._verdicts])

    def _learn_steps(self, changes: list[float]) -> None:
        """Update the steps of encoders, the least of the `changes` [rad] so far: readings change by whole steps."""
        for i, change in enumerate(changes):
            if ROUNDING < change < self._step[i]:
                self._step[i] = change
                rough = max(self.noise.theta, change / sqrt(12))
                self._variances[i], self._gates[i].floor = rough**2, max(self.gate.floor[i], ROUGH * rough)

    # --- the compiled estimate --------------------------------------------------------------------------------------

    def _compile(self) -> None:
        """Create or load the compiled estimate, if possible."""
        arm = self.plant if isinstance(self.plant, Arm) else None
        if not self._compiles or (arm is not None and arm.unformulated):
            return
        again = KalmanObserver, self.plant, self.dt, self.noise, self.compensation  # compiles it in another process
        self.compiled = compiled_estimate(self.filter, self.diagnosis, self._readable, self.wait, again)

    @property
    def _readable(self) -> Readable:
        return Readable(self._remembered, self._go_on_from, self.diagnosis.conclude)

    def _catch_up(self) -> None:
        """Copy the state back from the compiled estimate."""
        if self.compiled is not None:
            self.compiled.give()

    def _remembered(self) -> dict[str, object] | None:
        """Return fields of `State` and `Tail` for a compiled estimate to continue from; None unless ordinary."""
        belief, diagnosis = self._belief, self.diagnosis
        quiet = not self.rivalry.going_on and not self._frozen.any() and all(gate.quiet for gate in self._gates)
        if belief is None or not quiet:
            return None
        return {
            "belief": belief, "variances": self._variances, "floor": [gate.floor for gate in self._gates],
            "read": self._read, "offset": self._offset, "apart": self._apart, "repeating": self._repeating,
            "step": self._step, "samples": 0.0,
            "repeats": [sensor in self._without for sensor in range(self._measured.size)],
            "without": [self._without.get(sensor, belief) for sensor in range(self._measured.size)],
            "angle": [nan if one.theta is None else one.theta for one in self._frictions],
            "memories": [one.memory for one in self._frictions],
            "commands": self._commands, "held": self._held, "t": diagnosis.t, "last": diagnosis.theta,
            "lost": diagnosis.lost, "said": diagnosis.said, "large": diagnosis.large,
            "found": [found is not None for found in diagnosis.sensors],
            "parts": [part.numbers for part in diagnosis.parts],
        }  # fmt: skip

    def _go_on_from(self, state: State, tail: Tail) -> None:
        """Continue from copies of the values in `state` and `tail`, after ordinary samples."""
        samples, sensors = int(state.samples), range(self._measured.size)
        self._belief, self._verdicts = Belief.of(state.belief), [Verdict.BELIEVED] * len(sensors)
        self._read, self._repeating, self._silent = state.read.copy(), state.repeating.copy(), np.zeros(len(sensors))
        self._offset, self._apart = state.offset.copy(), state.apart.copy()
        self._without = {i: Belief.of(state.without[i]) for i in sensors if state.repeats[i]}
        self._step, self._variances = state.step.copy(), state.variances.copy()
        for gate, floor in zip(self._gates, state.floor.tolist(), strict=True):
            gate.floor = floor
        self._samples = min(self._samples + samples, FIRST + 1)
        self.rivalry.rest(samples)
        for friction, angle, memory in zip(self._frictions, state.angle.tolist(), tail.memories, strict=True):
            friction.go_on(angle, memory)
        self._commands.extend(tail.commands.copy())
        self._held.extend(tail.held.copy())
        diagnosed = state.last, state.lost, state.said, state.found, state.offset, state.large, tail.parts
        self.diagnosis.go_on(float(state.t), *diagnosed)

    def __getstate__(self) -> dict[str, object]:
        """Leave out the compiled code, which each process creates for itself."""
        self._catch_up()
        return self.__dict__ | {"compiled": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Continue from the state of the copied observer."""
        self.__dict__.update(state)
        self._compile()

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Copy all but the compiled code, which both observers share."""
        other = object.__new__(type(self))
        memo[id(self)] = other
        other.__dict__.update(deepcopy(self.__getstate__(), memo))
        other.compiled = None if self.compiled is None else self.compiled.of(other._readable)
        return other

    # --- a sample ---------------------------------------------------------------------------------------------------

    def _begin(self, said: Array, u: Array) -> None:
        """Begin with the first plausible angle; an unmeasured pressure is the one that was sent."""
        gate, read = self.gate, said.copy()
        middle = np.atleast_1d(np.mean(self.plant.angle_limits, axis=0))
        read[self._angles] = [gate.unwrapped(*angle, within=np.pi) for angle in self._turned(said, middle)]
        self._verdicts = self.gate.first_verdicts(read)
        believed = self._believed
        n, none = self.plant.n, np.zeros(self.plant.n)
        q, P = read[:n], np.where(believed[n:], read[n:], u)
        if believed[:n].all() and all(map(gate.possible, range(n, read.size), P.tolist())):
            begun = Belief(np.concatenate([q, none, P, none]), self.filter.stationary)
            self._belief = self.filter.corrected(begun, read, believed, self._variances)
            self._commands.extend([np.where(self.filter.can_be_sent(u), u, P)] * int(self._commands.maxlen or 1))

    def _go_on(self, previous: Belief, said: Array) -> None:
        """Return the present estimate from that of the previous sample."""
        followed = zip(self._frictions, previous.xi.tolist(), self.filter.contacts(previous), strict=False)
        memories = [friction.follow(theta, loads) for friction, theta, loads in followed]
        expected = self.filter.predicted(previous, self._commands[0], memories, self.filter.Q)
        self._apart = self.filter.apart(self._apart, previous, self._commands[0])
        read = said.copy()
        if not expected.sound:
            self._verdicts = self.gate.first_verdicts(read)
            self._belief = self._rebuilt(previous, read, self._believed)
            return
        read[self._angles] = [self.gate.unwrapped(*angle) for angle in self._turned(said, expected.xi)]
        read[self.plant.n :] -= self._offset
        self._verdicts = self._checked(read, expected)
        rested = np.array([verdict is Verdict.ACCEPTED for verdict in self._verdicts])
        if rested.any():
            expected = self.filter.unsure_at(expected, read, rested)
        repeated = said == self._read
        expected = self._without_frozen(previous, expected, repeated, read, memories)
        expected = self._rival_or(expected, read, memories)
        believed = self._believed
        self._offset = self.filter.learned(self._offset, read, expected, believed, self._commands[0])
        found = self.filter.corrected(expected, read, believed, self._variances)
        self._samples = min(self._samples + 1, FIRST + 1)
        self._belief = found if found.sound else self._rebuilt(previous, read, believed)

    def _turned(self, said: Array, expected: Array) -> Iterator[tuple[float, float]]:
        """Return pairs of the angles `said` and `expected`."""
        return zip(said[self._angles].tolist(), expected[self._angles].tolist(), strict=True)

    def _checked(self, read: Array, expected: Belief) -> list[Verdict]:
        variance = self.filter.variances(expected) + self._variances
        numbers = np.array([read, *self.filter.bounds(expected, self._apart), variance]).T.tolist()
        return [gate.check(*of_sensor) for gate, of_sensor in zip(self._gates, numbers, strict=True)]

    def _without_frozen(
        self, previous: Belief, expected: Belief, repeated: Mask, read: Array, memories: list[Value]
    ) -> Belief:
        """Return the belief without frozen sensors, and record which are frozen."""
        self._repeating = np.where(repeated, self._repeating + self.dt, 0.0)
        self._frozen &= repeated
        others = self._believed & ~repeated
        begun = {i: self._without.get(i, previous) for i in np.flatnonzero(repeated).tolist()}
        self._without = {}
        for i, without in begun.items():
            foreseen = self.filter.predicted(without, self._commands[0], memories, self.filter.Q_rest[i])
            if not self._frozen[i] and self._repeating[i] > self.tolerance and self._doubtful(i, read[i], foreseen):
                self._frozen[i] = True
                expected = foreseen
            if self._frozen[i]:
                self._gates[i].frozen(float(read[i]))
                self._verdicts[i] = Verdict.FROZEN
            self._without[i] = self.filter.corrected(foreseen, read, others, self._variances)
        return expected

    def _doubtful(self, sensor: int, read: float, foreseen: Belief) -> bool:
        variance = (self.filter.variances(foreseen) + self._variances)[sensor]
        return bool((read - self.filter.foreseen(foreseen)[sensor]) ** 2 > DOUBT**2 * variance)

    def _rival_or(self, expected: Belief, read: Array, memories: list[Value]) -> Belief:
        """Return `expected`, or the belief of a rival that takes over and whose readings are accepted."""
        rejected = np.array([verdict is Verdict.REJECTED for verdict in self._verdicts])
        readings = Readings(read, self._believed, rejected, self._repeating, self._variances)

        def predicted(belief: Belief) -> Belief:
            return self.filter.predicted(belief, self._commands[0], memories, self.filter.Q)

        rival = self.rivalry.taken_over(expected, readings, predicted, confirmed=self._samples > FIRST)
        if rival is None:
            return expected
        for i in np.flatnonzero(rejected).tolist():
            self._verdicts[i] = Verdict.ACCEPTED
            self._gates[i].reset()
        self._without = {}
        return rival

    def _rebuilt(self, previous: Belief, read: Array, believed: Mask) -> Belief:
        """Return a state from the readings, if the filter has no finite one."""
        self.rebuilt += 1
        self.rivalry.end()
        self._without = {}
        xi = np.where(np.isfinite(previous.xi), previous.xi, 0.0)
        xi[self.plant.n : 2 * self.plant.n] = xi[self.plant.size :] = 0.0
        return self.filter.unsure_at(Belief(self.filter.within(xi), previous.covariance), read, believed)

    def _answer(self, said: Array, there: Mask) -> tuple[Array, Value]:
        x, d = np.full(self.plant.size, np.nan), np.zeros(self.plant.n)
        if self._belief is None:
            x[self._measured[there]] = said[there]
        else:
            under_way, memories = [*self._commands][1 : 1 + self.age], [friction.memory for friction in self._frictions]
            now = self.filter.ahead(self._belief, under_way, memories)
            x, d = np.split((now if now.sound else self._belief).xi.copy(), [self.plant.size])
            x[self._measured[self._silent > self.tolerance * (1 + 1e-9)]] = np.nan
        return x, float(d[0]) if self.plant.angle_shape == () else d
