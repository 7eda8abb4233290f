"""Sensors of simulated machines, and faults to inject into them, each from `begin` until just before `end`.

A fault changes the command that a regulator follows, the readings of sensors, or the muscles that pull, and leaves
everything else unchanged. (A payload is a torque, not a fault: `RealPlant.torque_profile`. `mpc.observer.health` names
faults from the quantities of an observer.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.mechanism.routes.base import per_muscle
from allocator.units import BAR
from mpc.model.plant import NU


@dataclass(frozen=True)
class Fault:
    """Base of all faults, without an effect; each subclass has one effect.

    Muscles count from 1, as in the report. Sensors are indices of the state (2n + m,) of a machine with n `joints` and
    m `muscles`: (θ, ω, P1, P2) of one joint.
    """

    begin: float = 0.0  # [s]
    end: float = inf  # [s]
    joints: int = field(default=1, kw_only=True)
    muscles: int = field(default=NU, kw_only=True)

    def __post_init__(self) -> None:
        """Check the window."""
        if not 0 <= self.begin < self.end:
            raise InvalidInput(f"begin = {self.begin!r} s, end = {self.end!r} s: a fault ends after it has begun")

    @property
    def size(self) -> int:
        """Number of sensors and states, 2n + m."""
        return 2 * self.joints + self.muscles

    @property
    def _places(self) -> str:
        if (self.joints, self.muscles) == (1, NU):
            return "0, 1, 2, 3: theta, omega, P1, P2"
        return f"0 to {self.size - 1}: n = {self.joints} angles, as many speeds, m = {self.muscles} pressures"

    def active(self, t: float) -> bool:
        """Return whether the fault is present at the time `t` [s]."""
        return self.begin - 1e-9 <= t < self.end - 1e-9

    def effective(self, u: Array, P: Array) -> Array:
        """Return the commands (m,) [Pa] that the regulators follow instead of `u` [Pa] at the pressures `P` [Pa]."""
        return u

    def read(self, y: Array, previous: Array) -> Array:
        """Return the readings (2n + m,) instead of `y`; `previous` are those of the previous sample."""
        return y

    def offset(self, t: float) -> Array:
        """Return the offsets of the sensors (2n + m,) at the time `t` [s], before `read`."""
        return np.zeros(self.size)

    @property
    def pulling(self) -> tuple[float, ...]:
        """Shares (m,) of the muscles' forces that reach the joints."""
        return (1.0,) * self.muscles

    @property
    def shut(self) -> tuple[bool, ...]:
        """Which valves (m,) stay shut, so that the gas behind them is trapped."""
        return (False,) * self.muscles


@dataclass(frozen=True)
class _MuscleFault(Fault):
    muscle: int = 1

    def __post_init__(self) -> None:
        """Check the window and the muscle."""
        Fault.__post_init__(self)
        if type(self.muscle) is not int or not 1 <= self.muscle <= self.muscles:
            known = "1 (agonist) or 2 (antagonist)" if self.muscles == NU else f"one of 1 to {self.muscles}"
            raise InvalidInput(f"muscle = {self.muscle!r} has to be {known}")

    @property
    def _its(self) -> list[bool]:
        """Mask (m,) of its muscle."""
        return [own + 1 == self.muscle for own in range(self.muscles)]

    def _with(self, u: Array, value: float) -> Array:
        return np.where(self._its, value, u)


@dataclass(frozen=True)
class Leak(_MuscleFault):
    """Leak of a muscle: its pressure cannot rise, and falls unless the regulator can hold the `kept` share."""

    kept: float = 0.9  # greatest target of the regulator as a share of the pressure [-]

    def effective(self, u: Array, P: Array) -> Array:
        """Return at most the `kept` share of the present pressure."""
        own = self.muscle - 1
        return self._with(u, min(float(u[own]), self.kept * float(P[own])))


@dataclass(frozen=True)
class StuckValve(_MuscleFault):
    """Valve that stays shut: the pressure changes only by the motion, which compresses the trapped gas."""

    def effective(self, u: Array, P: Array) -> Array:
        """Return the present pressure."""
        return self._with(u, float(P[self.muscle - 1]))

    @property
    def shut(self) -> tuple[bool, ...]:
        """Mask of its muscle's valve."""
        return tuple(self._its)


@dataclass(frozen=True)
class BrokenCable(_MuscleFault):
    """Broken cable: its muscle fills and empties as before, but does not pull."""

    @property
    def pulling(self) -> tuple[float, ...]:
        """Shares (m,): 0 for this muscle's force and 1 for the others."""
        return tuple(float(not its) for its in self._its)


@dataclass(frozen=True)
class SupplyDrop(Fault):
    """Drop of the supply's pressure, which limits all muscles."""

    supply: float = 3 * BAR  # [Pa]

    def effective(self, u: Array, P: Array) -> Array:
        """Return the commands up to the supply."""
        return np.minimum(u, self.supply)


@dataclass(frozen=True)
class _SensorFault(Fault):
    sensors: tuple[int, ...] = (0, 2, 3)  # of (θ, ω, P1, P2)

    def __post_init__(self) -> None:
        """Check the window and the sensors."""
        Fault.__post_init__(self)
        if not set(self.sensors) <= set(range(self.size)):
            raise InvalidInput(f"sensors = {self.sensors!r} have to be among {self._places}")

    def _of_ours(self, ours: Array, y: Array) -> Array:
        return np.where(np.isin(np.arange(self.size), self.sensors), ours, y)


