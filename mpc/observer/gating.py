"""Gates of readings: innovation gating within physical bounds.

A reading y with the expected value ŷ and the variance S of their difference is rejected if

    |y - ŷ| > max(6 √S, floor)                              floor: 8 standard deviations of the noise

which rejects one true reading in 5·10⁸ if the model is exact. Unless the lags of the regulators were measured, ŷ of a
pressure is the value nearest to y between those of a quick and of a slow regulator (`Filter.apart`). Before this test,
angles that are off by whole turns are unwrapped, and impossible readings count as silence. S grows while a sensor is
not believed and would soon include any reading; after the first rejection the width is therefore no longer that of S,
and grows by its first value per `widening`.

No model is exact, so that true motion is sometimes rejected. But rejected readings that a motion of this joint explains
are accepted (`mpc.observer.rivalry`). Those that began near the expected value are accepted after `hesitation`: a blow,
or an unknown load as great as the muscles' torque T, moves the joint no farther than 0.9 T dt²/J before the observer
would have detected it. Those that began with a greater jump, like an encoder that has lost its zero, are accepted after
`patience`. If angles and pressures are rejected, the angles decide: the muscle of a snapped cable shortens at once, and
its pressure jumps.

If a sensor was taken for frozen and then moves by less than such a jump, it was at rest: a sticking joint repeats its
angle, while a model without friction expects motion. It is accepted at once, because the belief without the sensor has
drifted meanwhile.

Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 11.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import isfinite, nan, pi, sqrt
from typing import Self

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG
from mpc.model.machine import Machine, check_machine

PerSensor = tuple[float, ...]  # (n + m,) of the sensors of angles [rad] and pressures [Pa]

SIGMAS = 6.0  # [√S] from the expected value, beyond which a reading is not believed
TURN, MOST_TURNS = 2 * pi, 1e6  # [rad] error of an encoder per turn, and most turns
DOUBT = 5.0  # [standard deviations] from the expected value, beyond which a repeated reading is not believed
NEAR_A_TURN = 20 * DEG  # distance from the expected angle up to which whole turns are removed
_MARGIN, _NO_STOPS = 10 * DEG, 90 * DEG  # of the joint range, with end stops and without
_BELOW, _ABOVE, _JUMP = 0.06, 0.1, 0.1  # [-] of the supply range: margins of pressures, and their jump
_LEAST = 1 * DEG  # jump of the angle
_NEAR = 0.04  # [-] of the supply range: floor of pressures; such a reading moves P̂ by a tenth of that
ROUNDING = 1e-9  # [rad] a lesser change of an angle is no step of an encoder, but rounding in its unit
ROUGH = 8.0  # [standard deviations] of the noise: floor, more than two steps of an encoder


class Verdict(IntEnum):
    """Verdict on a reading."""

    BELIEVED = 0
    ACCEPTED = 1
    SILENT = 2
    IMPOSSIBLE = 3
    REJECTED = 4
    FROZEN = 5

    @property
    def text(self) -> str:
        """Description of this verdict."""
        return _VERDICTS[self]

    @property
    def counts(self) -> bool:
        """Whether the reading was used."""
        return self <= Verdict.ACCEPTED


_VERDICTS = {
    Verdict.BELIEVED: "The reading is near the expected one.",
    Verdict.ACCEPTED: "The readings had jumped and stayed there, or go on after a rest: the sensor is believed again.",
    Verdict.SILENT: "The sensor says nothing.",
    Verdict.IMPOSSIBLE: "The reading is beyond what the joint range or the supply allow.",
    Verdict.REJECTED: "The reading is too far from what the motion allows.",
    Verdict.FROZEN: "The sensor repeats itself although the joint moves.",
}


@dataclass(frozen=True)
class Gate:
    """Constants of the gates, derived from a plant; SI units."""

    lower: PerSensor  # readings below or above are impossible
    upper: PerSensor
    floor: PerSensor  # a reading this near to the expected value is believed
    jump: PerSensor  # a reading farther than this from the expected value is believed only after `patience`
    max_speed: float  # of an estimate [rad/s]
    max_torque: float  # greatest |d| of an estimate [N·m]
    hesitation: float = 0.03  # time of explained rejected readings before they are accepted [s]
    patience: float = 0.5  # the same after a jump [s]
    widening: float = 0.2  # in which the width of a rejecting gate grows by its first value [s]

    @classmethod
    def of(cls, plant: Machine, dt: float, noise: tuple[float, float] = (0.0, 0.0)) -> Self:
        """Return the gate for `plant`, sampled every `dt` [s] with the standard deviations `noise` of θ [rad] and P
        [Pa]. Raises `InvalidInput` for anything but a `Plant` or an `Arm`.
        """
        check_machine(plant)
        (left, right), (low, high) = map(np.atleast_1d, plant.angle_limits), plant.pressure_limits
        (T, T_most), supply, span, inertia = plant.torque_reach(), high - low, right - left, plant.inertias
        margin = _MARGIN if plant.has_stops else _NO_STOPS
        jump = np.minimum(np.maximum(_LEAST, 0.9 * T * dt**2 / inertia), span / 4)
        theta, pressure = (ROUGH * deviation for deviation in noise)

        def rows(angles: Array, of_pressure: float) -> PerSensor:
            return *angles.tolist(), *[of_pressure] * plant.m

        return cls(
            rows(left - margin, low - _BELOW * supply),
            rows(right + margin, high + _ABOVE * supply),
            rows(np.full(plant.n, theta), max(pressure, _NEAR * supply)),
            rows(jump + theta, _JUMP * supply),
            float(np.sqrt(T_most * span / inertia).max()),  # half of the range to get there, half to brake
            3 * float(T_most.max()),
        )

    def unwrapped(self, theta: float, expected: float, within: float = NEAR_A_TURN) -> float:
        """Return `theta` [rad] without whole turns, if that is `within` [rad] of the `expected` angle."""
        turns = round((expected - theta) / TURN) if abs(theta) < MOST_TURNS * TURN else 0
        near = theta + TURN * turns
        return near if abs(near - expected) < within else theta

    def possible(self, sensor: int, read: float) -> bool:
        """Return whether the `sensor` can return `read`."""
        return self.lower[sensor] <= read <= self.upper[sensor]

    def first_verdicts(self, read: Array) -> list[Verdict]:
        """Return the verdicts on the readings (n + m,) of all sensors, if nothing is expected of them."""
        possible = map(self.possible, range(read.size), read.tolist())
        beyond = np.where(np.isfinite(read), Verdict.IMPOSSIBLE, Verdict.SILENT).tolist()
        return [Verdict.BELIEVED if there else Verdict(other) for there, other in zip(possible, beyond, strict=True)]


class SensorGate:
    """Gate of one sensor, with the time since its first rejection and the last rejected reading."""

    def __init__(self, gate: Gate, sensor: int, dt: float) -> None:
        self.sensor, self.gate, self.floor, self.jump = sensor, gate, gate.floor[sensor], gate.jump[sensor]
        self._growth = dt / gate.widening  # of the width in a sample [-]
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self._width = 0.0  # at the first of the present rejections
        self._since = 0  # samples since the first one, inclusive; 0: there are none
        self._refused = nan  # the last rejected or frozen reading

    def check(self, read: float, least: float, most: float, variance: float) -> Verdict:
        """Return the verdict on `read` if values from `least` to `most` are expected, with this `variance`."""
        self._since += self._since > 0
        if not isfinite(read):
            return Verdict.SILENT
        if not self.gate.possible(self.sensor, read):
            return Verdict.IMPOSSIBLE
        width = self.width(variance) if self._since == 0 else self._width * (1 + (self._since - 1) * self._growth)
        repeated = read == self._refused  # and expected only because two motions cross
        if abs(read - min(max(read, least), most)) <= width and not repeated:
            self.reset()
            return Verdict.BELIEVED
        if self._since == 0 and not repeated and abs(read - self._refused) <= self.jump:  # it was at rest, not frozen
            self.reset()
            return Verdict.ACCEPTED
        if self._since == 0:
            self._width, self._since = width, 1
        self._refused = read
        return Verdict.REJECTED

    def width(self, variance: float) -> float:
        """Return the greatest accepted distance from the expected value; `variance` is that of the difference."""
        return max(SIGMAS * sqrt(variance), self.floor)

    @property
    def quiet(self) -> bool:
        """Whether the gate has no memory of rejections."""
        return self._since == 0 and not isfinite(self._refused)

    def frozen(self, read: float) -> None:
        """Record that the sensor is frozen at `read`."""
        self.reset()
        self._refused = read
