"""What an observer has anyway is turned into the `Health` of the joint, sample by sample.

Four parts look for faults: `mpc.observer.pressure_diagnosis` at each muscle's pressure against its
command, `mpc.observer.torque_diagnosis` at the disturbance torque, `mpc.observer.ringing` at the velocity, and this
file at the observer's own flags. One cause is assumed where one explains all: two pressures that are both too low have
a low supply, a torque that a broken cable or a drifting pressure sensor accounts for is no load, and of a loop that
rings and a fault the one that began first explains the other.

What is remembered as numbers is followed by functions that numba compiles, too (`mpc.observer.compiled`).
"""

from collections.abc import Iterator, Sequence
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.buffered import Buffered
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant
from mpc.observer import pressure_diagnosis, ringing, torque_diagnosis
from mpc.observer.gating import Verdict
from mpc.observer.health import MUSCLES, SENSORS, WELL, FaultKind, Finding, Health, Part, Suspect
from mpc.observer.pressure_diagnosis import Numbers, PressureDiagnosis, Sound
from mpc.observer.ringing import RingingDiagnosis
from mpc.observer.torque_diagnosis import TorqueDiagnosis

if TYPE_CHECKING:
    from casadi import Function

LARGE, LARGE_STILL = 0.1 * BAR, 0.08 * BAR  # [Pa] |offset| of a sensor to name, and no longer
SHOWN = 0.01 * BAR  # [Pa] to which it is named
_FORGETTING = 1.0  # [s]: readings lost longer ago hardly count
_PARTS = {FaultKind.SUPPLY_DROP: (Part.SUPPLY, Part.SUPPLY), FaultKind.DRIFTING_SENSOR: SENSORS[1:]}  # else the muscle
_FLAGS = {
    Verdict.SILENT: FaultKind.SILENT_SENSOR,
    Verdict.IMPOSSIBLE: FaultKind.REJECTED_SENSOR,
    Verdict.REJECTED: FaultKind.REJECTED_SENSOR,
    Verdict.FROZEN: FaultKind.FROZEN_SENSOR,
}
_DOUBTED_ANGLE = tuple(Suspect(kind, Part.ANGLE) for kind in (FaultKind.REJECTED_SENSOR, FaultKind.FROZEN_SENSOR))
_LOAD = Suspect(FaultKind.LOAD, Part.JOINT), Suspect(FaultKind.DRIFTING_SENSOR, Part.ANGLE)
_RINGING = (Suspect(FaultKind.RINGING, Part.LOOP),)
_LOW_SUPPLY = (Suspect(FaultKind.SUPPLY_DROP, Part.SUPPLY),)


class Joint(NamedTuple):
    """What is known of the joint's parts."""

    first: Sound
    second: Sound
    usual: float  # torque of a muscle [N·m]
    inertia: float  # [kg·m²]


