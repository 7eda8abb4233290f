"""Diagnosis of a machine of n joints and m muscles: its `Health` from the quantities of an observer, sample by sample.

Four parts detect faults: `mpc.observer.pressure_diagnosis` compares each muscle's pressure with its command,
`mpc.observer.torque_diagnosis` watches the disturbance torques, `mpc.observer.ringing` each joint's velocity, and this
file the observer's own flags. A single cause is assumed if it explains everything: low pressures in all muscles mean a
low supply, a torque due to a broken cable or a drifting pressure sensor is no load, and of a ringing loop and a fault,
the one that began first explains the other.

A muscle's pressure sensor is judged by the disturbance along the muscle's own torque: d̂ · g_j/|g_j|, g_j = ∂T_j/∂P_j.

Functions that numba can compile update the memory (`mpc.observer.compiled`).
"""

from collections.abc import Iterable, Iterator, Sequence
from math import inf, isfinite, nan, sqrt
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.observer import pressure_diagnosis, ringing, torque_diagnosis
from mpc.observer.gating import Verdict
from mpc.observer.health import PARTS, WELL, FaultKind, Finding, Health, Part, Parts, Suspect
from mpc.observer.pressure_diagnosis import Numbers, PressureDiagnosis, Sound, Values
from mpc.observer.pulling import Pulls
from mpc.observer.ringing import RingingDiagnosis
from mpc.observer.torque_diagnosis import TorqueDiagnosis

LARGE, LARGE_STILL = 0.1 * BAR, 0.08 * BAR  # [Pa] |offset| of a sensor to report, and to stop reporting
ALIKE = 7.5  # [σ] between pressures that one supply feeds
SHOWN = 0.01 * BAR  # [Pa] resolution of the reported offset
_TOGETHER = 0.03  # [s] between the onsets of one cause
_SEEN_LATER = 1.0  # [s] a broken cable may be named after its muscle's pressure was rejected
_FORGETTING = 1.0  # [s]: readings lost earlier hardly count
_FLAGS = {
    Verdict.SILENT: FaultKind.SILENT_SENSOR,
    Verdict.IMPOSSIBLE: FaultKind.REJECTED_SENSOR,
    Verdict.REJECTED: FaultKind.REJECTED_SENSOR,
    Verdict.FROZEN: FaultKind.FROZEN_SENSOR,
}
_DOUBTED = FaultKind.REJECTED_SENSOR, FaultKind.FROZEN_SENSOR
_LOW_SUPPLY = (Suspect(FaultKind.SUPPLY_DROP, Part.SUPPLY),)


class Known(NamedTuple):
    """Constants of n joints and m muscles."""

    muscles: tuple[Sound, ...]  # (m,)
    usual: Values  # (n,) torque of a muscle [N·m]
    inertia: Values  # (n,) [kg·m²]


