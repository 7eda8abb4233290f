"""A gate decides which readings an observer believes: innovation gating within physical bounds.

A reading y of a sensor that should say ŷ, with the variance S of what lies between, is rejected where

    |y - ŷ| > max(6 √S, floor)                              floor: 8 standard deviations of the noise

which rejects one true reading in 5·10⁸ of a model that is right. Before that an angle that is off by whole turns is
unwrapped, and what no sensor of this joint can say counts as silence. From the first rejection on the width is no
longer that of S, which grows while a sensor is not believed and would soon swallow anything; it grows by itself once in
`widening`.

Models are not right, and true motion is rejected too. But rejected readings that a motion of this joint explains are
accepted (`mpc.observer.rivalry`), those that began near what was expected after `hesitation`: a blow, or a load as
great as the muscles' torque T of which nobody tells, moves the joint no farther than 0.9 T dt²/J before the observer
would have found it. What began with a greater jump, as an encoder does that has lost its zero, is accepted after
`patience`.

A sensor that was taken for frozen and moves on by less than such a jump was at rest: a joint that sticks repeats its
angle, while a model without friction expects motion. It is accepted at once. The belief that did without the sensor
has gone astray meanwhile, and is no measure of it.

Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 11.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import isfinite, nan, pi, sqrt
from typing import Self

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG
from mpc.model.machine import Machine

PerSensor = tuple[float, ...]  # (n + m,) of the sensors of angles [rad] and pressures [Pa]

SIGMAS = 6.0  # √S between reading and expectation beyond which a reading is not believed
TURN, MOST_TURNS = 2 * pi, 1e6  # [rad] by which an encoder may be off once, and how often at most
DOUBT = 5.0  # standard deviations between reading and expectation at which a repeated reading is no longer believed
NEAR_A_TURN = 20 * DEG  # an angle is off by whole turns if it is that near to the expected one without them
_MARGIN, _NO_STOPS = 10 * DEG, 90 * DEG  # of the joint range, with end stops and without
_BELOW, _ABOVE, _JUMP = 0.06, 0.1, 0.1  # of the supply range: margins of pressures, and a jump of them
_LEAST = 1 * DEG  # jump of the angle
_NEAR = 0.04  # of the supply range: floor of pressures, which such a reading moves by a tenth of that
ROUGH = 8.0  # standard deviations of the noise: floor, and more than two steps of an encoder


class Verdict(IntEnum):
    """A verdict is what became of a reading."""

    BELIEVED = 0
    ACCEPTED = 1
    SILENT = 2
    IMPOSSIBLE = 3
    REJECTED = 4
    FROZEN = 5

    @property
    def text(self) -> str:
        """Return what it says of the sensor."""
        return _VERDICTS[self]

    @property
    def counts(self) -> bool:
        """Return whether the reading was used."""
        return self <= Verdict.ACCEPTED


_VERDICTS = {
    Verdict.BELIEVED: "The reading is near what was expected.",
    Verdict.ACCEPTED: "The readings had jumped and stayed there, or go on after a rest: the sensor is believed again.",
    Verdict.SILENT: "The sensor says nothing.",
    Verdict.IMPOSSIBLE: "The reading is beyond what the joint range or the supply allow.",
    Verdict.REJECTED: "The reading is too far from what the motion allows.",
    Verdict.FROZEN: "The sensor repeats itself although the joint moves.",
}


@dataclass(frozen=True)
class Gate:
    """The gate's numbers follow from a plant and may be replaced; SI units."""

    lower: PerSensor  # readings below or above say nothing
    upper: PerSensor
    floor: PerSensor  # a reading this near to what is expected is believed
    jump: PerSensor  # a reading farther than this from what is expected is believed only after `patience`
    max_speed: float  # that an estimate may have [rad/s]
    max_torque: float  # the greatest |d| that it may have [N·m]
    hesitation: float = 0.03  # for which rejected readings have to be explained before they are accepted [s]
    patience: float = 0.5  # the same after a jump [s]
    widening: float = 0.2  # in which the width of a gate that rejects grows by itself once [s]

    @classmethod
    def of(cls, plant: Machine, dt: float, noise: tuple[float, float] = (0.0, 0.0)) -> Self:
        """Return what fits `plant`, sampled every `dt` [s] with the standard deviations `noise` of θ [rad] and P
        [Pa].
        """
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
        """Return `theta` [rad] less whole turns, if that is `within` [rad] of the `expected` angle."""
        turns = round((expected - theta) / TURN) if abs(theta) < MOST_TURNS * TURN else 0
        near = theta + TURN * turns
        return near if abs(near - expected) < within else theta

    def possible(self, sensor: int, read: float) -> bool:
        """Return whether the `sensor` can say `read`."""
        return self.lower[sensor] <= read <= self.upper[sensor]


class SensorGate:
    """A sensor's gate is its own: it remembers since when it rejects, and what it rejected last."""

    def __init__(self, gate: Gate, sensor: int, dt: float) -> None:
        self.sensor, self.gate, self.floor, self.jump = sensor, gate, gate.floor[sensor], gate.jump[sensor]
        self._growth = dt / gate.widening  # of the width in a sample [-]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._width = 0.0  # at the first of the rejections that go on
        self._since = 0  # samples since that one, itself included; 0: there are none
        self._refused = nan  # the last reading that was rejected or frozen

    def check(self, read: float, expected: float, variance: float) -> Verdict:
        """Return the verdict on `read` where `expected` is, `variance` being that of their difference."""
        self._since += self._since > 0
        if not isfinite(read):
            return Verdict.SILENT
        if not self.gate.possible(self.sensor, read):
            return Verdict.IMPOSSIBLE
        width = self.width(variance) if self._since == 0 else self._width * (1 + (self._since - 1) * self._growth)
        repeated = read == self._refused  # and expected only because two motions cross
        if abs(read - expected) <= width and not repeated:
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
        """Return how far a reading may be from what is expected, `variance` being that of their difference."""
        return max(SIGMAS * sqrt(variance), self.floor)

    @property
    def quiet(self) -> bool:
        """Return whether it has nothing to remember."""
        return self._since == 0 and not isfinite(self._refused)

    def frozen(self, read: float) -> None:
        """Take note that the sensor is frozen and says `read`."""
        self.reset()
        self._refused = read