class Diagnosis:
    """A diagnosis is fed once a sample by the observer of `plant`, whose sensors deviate by `sigma` [Pa] in the
    pressures.

    A sensor is suspected that has lost `tolerance` seconds of readings lately, or at once when it is frozen.
    """

    def __init__(self, plant: Plant, dt: float, sigma: float, compensation: Compensation, tolerance: float) -> None:
        self.dt, self.tolerance, self._gas = dt, tolerance, plant.gas is not None
        self._pulls = Buffered(pulling(plant))
        middle, P = float(np.mean(plant.joint.angle_range)), float(np.mean(plant.joint.pressure_limits))
        usual = float(np.abs(self._pulls(np.array([middle, 0.0, P, P]))[0][0, :NU]).mean())
        self.pressures = [PressureDiagnosis(lag, dt, compensation.dead_band, sigma, usual) for lag in plant.lags]
        self.torque, self.ringing = TorqueDiagnosis(dt, usual), RingingDiagnosis(plant.inertia)
        self.sound = Joint(self.pressures[0].sound, self.pressures[1].sound, usual, plant.inertia)
        self._told = compensation.dead_time, compensation.reading_age
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.health = WELL
        self.t = 0.0
        self.theta = nan  # last reading
        self.lost = [0.0, 0.0, 0.0]  # of each sensor's readings lately [s]
        self.said = [nan, nan, nan]  # by a sensor whose readings are being lost, a sample ago
        self.sensors: list[Finding | None] = [None, None, None]
        self.offset = [0.0, 0.0]  # of the pressures' sensors against the regulators [Pa]
        self.large = [nan, nan]  # since when they are [s]; NaN: they are not
        self._known: tuple[object, ...] = ()
        self._low_supply = False
        self.torque.reset()
        self.ringing.reset()
        for pressure in self.pressures:
            pressure.reset()

    @property
    def parts(self) -> tuple[PressureDiagnosis | TorqueDiagnosis | RingingDiagnosis, ...]:
        """The parts that remember numbers: both pressures, torque and loop."""
        return *self.pressures, self.torque, self.ringing

    def go_on(
        self, t: float, theta: float, lost: Array, said: Array, found: Array, offset: Array, large: Array,
        numbers: Sequence[Array],
    ) -> None:  # fmt: skip
        """Go on where it was followed elsewhere: to the time `t` [s], the angle `theta` [rad], what sensors have `lost`
        (3,) [s] and `said` (3,) then, whether one is `found` (3,) wrong, the `offset` (2,) [Pa] of the pressures, since
        when it is `large` (2,) [s], and the `numbers` of pressures, torque and loop.
        """
        self.t, self.theta, self.lost, self.said = t, theta, lost.tolist(), said.tolist()
        self.offset, self.large = offset.tolist(), large.tolist()
        self.sensors = [one if wrong else None for one, wrong in zip(self.sensors, found, strict=True)]
        for part, values in zip(self.parts, numbers, strict=True):
            part.numbers = values.tolist()

    def follow(self, said: Array, verdicts: Sequence[Verdict], v: Array, xi: Array, offset: Array) -> None:
        """Follow what the sensors have `said` (3,), which was checked.

        The commands `v` (2,) [Pa] act, and `xi` (5,) and the sensors' `offset` (2,) [Pa] are estimated.
        """
        self.offset, read_as = offset.tolist(), v + offset
        self.large = [large_since(*one, self.t) for one in zip(self.large, self.offset, strict=True)]
        believed = [self._sensor(i, *one) for i, one in enumerate(zip(said.tolist(), verdicts, strict=True))]
        d, pulls = float(xi[NX]), self._pulls(xi[:NX])[0][0].tolist()
        if all(map(isfinite, (d, *pulls))):
            known = all(verdict.counts for verdict in verdicts)  # d̂ makes up for what is not
            (one, two), torque, loop = self.pressures, self.torque, self.ringing
            if not known:
                ringing.begin(loop.numbers)
            moved = known and believed[0] != self.theta  # a repeated angle may be frozen
            self.theta, *read = believed
            acting = read_as.tolist()
            parts, omega = (one.numbers, two.numbers, torque.numbers, loop.numbers), float(xi[1])
            follow(*parts, self.sound, self.t, read, acting, omega, d, pulls, moved)
        self.t += self.dt
        self.conclude()

    def _sensor(self, i: int, said: float, verdict: Verdict) -> float:
        """Return the reading, NaN if it is not believed; note whether the sensor is suspected."""
        lost = not verdict.counts
        if not lost and not self.lost[i]:
            return said
        if verdict is Verdict.REJECTED and i and self.pressures[i - 1].suspected:
            return said  # the observer does not know of what would explain it
        old, repeated = self.sensors[i], said == self.said[i]
        self.said[i] = said
        if not lost:
            self.lost[i], little = less_lost(self.lost[i], self.dt, self.tolerance)
            self.sensors[i] = None if little else old
            return said
        self.lost[i] += self.dt - self.dt / _FORGETTING * self.lost[i]
        if self.lost[i] > self.tolerance or verdict is Verdict.FROZEN:
            kind = FaultKind.FROZEN_SENSOR if repeated and verdict is Verdict.REJECTED else _FLAGS[verdict]
            self.sensors[i] = Finding((Suspect(kind, SENSORS[i]),), old.since if old else self.t)
        return nan

    def conclude(self) -> None:
        """Say what is wrong, where that has changed."""
        torque, (one, two) = self.torque, self.pressures
        offsets = (steps(*one) for one in zip(self.large, self.offset, strict=True))
        known = one.suspected, two.suspected, torque.broken, torque.loaded, self.ringing.since, *self.sensors, *offsets
        if known == self._known:
            return
        self._known = known
        findings = [*self._of_sensors(), *self._of_joint(), *self._of_offsets()]
        self.health = Health(tuple(findings)) if findings else WELL

    def _of_sensors(self) -> Iterator[Finding]:
        for finding in self.sensors:
            if finding and not (finding.suspects[0] in _DOUBTED_ANGLE and self._first < finding.since):
                yield finding  # else another fault threw the joint out of its range, or holds it where it should move

    @property
    def _first(self) -> float:
        """When the first fault of a pressure or a cable began [s]; inf without one."""
        found = [own.since for own in self.pressures if own.suspected]
        found += [] if self.torque.broken is None else [self.torque.since]
        return min(found, default=inf)

    def _of_joint(self) -> Iterator[Finding]:
        began = self.ringing.since
        if began is None or self._first < began:
            yield from (*self._of_pressures(), *self._of_torque())
            return
        dead_time, age = (f"{1e3 * told:.0f} ms" for told in self._told)
        yield Finding(
            _RINGING,
            began,
            f"at {self.ringing.frequency:.1f} Hz: readings or commands are probably older than told, which is a dead "
            f"time of {dead_time} and a reading age of {age}; raise dead_time or reading_age",
        )

    def _of_pressures(self) -> Iterator[Finding]:
        one, two = self.pressures
        common = FaultKind.SUPPLY_DROP in one.suspected & two.suspected or bool(one.low and two.low)
        thrown = self._gas and self.torque.broken is not None
        suspected = [i for i, own in enumerate(self.pressures) if own.suspected and not (thrown and self._moved(i))]
        low = (self._low_supply and not thrown) or (len(suspected) == NU and common)
        self._low_supply = bool(suspected) and low
        if self._low_supply:
            yield Finding(_LOW_SUPPLY, min(self.pressures[i].since for i in suspected))
        else:
            yield from map(self._of_pressure, suspected)

    def _moved(self, i: int) -> bool:
        """Return whether a broken cable explains the pressure of muscle `i`: no motion moves the gas of its own muscle,
        and the other one's is wrong later, by a motion that no model says.
        """
        return self.torque.broken == i or self.pressures[i].since >= self.torque.since

    def _of_torque(self) -> Iterator[Finding]:
        torque = self.torque
        explaining = {FaultKind.DRIFTING_SENSOR, FaultKind.BROKEN_CABLE}
        explained = any(explaining & own.suspected for own in self.pressures)
        if torque.broken is not None:
            own = self.pressures[torque.broken]
            since = min(own.since, torque.since) if self._gas and own.suspected else torque.since
            yield Finding((Suspect(FaultKind.BROKEN_CABLE, MUSCLES[torque.broken]),), since)
        elif torque.loaded is not None and not explained:
            yield Finding(_LOAD, torque.loaded)

    def _of_offsets(self) -> Iterator[Finding]:
        for i, own in enumerate(self.pressures):
            if isfinite(self.large[i]) and not own.suspected:  # else a fault keeps the pressure off its command
                yield Finding((Suspect(FaultKind.OFFSET, SENSORS[1 + i], self.offset[i]),), self.large[i])

    def _of_pressure(self, i: int) -> Finding:
        own = self.pressures[i]
        kinds = [kind for kind in FaultKind if kind in own.suspected]
        return Finding(tuple(Suspect(kind, _PARTS.get(kind, MUSCLES)[i]) for kind in kinds), own.since)