class Diagnosis:
    """Diagnosis, updated once per sample by the observer of `plant`; `sigma` [Pa] is the noise of the pressure sensors.

    A sensor is suspected if it has lost `tolerance` seconds of readings recently, or at once if it is frozen.
    """

    def __init__(self, plant: Machine, dt: float, sigma: float, compensation: Compensation, tolerance: float) -> None:
        self.dt, self.tolerance, self._gas = dt, tolerance, plant.gas is not None
        self.n, self.m = plant.n, plant.m
        self.names = PARTS if isinstance(plant, Plant) else Parts.of(plant.labels.angles, plant.labels.pressures)
        self._pulls = Pulls(plant)
        along, usual = self._usual(plant)
        known = compensation.flow, dt, compensation.dead_band, sigma
        self.pressures = [
            PressureDiagnosis(Sound.of(up, down, *known, torque, compensation.measured_lags, plant.slew))
            for up, down, torque in zip(*plant.lags_each_way, along, strict=True)
        ]
        inertias = np.atleast_1d(plant.inertias).tolist()
        self.torque, self.loops = TorqueDiagnosis(dt, usual, self.m), [RingingDiagnosis(each) for each in inertias]
        self.sound = Known(tuple(own.sound for own in self.pressures), usual, inertias)
        self._told = compensation.dead_time, compensation.reading_age
        self.reset()

    def _usual(self, plant: Machine) -> tuple[list[float], list[float]]:
        """Return usual torques [N·m] in the middle of all ranges: along each muscle (m,), and of a muscle at each joint
        (n,).
        """
        middle = np.atleast_1d(np.mean(plant.angle_limits, axis=0))
        P = np.full(self.m, np.mean(plant.pressure_limits))
        T = np.abs(self._pulls(np.concatenate([middle, np.zeros(self.n), P]))[: self.m * self.n])
        T = T.reshape(self.m, self.n)
        usual = T.sum(axis=0) / np.maximum((T > 0).sum(axis=0), 1)
        shares = T**2 / np.maximum((T**2).sum(axis=1, keepdims=True), 1e-300)
        return (shares @ usual).tolist(), usual.tolist()

    def reset(self) -> None:
        """Forget the past samples."""
        n, m = self.n, self.m
        self.health = WELL
        self.t = 0.0
        self.theta = [nan] * n  # last readings
        self.lost = [0.0] * (n + m)  # recently lost readings of each sensor [s]
        self.said = [nan] * (n + m)  # last reading of each sensor that is losing readings
        self.sensors: list[Finding | None] = [None] * (n + m)
        self.offset = [0.0] * m  # of the pressure sensors against the regulators [Pa]
        self.large = [nan] * m  # time at which they became large [s]; NaN: they are not
        self._known: tuple[object, ...] = ()
        self._low_supply = False
        for part in self.parts:
            part.reset()

    @property
    def parts(self) -> tuple[PressureDiagnosis | TorqueDiagnosis | RingingDiagnosis, ...]:
        """Parts with a memory: pressures, torque and loops."""
        return *self.pressures, self.torque, *self.loops

    def go_on(
        self, t: float, theta: Array, lost: Array, said: Array, found: Array, offset: Array, large: Array,
        numbers: Sequence[Array],
    ) -> None:  # fmt: skip
        """Continue from the state of compiled code at the time `t` [s] and the angles `theta` (n,) [rad].

        Sensors have `lost` (n + m,) [s] of readings and last `said` (n + m,) them, some are `found` (n + m,) faulty;
        `offset` (m,) [Pa] of pressures is `large` (m,) since [s]; `numbers` are those of the `parts`.
        """
        self.t, self.theta, self.lost, self.said = t, theta.tolist(), lost.tolist(), said.tolist()
        self.offset, self.large = offset.tolist(), large.tolist()
        self.sensors = [one if wrong else None for one, wrong in zip(self.sensors, found, strict=True)]
        for part, values in zip(self.parts, numbers, strict=True):
            part.numbers = values.tolist()

    def follow(self, said: Array, verdicts: Sequence[Verdict], v: Array, xi: Array, offset: Array) -> None:
        """Update by the readings `said` (n + m,) and their verdicts.

        The commands `v` (m,) [Pa] act; `xi` (3n + m,) and the sensors' `offset` (m,) [Pa] are estimates.
        """
        n, size = self.n, 2 * self.n + self.m
        self.offset, read_as = offset.tolist(), v + offset
        self.large = [large_since(*one, self.t) for one in zip(self.large, self.offset, strict=True)]
        believed = [self._sensor(i, *one) for i, one in enumerate(zip(said.tolist(), verdicts, strict=True))]
        d, pulls = xi[size:].tolist(), self._pulls(xi[:size]).tolist()
        if all(map(isfinite, (*d, *pulls))):
            known = all(verdict.counts for verdict in verdicts)  # d̂ compensates for unknown readings
            if Verdict.ACCEPTED in verdicts[self.n :] and Verdict.ACCEPTED not in verdicts[: self.n]:
                self.torque.numbers[torque_diagnosis.COUNT] = 0.0  # d̂ jumps with the pressure, not because of a cable
            if not known:
                for loop in self.loops:
                    ringing.begin(loop.numbers)
            moved = known and believed[:n] != self.theta  # repeated angles may be frozen
            self.theta = believed[:n]
            muscles, loops = ([part.numbers for part in parts] for parts in (self.pressures, self.loops))
            acting, omega = read_as.tolist(), xi[n : 2 * n].tolist()
            numbers = muscles, self.torque.numbers, loops
            follow(*numbers, self.sound, self.t, believed[n:], acting, omega, d, pulls, moved)
        self.t += self.dt
        self.conclude()

    def _sensor(self, i: int, said: float, verdict: Verdict) -> float:
        """Return the reading, NaN if it is not believed; note whether the sensor is suspected."""
        lost = not verdict.counts
        if not lost and not self.lost[i]:
            return said
        if verdict is Verdict.REJECTED and i >= self.n and self.pressures[i - self.n].suspected:
            return said  # the observer does not know the explanation
        old, repeated = self.sensors[i], said == self.said[i]
        self.said[i] = said
        if not lost:
            self.lost[i], little = less_lost(self.lost[i], self.dt, self.tolerance)
            self.sensors[i] = None if little else old
            return said
        self.lost[i] += self.dt - self.dt / _FORGETTING * self.lost[i]
        if self.lost[i] > self.tolerance or verdict is Verdict.FROZEN:
            kind = FaultKind.FROZEN_SENSOR if repeated and verdict is Verdict.REJECTED else _FLAGS[verdict]
            self.sensors[i] = Finding((Suspect(kind, self.names.sensors[i]),), old.since if old else self.t)
        return nan

    def conclude(self) -> None:
        """Update the findings, if they have changed."""
        torque, offsets = self.torque, (steps(*one) for one in zip(self.large, self.offset, strict=True))
        suspected, rings = (own.suspected for own in self.pressures), (loop.since for loop in self.loops)
        known = *suspected, torque.broken, *torque.loaded, *rings, *self.sensors, *offsets
        if known == self._known:
            return
        self._known = known
        findings = [*self._of_sensors(), *self._of_motion(), *self._of_offsets()]
        self.health = Health(tuple(findings)) if findings else WELL

    def _of_sensors(self) -> Iterator[Finding]:
        angles, broken = self.names.sensors[: self.n], self.torque.broken
        thrown = None if broken is None or not self._gas else self.names.sensors[self.n + broken]
        for finding in filter(None, self.sensors):
            fault, part, _ = finding.suspects[0]
            moved = fault in _DOUBTED and part in angles and self._first < finding.since
            swollen = (
                fault is FaultKind.REJECTED_SENSOR and part == thrown and self._thrown < finding.since + _SEEN_LATER
            )
            if not (moved or swollen):
                yield finding  # else a fault moved the joint out of its range, holds it, or freed the muscle

    @property
    def _first(self) -> float:
        """Onset of the first fault of a pressure or a cable [s]; inf without one."""
        found = [own.since for own in self.pressures if own.suspected]
        found += [] if self.torque.broken is None else [self.torque.since]
        return min(found, default=inf)

    def _of_motion(self) -> Iterator[Finding]:
        rings = [i for i, loop in enumerate(self.loops) if loop.since is not None]
        began, i = min(((self.loops[i].since or 0.0, i) for i in rings), default=(inf, 0))
        if not rings or self._first < began:
            yield from (*self._of_pressures(), *self._of_torque())
            return
        dead_time, age = (f"{1e3 * told:.0f} ms" for told in self._told)
        yield Finding(
            (Suspect(FaultKind.RINGING, self.names.loops[i]),),
            began,
            f"at {self.loops[i].frequency:.1f} Hz: readings or commands are older than told (a dead time of "
            f"{dead_time} and a reading age of {age}), or a payload has multiplied the inertia; raise dead_time, "
            "reading_age or inertia",
        )

    def _of_pressures(self) -> Iterator[Finding]:
        thrown = self._gas and self.torque.broken is not None
        ill = {i: own for i, own in enumerate(self.pressures) if own.suspected and not (thrown and self._moved(i))}
        several = len(ill) > 1
        common = several and all(FaultKind.SUPPLY_DROP in own.suspected for own in ill.values())
        low = several and all(own.low for own in ill.values()) and self._alike(ill)
        self._low_supply = bool(ill) and (common or low or (self._low_supply and not thrown))
        if self._low_supply and not self._snapped(ill.values()):
            yield Finding(_LOW_SUPPLY, min(own.since for own in ill.values()))
        else:
            yield from (self._of_pressure(i) for i in ill if thrown or not self._swung(i))

    @staticmethod
    def _snapped(ill: Iterable[PressureDiagnosis]) -> bool:
        """Return whether the first pressure that errs may have a broken cable, which moves the gas of the others."""
        first, *others = sorted(ill, key=lambda own: own.since)
        return FaultKind.BROKEN_CABLE in first.suspected and all(own.since > first.since + _TOGETHER for own in others)

    def _alike(self, muscles: Iterable[int]) -> bool:
        """Return whether the pressures of `muscles` are equal, as one low supply leaves them."""
        P = [self.pressures[i].numbers[pressure_diagnosis.P] for i in muscles]
        return max(P) - min(P) < ALIKE * self.pressures[0].sound.sigma

    def _moved(self, i: int) -> bool:
        """Return whether a broken cable explains the pressure of muscle `i`.

        No motion moves the gas of its own muscle; the pressures of the others err later, by an unmodelled motion.
        """
        return self.torque.broken == i or self.pressures[i].since >= self._thrown

    @property
    def _thrown(self) -> float:
        """Onset of a broken cable [s], which its own muscle's gas may show first."""
        own = self.pressures[self.torque.broken or 0]
        return min(own.since, self.torque.since) if self._gas and own.suspected else self.torque.since

    def _swung(self, i: int) -> bool:
        """Return whether an earlier fault with one explanation explains the pressure of muscle `i`.

        The fault moves the joint, and with it the gas. A leak throws it as a broken cable does; after other faults this
        muscle's pressure has to be sound but for that motion.
        """
        own = self.pressures[i]
        sound = FaultKind.BROKEN_CABLE in own.suspected
        earlier = (other for other in self.pressures if len(other.suspected) == 1 and other.since < own.since)
        return self._gas and any(sound or FaultKind.LEAK in other.suspected for other in earlier)

    def _of_torque(self) -> Iterator[Finding]:
        torque = self.torque
        explaining = {FaultKind.DRIFTING_SENSOR, FaultKind.BROKEN_CABLE}
        explained = any(explaining & own.suspected for own in self.pressures)
        if torque.broken is not None:
            yield Finding((Suspect(FaultKind.BROKEN_CABLE, self.names.muscles[torque.broken]),), self._thrown)
        elif not explained:
            for loaded, joint, angle in zip(torque.loaded, self.names.joints, self.names.sensors, strict=False):
                if loaded is not None:
                    suspects = Suspect(FaultKind.LOAD, joint), Suspect(FaultKind.DRIFTING_SENSOR, angle)
                    yield Finding(suspects, loaded)

    def _of_offsets(self) -> Iterator[Finding]:
        for own, large, offset, sensor in zip(
            self.pressures, self.large, self.offset, self.names.sensors[self.n :], strict=True
        ):
            if isfinite(large) and not own.suspected:  # else a fault keeps the pressure away from its command
                yield Finding((Suspect(FaultKind.OFFSET, sensor, offset),), large)

    def _of_pressure(self, i: int) -> Finding:
        own, names = self.pressures[i], self.names
        parts = {FaultKind.SUPPLY_DROP: Part.SUPPLY, FaultKind.DRIFTING_SENSOR: names.sensors[self.n + i]}
        kinds = [kind for kind in FaultKind if kind in own.suspected]
        return Finding(tuple(Suspect(kind, parts.get(kind, names.muscles[i])) for kind in kinds), own.since)


