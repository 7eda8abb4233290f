"""What an observer has anyway is turned into the `Health` of the joint, sample by sample.

Three parts look for what they understand: `mpc.observer.pressure_diagnosis` at each muscle's pressure against its
command, `mpc.observer.torque_diagnosis` at the disturbance torque, and this file at the observer's own flags. One cause
is assumed where one explains all: two pressures that are both too low have a low supply, and a torque that a broken
cable or a drifting pressure sensor accounts for is no load.
"""

from collections.abc import Iterator, Sequence
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.model.buffered import Buffered
from mpc.model.compensation import Compensation
from mpc.model.plant import NU, NX, Plant
from mpc.observer.gating import Verdict
from mpc.observer.health import MUSCLES, SENSORS, WELL, FaultKind, Finding, Health, Part, Suspect
from mpc.observer.pressure_diagnosis import PressureDiagnosis
from mpc.observer.torque_diagnosis import TorqueDiagnosis

_FORGETTING = 1.0  # [s]: readings lost longer ago hardly count
_PARTS = {FaultKind.SUPPLY_DROP: (Part.SUPPLY, Part.SUPPLY), FaultKind.DRIFTING_SENSOR: SENSORS[1:]}  # else the muscle
_FLAGS = {
    Verdict.SILENT: FaultKind.SILENT_SENSOR,
    Verdict.IMPOSSIBLE: FaultKind.REJECTED_SENSOR,
    Verdict.REJECTED: FaultKind.REJECTED_SENSOR,
    Verdict.FROZEN: FaultKind.FROZEN_SENSOR,
}
_REJECTED_ANGLE = Suspect(FaultKind.REJECTED_SENSOR, Part.ANGLE)
_LOAD = Suspect(FaultKind.LOAD, Part.JOINT), Suspect(FaultKind.DRIFTING_SENSOR, Part.ANGLE)
_LOW_SUPPLY = (Suspect(FaultKind.SUPPLY_DROP, Part.SUPPLY),)