def follow(
    one: Numbers, two: Numbers, torque: Numbers, loop: Numbers, k: Joint, t: float, read: Sequence[float],
    v: Sequence[float], omega: float, d: float, pulls: Sequence[float], moved: bool,
) -> None:  # fmt: skip
    """Follow both muscles, the torque and the loop at `t` [s] by what is remembered of each.

    The pressures `read` (2,) [Pa] are NaN if not believed, the commands that act lead to readings of `v` (2,) [Pa],
    `omega` [rad/s] and `d` [N·m] are estimated, and the muscles of the model do what `pulls` (6,) says, see `pulling`.
    The joint has `moved` if all readings are believed, and the angle's is a new one.
    """
    pressure_diagnosis.follow(one, two, k.first, t, read[0], v[0], pulls[2], d, pulls[4])
    pressure_diagnosis.follow(two, one, k.second, t, read[1], v[1], pulls[3], d, pulls[5])
    if moved:
        torque_diagnosis.follow(torque, k.first.dt, k.usual, t, d, pulls[0], pulls[1])
    ringing.follow(loop, k.inertia, t, omega, d)


def less_lost(lost: float, dt: float, tolerance: float) -> tuple[float, bool]:
    """Return how much of a sensor's readings counts as `lost` [s] after one that is believed, and whether that is
    little.
    """
    lost -= dt / _FORGETTING * lost
    little = lost < tolerance / 2
    return (lost if lost > dt / 10 or not little else 0.0), little  # else forgotten


def large_since(since: float, offset: float, t: float) -> float:
    """Return since when [s] the `offset` [Pa] of a sensor is large at the time `t` [s], NaN if it is not."""
    if abs(offset) > LARGE:
        return t if since != since else since
    return since if abs(offset) > LARGE_STILL else nan


def steps(since: float, offset: float) -> float:
    """Return the `offset` [Pa] in the steps of its message, 0 if it is not large `since` any time [s]."""
    return 0.0 if since != since else np.floor(offset / SHOWN + 0.5)


def pulling(plant: Plant) -> "Function":
    """Return the state (4,) ↦ the muscles' torques [N·m], their gains ∂T/∂P [N·m/Pa] and what the motion takes from
    their pressures [Pa/s] (6,), a CasADi function.
    """
    import casadi as ca

    x = ca.SX.sym("x", NX)
    T = ca.vertcat(*(side.torque(x[2 + i]) for i, side in enumerate(plant.joint.sides(x[0]))))
    gains = [ca.jacobian(T[i], x[2 + i]) for i in range(NU)]
    return ca.Function("pulls", [x], [ca.densify(ca.vertcat(T, *gains, *plant.expansion(x)))])


class NoDiagnosis:
    """The diagnosis of an arm: nobody has found out yet what its faults look like."""

    health = WELL

    def reset(self) -> None:
        """Do nothing."""

    def follow(self, said: Array, verdicts: Sequence[Verdict], v: Array, xi: Array, offset: Array) -> None:
        """Do nothing."""


def diagnosis_of(
    plant: Machine, dt: float, sigma: float, compensation: Compensation, tolerance: float
) -> Diagnosis | NoDiagnosis:
    """Return the diagnosis of a joint; there is none of an arm."""
    return Diagnosis(plant, dt, sigma, compensation, tolerance) if isinstance(plant, Plant) else NoDiagnosis()