def follow(
    muscles: Sequence[Numbers], torque: Numbers, loops: Sequence[Numbers], k: Known, t: float, read: Values,
    v: Values, omega: Values, d: Values, pulls: Values, moved: bool,
) -> None:  # fmt: skip
    """Update the memories of muscles, torque and loops at `t` [s].

    The pressures `read` (m,) [Pa] are NaN if not believed, the acting commands lead to readings of `v` (m,) [Pa],
    `omega` (n,) [rad/s] and `d` (n,) [N·m] are estimates, and `pulls` are those of the model's muscles, see
    `mpc.observer.pulling`. The machine has `moved` if all readings are believed and an angle has a new one.
    """
    n, m = len(loops), len(muscles)
    for j in range(m):
        gain, along = seen_along(d, pulls, j, n, m)
        other, fallen = muscles[richest(muscles, j)], pulls[2 * n * m + j]
        missing = torque_diagnosis.missing(torque, k.usual, d, pulls, j, m)
        pressure_diagnosis.follow(muscles[j], other, k.muscles[j], t, read[j], v[j], gain, along, fallen, missing)
    if moved:
        torque_diagnosis.follow(torque, k.muscles[0].dt, k.usual, t, d, pulls, m)
    for i in range(n):
        ringing.follow(loops[i], k.inertia[i], t, omega[i], d[i])


