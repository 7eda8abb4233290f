"""Rival belief, which uses the readings that the gates reject and takes over after it has explained them for a time.

It restarts whenever it cannot explain a reading. If an angle jumps and a pressure is rejected, it believes the sensor
of the pressure more than the regulator: the valve may be stuck, and otherwise the observer would stay blind. The time
is `Gate.hesitation` if it began near the expected reading, and `Gate.patience` after a jump. Thus the observer
recovers from a blow, and from an encoder that has lost its zero, even in motion.
"""

from collections.abc import Callable
from math import nan
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from mpc.observer.filter import Belief, Filter
from mpc.observer.gating import SIGMAS, Gate, SensorGate

ONCE = 1.5  # samples; an angle may repeat once when the joint reverses


class Readings(NamedTuple):
    """Readings of a sample, of n angles and m pressures (n + m,)."""

    read: Array  # [rad], [Pa]
    believed: Mask
    rejected: Mask
    repeating: Array  # duration of repetition [s]
    variances: Array  # of the sensors


class Rivalry:
    """Rivalry between an observer's belief and one that uses the readings rejected by the `gates`.

    It ends when nothing has been rejected for `tolerance` seconds.
    """

    def __init__(self, filter: Filter, gates: list[SensorGate], gate: Gate, dt: float, tolerance: float) -> None:
        self._filter, self._gates, self._jump, self._dt = filter, gates, gate.jump, dt
        self._n = filter.plant.n
        times = gate.hesitation, gate.patience, tolerance
        self.hesitation, self.patience, self.crossing = (round(time / dt) for time in times)  # [samples]
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self._contested = np.zeros(len(self._gates), bool)  # contested sensors
        self._doubted = 0  # samples for which the rival has to explain all readings
        self._unrivalled = self.crossing  # samples since anything was rejected
        self.end()

    def end(self) -> None:
        """Discard the rival."""
        self._rival: Belief | None = None
        self._explained = 0  # samples for which it has explained all readings
        self._contested[:] = False

    @property
    def going_on(self) -> bool:
        """Whether there is a rival."""
        return self._rival is not None

    def rest(self, samples: int) -> None:
        """Record that nothing was rejected in so many `samples`."""
        self._unrivalled += samples

    def taken_over(
        self, expected: Belief, y: Readings, predicted: Callable[[Belief], Belief], confirmed: bool
    ) -> Belief | None:
        """Return the rival's belief if it takes over from `expected` at the readings `y`, else None.

        `predicted` maps the belief of the previous sample to the present one. The initial belief is not `confirmed` at
        first; then rejected readings may be right.
        """
        some = bool(y.rejected.any())
        self._unrivalled = 0 if some else self._unrivalled + 1
        if self._unrivalled > self.crossing:  # not at once: it may be near by chance when two motions cross
            self.end()
        if self._rival is None and not some:
            return None
        used = y.believed | y.rejected
        rival = self._rival and self._loosened(predicted(self._rival), y.rejected)
        if rival is None or not self._explains(rival, y, used):
            rival = self._begun(expected, y)
        elif (y.rejected & ~self._contested)[: self._n].any():
            self._doubt(expected, y)
        self._count(y, used)
        if not some or (self._explained <= self._doubted and confirmed):
            self._rival = self._filter.corrected(rival, y.read, used, y.variances)
            return None
        self.end()
        return rival

    def _loosened(self, rival: Belief, rejected: Mask) -> Belief:
        """Return the rival without trust in regulators of rejected pressures, if an angle has jumped as well."""
        n = self._n
        if self._doubted < self.patience or not rejected[:n].any() or not rejected[n:].any():
            return rival
        covariance = rival.covariance.copy()
        for i in np.flatnonzero(rejected[n:]) + n:
            j = self._filter.measured[i]
            covariance[j, j] += (self._jump[i] / SIGMAS) ** 2
        return Belief(rival.xi, covariance)

    def _begun(self, expected: Belief, y: Readings) -> Belief:
        self._doubt(expected, y)
        return self._filter.unsure_at(expected, y.read, y.rejected)

    def _doubt(self, expected: Belief, y: Readings) -> None:
        """Set the time for which a rival has to explain readings, by the distance at which they begin."""
        far = y.rejected & ~(np.abs(y.read - self._filter.foreseen(expected)) <= self._jump)
        thrown = bool(y.rejected[: self._n].any())  # the muscle of a snapped cable shortens at once: P may jump
        self._doubted = self.patience if far[: self._n if thrown else None].any() else self.hesitation
        self._explained = 0

    def _count(self, y: Readings, used: Mask) -> None:
        """Count a sample that the rival has explained."""
        self._contested |= y.rejected
        repeating = float(y.repeating[self._contested].max(initial=0.0))
        if repeating > ONCE * self._dt:  # not after a blow, but for a sensor that sticks
            self._doubted = self.patience
        elif repeating > 0:  # it may be about to stick, or the joint creeps over the steps of its encoder
            return
        self._explained += bool((used & self._contested).any())

    def _explains(self, belief: Belief, y: Readings, used: Mask) -> bool:
        """Return whether the readings `used` (n + m,) are as near to the `belief` as true ones."""
        variance = (self._filter.variances(belief) + y.variances).tolist()
        width = [max(gate.width(v), gate.jump) if v > 0 else nan for gate, v in zip(self._gates, variance, strict=True)]
        return bool((np.abs(y.read - self._filter.foreseen(belief)) <= width)[used].all())