class Diagnosis:
    """A diagnosis is fed once a sample by the observer of `plant`, whose sensors deviate by `sigma` [Pa] in the
    pressures.

    A sensor is suspected that has lost `tolerance` seconds of readings lately, or at once when it is frozen.
    """

    def __init__(self, plant: Plant, dt: float, sigma: float, compensation: Compensation, tolerance: float) -> None:
        self.dt, self.tolerance = dt, tolerance
        self._pulls = Buffered(_pulls(plant))
        middle, P = float(np.mean(plant.joint.angle_range)), float(np.mean(plant.joint.pressure_limits))
        usual = float(np.abs(self._pulls(np.array([middle, 0.0, P, P]))[0][0, :NU]).mean())
        self._pressures = [PressureDiagnosis(lag, dt, compensation.dead_band, sigma, usual) for lag in plant.lags]
        self._torque = TorqueDiagnosis(dt, usual)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.health = WELL
        self._t = 0.0
        self._theta = nan  # last reading
        self._lost = [0.0, 0.0, 0.0]  # of each sensor's readings lately [s]
        self._said = [nan, nan, nan]  # by a sensor whose readings are being lost, a sample ago
        self._sensors: list[Finding | None] = [None, None, None]
        self._known: tuple[Any, ...] = ()
        self._low_supply = False
        self._torque.reset()
        for pressure in self._pressures:
            pressure.reset()

    def follow(self, said: Array, verdicts: Sequence[Verdict], v: Array, xi: Array) -> None:
        """Follow what the sensors have `said` (3,), which was checked.

        The commands `v` (2,) [Pa] act, and `xi` (5,) is estimated.
        """
        believed = [self._sensor(i, *one) for i, one in enumerate(zip(said.tolist(), verdicts, strict=True))]
        d, pulls = float(xi[NX]), self._pulls(xi[:NX])[0][0].tolist()
        if all(map(isfinite, (d, *pulls))):
            self._follow(believed, v.tolist(), d, *pulls, known=all(verdict.counts for verdict in verdicts))
        self._t += self.dt
        self._conclude()

    def _follow(
        self, believed: list[float], v: list[float], d: float, T1: float, T2: float, *rest: float, known: bool
    ) -> None:
        (one, two), (gain1, gain2, q1, q2) = self._pressures, rest
        one.follow(self._t, believed[1], v[0], gain1, d, two, q1)
        two.follow(self._t, believed[2], v[1], gain2, d, one, q2)
        if known and believed[0] != self._theta:  # d̂ makes up for what is not known; a repeated angle may be frozen
            self._torque.follow(self._t, d, T1, T2)
        self._theta = believed[0]

    def _sensor(self, i: int, said: float, verdict: Verdict) -> float:
        """Return the reading, NaN if it is not believed; note whether the sensor is suspected."""
        lost = not verdict.counts
        if not lost and not self._lost[i]:
            return said
        if verdict is Verdict.REJECTED and i and self._pressures[i - 1].suspected:
            return said  # the observer does not know of what would explain it
        self._lost[i] += self.dt * lost - self.dt / _FORGETTING * self._lost[i]
        old, repeated = self._sensors[i], said == self._said[i]
        self._said[i] = said
        if lost and (self._lost[i] > self.tolerance or verdict is Verdict.FROZEN):
            kind = FaultKind.FROZEN_SENSOR if repeated and verdict is Verdict.REJECTED else _FLAGS[verdict]
            self._sensors[i] = Finding((Suspect(kind, SENSORS[i]),), old.since if old else self._t)
        elif not lost and self._lost[i] < self.tolerance / 2:
            self._sensors[i] = None
            self._lost[i] *= self._lost[i] > self.dt / 10  # else forgotten
        return nan if lost else said

    def _conclude(self) -> None:
        torque, (one, two) = self._torque, self._pressures
        known = one.suspected, two.suspected, torque.broken, torque.loaded, *self._sensors
        if known == self._known:
            return
        self._known = known
        findings = [*self._of_sensors(), *self._of_pressures(), *self._of_torque()]
        self.health = Health(tuple(findings)) if findings else WELL

    def _of_sensors(self) -> Iterator[Finding]:
        others = [own.since for own in self._pressures if own.suspected]
        others += [] if self._torque.broken is None else [self._torque.since]
        for finding in self._sensors:
            if finding and not (finding.suspects[0] == _REJECTED_ANGLE and min(others, default=inf) < finding.since):
                yield finding  # else another fault threw the joint out of its range

    def _of_pressures(self) -> Iterator[Finding]:
        one, two = self._pressures
        common = FaultKind.SUPPLY_DROP in one.suspected & two.suspected or bool(one.low and two.low)
        suspected = [own for own in self._pressures if own.suspected]
        self._low_supply = bool(suspected) and (self._low_supply or (len(suspected) == NU and common))
        if self._low_supply:
            yield Finding(_LOW_SUPPLY, min(own.since for own in suspected))
        else:
            yield from (self._of_pressure(i) for i, own in enumerate(self._pressures) if own.suspected)

    def _of_torque(self) -> Iterator[Finding]:
        torque = self._torque
        drifting = any(FaultKind.DRIFTING_SENSOR in own.suspected for own in self._pressures)
        if torque.broken is not None:
            yield Finding((Suspect(FaultKind.BROKEN_CABLE, MUSCLES[torque.broken]),), torque.since)
        elif torque.loaded is not None and not drifting:
            yield Finding(_LOAD, torque.loaded)

    def _of_pressure(self, i: int) -> Finding:
        own = self._pressures[i]
        kinds = [kind for kind in FaultKind if kind in own.suspected]
        return Finding(tuple(Suspect(kind, _PARTS.get(kind, MUSCLES)[i]) for kind in kinds), own.since)


def _pulls(plant: Plant) -> Any:
    """Return the state (4,) ↦ the muscles' torques [N·m], their gains ∂T/∂P [N·m/Pa] and what the motion takes from
    their pressures [Pa/s] (6,), a CasADi function.
    """
    import casadi as ca

    x = ca.SX.sym("x", NX)
    T = ca.vertcat(*(side.torque(x[2 + i]) for i, side in enumerate(plant.joint.sides(x[0]))))
    gains = [ca.jacobian(T[i], x[2 + i]) for i in range(NU)]
    return ca.Function("pulls", [x], [ca.densify(ca.vertcat(T, *gains, *plant.expansion(x)))])


__all__ = ["Diagnosis"]