def seen_along(d: Values, pulls: Values, j: int, n: int, m: int) -> tuple[float, float]:
    """Return |g_j| [N·m/Pa] and d̂ · g_j/|g_j| [N·m] of muscle `j`."""
    square, product = 0.0, 0.0
    for i in range(n):
        g = pulls[(m + j) * n + i]
        square += g * g
        product += g * d[i]
    gain = sqrt(square)
    return gain, (product / gain if gain > 0 else 0.0)


def richest(muscles: Sequence[Numbers], j: int) -> int:
    """Return the other muscle with the highest pressure, among those that are not low if there are any."""
    best = -1
    for i in range(len(muscles)):
        if i == j:
            continue
        if best < 0:
            best = i
        low, best_low = muscles[i][pressure_diagnosis.LOW] > 0, muscles[best][pressure_diagnosis.LOW] > 0
        higher = muscles[i][pressure_diagnosis.P] > muscles[best][pressure_diagnosis.P]
        if (best_low and not low) or (low == best_low and higher):
            best = i
    return best


def less_lost(lost: float, dt: float, tolerance: float) -> tuple[float, bool]:
    """Return the `lost` time [s] of a sensor's readings, reduced after a believed one, and whether it is small."""
    lost -= dt / _FORGETTING * lost
    little = lost < tolerance / 2
    return (lost if lost > dt / 10 or not little else 0.0), little  # small ones are forgotten


def large_since(since: float, offset: float, t: float) -> float:
    """Return the time [s] since which the `offset` [Pa] of a sensor is large, at the time `t` [s]; NaN if it is not."""
    if abs(offset) > LARGE:
        return t if since != since else since
    return since if abs(offset) > LARGE_STILL else nan


def steps(since: float, offset: float) -> float:
    """Return the `offset` [Pa] in the steps of its message; 0 if it has not been large `since` any time [s]."""
    return 0.0 if since != since else np.floor(offset / SHOWN + 0.5)