@dataclass(frozen=True)
class WrongReadings(_SensorFault):
    """Sensors that read `value` [rad], [Pa], or the truth plus `value`."""

    value: float = 0.0
    added: bool = False

    def read(self, y: Array, previous: Array) -> Array:
        """Return the wrong readings."""
        return self._of_ours(y + self.value if self.added else np.full(self.size, self.value), y)


@dataclass(frozen=True)
class SilentSensors(_SensorFault):
    """Sensors without readings."""

    def read(self, y: Array, previous: Array) -> Array:
        """Return the readings with NaN for the silent sensors."""
        return self._of_ours(np.full(self.size, np.nan), y)


@dataclass(frozen=True)
class FrozenSensors(_SensorFault):
    """Sensors that repeat their last readings."""

    def read(self, y: Array, previous: Array) -> Array:
        """Return the readings with the previous ones for the frozen sensors."""
        return self._of_ours(np.where(np.isnan(previous), y, previous), y)  # there is no reading before the first one


@dataclass(frozen=True)
class DriftingSensor(Fault):
    """Sensor whose error grows at a constant `rate`, from zero at `begin`."""

    sensor: int = 2  # of (θ, ω, P1, P2)
    rate: float = 0.1 * BAR  # [Pa/s], or [rad/s] of an angle

    def __post_init__(self) -> None:
        """Check the window, the sensor and the rate."""
        Fault.__post_init__(self)
        if self.sensor not in range(self.size):
            raise InvalidInput(f"sensor = {self.sensor!r} has to be one of {self._places}")
        if not np.isfinite(self.rate):
            raise InvalidInput(f"rate = {self.rate!r} has to be a finite number of Pa/s, or of rad/s for an angle")

    def offset(self, t: float) -> Array:
        """Return the rate times the time since `begin`."""
        return np.where(np.arange(self.size) == self.sensor, self.rate * (t - self.begin), 0.0)


class Sensors:
    """Sensors of n joints and m muscles.

    Encoders have steps of `encoder` [rad or m]. Pressure sensors have the offset `pressure_offset` [Pa], a number or a
    row (m,), and noise of the standard deviation `pressure_noise` [Pa]. `faults` are made with `joints=n, muscles=m`.
    """

    def __init__(
        self, n: int, m: int, encoder: float, pressure_noise: float, pressure_offset: ArrayLike, faults: Sequence[Fault]
    ) -> None:
        """Check the numbers. Raises `InvalidInput`."""
        self.n, self.m = n, m
        self.encoder = checks.not_negative("encoder", encoder, "rad")
        self.pressure_noise = checks.not_negative("pressure_noise", pressure_noise, "Pa")
        self.pressure_offset = per_muscle("pressure_offset", pressure_offset, m, "Pa")
        self.faults = tuple(faults)
        for fault in self.faults:
            if not isinstance(fault, Fault) or (fault.joints, fault.muscles) != (n, m):
                raise InvalidInput(f"faults: {fault!r} is not one of joints={n}, muscles={m}; give it these numbers")
        self.begin(0)

    @property
    def exact(self) -> bool:
        """Whether the readings are exact."""
        return not (self.encoder or self.pressure_noise or self.pressure_offset.any() or self.faults)

    def begin(self, seed: int) -> None:
        """Restart with the noise of the `seed`."""
        self._noise = np.random.default_rng(seed)
        self._said = np.full(2 * self.n + self.m, np.nan)  # readings of the previous sample

    def active(self, t: float) -> list[Fault]:
        """Return the faults that are active at the time `t` [s]."""
        return [fault for fault in self.faults if fault.active(t)]

    def broken(self, t: float) -> tuple[Array, Mask]:
        """Return the remaining shares (m,) of the muscles' forces at the time `t` [s], and the valves (m,) shut by
        faults.
        """
        pulling, shut = np.ones(self.m), np.zeros(self.m, bool)
        for fault in self.active(t):
            pulling, shut = pulling * np.array(fault.pulling), shut | np.array(fault.shut)
        return pulling, shut

    def effective(self, command: Array, P: Array, t: float) -> Array:
        """Return the regulators' inputs (m,) [Pa] instead of a `command` at the pressures `P` and the time `t`."""
        for fault in self.active(t):
            command = fault.effective(command, P)
        return command

    def read(self, q: Array, P: Array, t: float, noise: Array | None = None) -> Array:
        """Return the readings (2n + m,) of the angles `q` (n,) and pressures `P` (m,) at the time `t` [s], NaN for the
        velocities, with the `noise` (m,) of the pressure sensors in standard deviations, by default new noise.
        """
        if self.encoder:
            q = self.encoder * np.round(q / self.encoder)
        noise = self._noise.standard_normal(self.m) if noise is None else noise
        P = P + self.pressure_offset + self.pressure_noise * noise
        y = np.concatenate([q, np.full(self.n, np.nan), P])
        for fault in self.active(t):
            y = fault.read(y + fault.offset(t), self._said)
        self._said = y
        return y
