"""Simulated machines with effects of real ones: their experiment, and the effects that joints and arms share.

A `RealPlant` and a `RealArm` have a nominal machine (n joints, m muscles) and the same effects, see
`mpc.model.real`: force gains, friction at the joints, regulators with two lags, a dead band, a flow limit and a
dead time, sensors with steps, offsets, noise and age, and faults.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from math import ceil, inf, isfinite, prod
from typing import Any, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.lazy import Function
from allocator.units import BAR
from mpc.codegen.buffered import Buffered
from mpc.model.compensation import Compensation, check_regulators
from mpc.model.experiment import FINE
from mpc.model.faults import Fault, Sensors
from mpc.model.friction.contact import Hysteresis
from mpc.model.friction.dahl import Friction
from mpc.model.machine import Machine
from mpc.model.plant import MOST_SUBSTEPS, Plant
from mpc.model.pressures import pull


@dataclass(frozen=True, repr=False)
class RealMachine(ABC):
    """Nominal machine with model errors, friction, delays and faults added. Immutable; SI units.

    The default of its field turns an effect off.
    """

    nominal: Any  # joint or arm with n joints and m muscles
    force_gains: tuple[float, ...] = ()  # g (m,) [-]; by default 1; 0 for a broken cable
    friction: Any = field(default_factory=Friction)
    dead_time: float = 0.0  # t_dead of the commands [s]
    dead_band: float = 0.0  # [Pa], total: a regulator does not act within half of it on either side
    lag_up: float | None = None  # time constant of a rising pressure [s], the geometric mean of all muscles, whose
    lag_down: float | None = None  # ratios are those of the nominal lags; of a falling one. None: the nominal machine's
    flow: float = inf  # fastest change of a pressure [Pa/s]
    encoder: float = 0.0  # step [rad]
    reading_age: float = 0.0  # t_age of the angles' readings [s]
    pressure_noise: float = 0.0  # standard deviation [Pa], white from sample to sample
    pressure_offset: tuple[float, ...] = ()  # o (m,), added to the readings [Pa]; by default 0
    torque_profile: tuple[tuple[float, Any], ...] = ()  # (from time [s] on, external torque [N·m]), in order
    shut: tuple[bool, ...] = ()  # valves (m,) that stay shut for any command
    faults: tuple[Fault, ...] = ()  # each in its time window, the first one nearest to the machine

    def __post_init__(self) -> None:
        """Check the effects, fill in the defaults and convert numbers to floats. Raises `InvalidInput`."""
        m = self.nominal.m
        for name, usual in (("force_gains", 1.0), ("pressure_offset", 0.0), ("shut", False)):
            values = checks.row(name, getattr(self, name))
            if len(values or (usual,) * m) != m:
                raise InvalidInput(f"{name} = {checks.brief(values)} has to be m = {m} numbers, one a muscle")
            object.__setattr__(self, name, values or (usual,) * m)
        for fault in checks.row("faults", self.faults):
            checks.instance("faults: an entry", fault, Fault, "a Fault")
        for name, unit in _UNITS:
            object.__setattr__(self, name, checks.not_negative(name, getattr(self, name), unit))
        check_regulators(self)
        offsets = tuple(checks.number("pressure_offset", offset, "Pa") for offset in self.pressure_offset)
        if max(map(abs, offsets)) > BAR:
            raise InvalidInput(f"pressure_offset = {offsets} Pa has to lie within ±1e5 Pa")
        object.__setattr__(self, "pressure_offset", offsets)
        gains = tuple(checks.not_negative("force_gains: an entry", g, "-") for g in self.force_gains)
        object.__setattr__(self, "force_gains", gains)
        profile = [
            checks.pair("torque_profile: an entry", entry, "has to be a pair (time [s], torque [N·m])")
            for entry in checks.row("torque_profile", self.torque_profile)
        ]
        times = [t for t, _ in profile]
        finite = all(isfinite(t) and np.isfinite(torque).all() for t, torque in profile)
        if not finite or times != sorted(times):
            raise InvalidInput(
                f"torque_profile = {self.torque_profile} has to be finite pairs (s, N·m), times in order"
            )

    def __repr__(self) -> str:
        exact = type(self)(self.nominal)
        effects = [f.name for f in fields(self) if getattr(self, f.name) != getattr(exact, f.name)]
        differs = f"differs in {', '.join(effects)}" if effects else "without effects"
        return f"{type(self).__name__}: {differs}; nominal {self.nominal!r}"

    @classmethod
    def of(cls, machine: Machine, known: Compensation, **effects: Any) -> Self:
        """Return `machine` with the `known` friction and regulators, and further `effects` by name."""
        told = {name: value for name, value in vars(known).items() if name != "frictions"}
        told["friction"] = known.friction if isinstance(machine, Plant) else known.of_joints(machine.n)
        return cls(machine, **(told | effects))

    @property
    def frictions(self) -> tuple[Hysteresis, ...]:
        """Friction of each joint."""
        return self.friction if isinstance(self.friction, tuple) else (self.friction,)

    @property
    def lags(self) -> tuple[tuple[float, float], ...]:
        """Time constants [s] of the rising and the falling pressure of each muscle."""
        lags, mean = self.nominal.lags, prod(self.nominal.lags) ** (1 / self.nominal.m)
        up, down = (
            tuple(float(way) if one is None else float(one * (lag / mean)) for lag, way in zip(lags, ways, strict=True))
            for one, ways in zip((self.lag_up, self.lag_down), self.nominal.lags_each_way, strict=True)
        )
        return tuple(zip(up, down, strict=True))

    def substeps(self, dt: float, resolution: float) -> int:
        """Return the number of equal steps over `dt` [s] of the nominal machine, or more for shorter lags.

        Raises `InvalidInput` like that of the nominal machine.
        """
        least: int = self.nominal.substeps(dt, resolution)
        shortest = min(map(min, self.lags))
        steps = dt / shortest / resolution
        if steps > MOST_SUBSTEPS:
            raise InvalidInput(
                f"lag_up or lag_down = {shortest:.3g} s is so short that dt = {dt:g} s would take {steps:.3g} steps of "
                f"integration, over {MOST_SUBSTEPS}; omit such a short lag or give 1e-3 s"
            )
        return max(least, ceil(steps))

    def at_rest(self, theta: Any, K: Any) -> Array:
        """Return the nominal machine's state at rest (2n + m,), from which this one drifts until it settles."""
        return np.asarray(self.nominal.at_rest(theta, K))

    def begin(self, dt: float, x0: Array, seed: int) -> "RealExperiment":
        """Begin an experiment from `x0` (2n + m,) with commands every `dt` [s] and the `seed` of the sensors' noise."""
        return RealExperiment(self, dt, x0, seed)

    def regulated(self, error: Sequence[Value]) -> list[Value]:
        """Return the rates of the pressures [Pa/s] by regulators with these errors [Pa], CasADi symbols."""
        import casadi as ca

        rest = self.dead_band / 2
        passed = [ca.fmax(e - rest, 0.0) + ca.fmin(e + rest, 0.0) for e in error]
        return [
            0.0 if shut else ca.fmin(ca.fmax(pull(e, *lags), -self.flow), self.flow)
            for e, lags, shut in zip(passed, self.lags, self.shut, strict=True)
        ]

    @abstractmethod
    def symbolic_outputs(self, x: Value) -> tuple[Value, Value, Value]:
        """Return the true stiffness by its upper triangle, the torques (n,) and the forces (m,), CasADi symbols."""

    @abstractmethod
    def stepped(self, x: Value, memory: Value, u: Value, d: Value, h: Value) -> tuple[Value, Value]:
        """Return `x` (2n + m,) and the frictions' `memory` after a fine step of `h` [s], CasADi symbols."""


def delayed(dead_time: float, dt: float) -> tuple[list[float], int]:
    """Return the pieces [s] of a sample of `dt` [s] by acting command, oldest first, and the number of delayed
    commands.

    There are two pieces if the dead time is not a whole number of samples: the older command acts in the first one.
    """
    whole = int(dead_time / dt * (1 + 1e-12))
    late = dead_time - whole * dt
    pieces = [late, dt - late] if late > 1e-9 * dt else [dt]
    return pieces, whole + len(pieces) - 1


def fine_steps(real: Plant | RealMachine, dt: float, pieces: Sequence[float]) -> list[int]:
    """Return the numbers of fine steps of the `pieces` [s] of a sample of `dt` [s], as in `simulate` of a nominal
    machine.
    """
    return [ceil(real.substeps(dt, FINE) * piece / dt * (1 - 1e-12)) for piece in pieces]


def outside_torque(profile: Sequence[tuple[float, Any]], t: float) -> Any:
    """Return the torque [N·m] of a `torque_profile` at the time `t` [s]; 0 before its beginning."""
    return next((torque for start, torque in reversed(profile) if t >= start - 1e-9), 0.0)


class RealExperiment:
    """Experiment on a `RealPlant` or a `RealArm`, with its state, its sensors and the time."""

    def __init__(self, real: RealMachine, dt: float, x0: Array, seed: int) -> None:
        self.real, self.dt = real, dt
        nominal = real.nominal
        self._n, self._m, self._size = nominal.n, nominal.m, nominal.size
        readings = real.encoder, real.pressure_noise, real.pressure_offset, real.faults
        self._sensors = Sensors(self._n, self._m, *readings)
        self._sensors.begin(seed)
        theta = np.array(x0[: self._n])
        begun = (np.atleast_1d(one.begun(at)) for one, at in zip(real.frictions, theta.tolist(), strict=True))
        self._full = np.concatenate([x0, *begun])  # with the frictions' memories
        self._sample = 0
        self._pieces, waiting = delayed(real.dead_time, dt)
        self._steps = fine_steps(real, dt, self._pieces)
        self._waiting = [np.array(x0[2 * self._n :])] * waiting  # delayed commands, oldest first
        remembered = int(real.reading_age / dt) + 2 if real.reading_age else 0
        self._angles = [theta] * remembered  # of the last samples, oldest first
        # by the shares of the forces that reach the joints, and the shut valves
        self._sound = self._made(real)
        self._integrators = {((1.0,) * self._m, real.shut): self._sound}

    @property
    def x(self) -> Array:
        """True state (2n + m,)."""
        return self._full[: self._size].copy()

    def measure(self) -> Array:
        """Read the sensors (2n + m,): angles, NaN for the velocities, pressures. Every call draws new noise."""
        return self.read()

    def read(self, noise: Array | None = None) -> Array:
        """Read the sensors (2n + m,), with the `noise` (m,) of the pressure sensors in standard deviations if given."""
        P = self._full[2 * self._n : self._size]
        return self._sensors.read(self._angles_then, P, self._sample * self.dt, noise)

    @property
    def _angles_then(self) -> Array:
        """Angles (n,) [rad] at the time of the present reading, interpolated linearly between samples."""
        if not self._angles:
            return self._full[: self._n]
        whole, part = divmod(self.real.reading_age / self.dt, 1.0)
        now, before = self._angles[-1 - int(whole)], self._angles[-2 - int(whole)]
        return np.asarray(now + part * (before - now))

    @property
    def memory(self) -> Array:
        """State of the experiment without the time: `x`, the frictions' memories, delayed commands, and angles to be
        read.
        """
        return np.concatenate([self._full, *self._waiting, *self._angles])

    def recall(self, memory: Array, sample: int) -> None:
        """Set the state to a `memory`, at the `sample` since the beginning."""
        there, angles = self._full.size, memory.size - self._n * len(self._angles)
        self._full, self._sample = np.array(memory[:there]), sample
        self._waiting = list(np.reshape(memory[there:angles], (-1, self._m)))
        self._angles = list(np.reshape(memory[angles:], (-1, self._n)))

    def advance(self, u: Array, d: Value = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] given now, and a torque `d` [N·m], (n,) for an arm,
        added to the machine's own.
        """
        t = self._sample * self.dt
        torque = np.add(d, outside_torque(self.real.torque_profile, t))
        self._waiting.append(np.array(u))
        for command, duration, integrate in zip(self._waiting, self._pieces, self._integrate, strict=False):
            command = self._sensors.effective(command, self._full[2 * self._n : self._size], t)
            self._full = integrate(self._full, command, torque, duration)[0][0]
        self._waiting.pop(0)
        self._angles = [*self._angles, self._full[: self._n].copy()][1:] if self._angles else []
        self._sample += 1

    def _made(self, real: RealMachine) -> list[Buffered]:
        return [Buffered(integrator(real, steps)) for steps in self._steps]

    @property
    def _integrate(self) -> list[Buffered]:
        """Integrators of the pieces of a sample, with the present faults."""
        real, t = self.real, self._sample * self.dt
        if not self._sensors.active(t):
            return self._sound
        shares, closed = self._sensors.broken(t)
        gas = real.nominal.gas is not None  # without it a stuck valve's command is its constant pressure
        pulling, shut = tuple(shares.tolist()), tuple((real.shut | (gas & closed)).tolist())
        if (pulling, shut) not in self._integrators:
            gains = tuple(g * share for g, share in zip(real.force_gains, pulling, strict=True))
            broken = replace(real, force_gains=gains, shut=shut)
            self._integrators[pulling, shut] = self._made(broken)
        return self._integrators[pulling, shut]


def integrator(real: RealMachine, steps: int) -> "Function":
    """Return (x, u, d, duration) ↦ x in so many equal `steps`.

    Machines that differ only in their sensors, delays, loads and faults share it.
    """
    others: dict[str, Any] = dict.fromkeys(("dead_time", "reading_age", "encoder", "pressure_noise"), 0.0)
    others |= {"pressure_offset": (0.0,) * real.nominal.m, "torque_profile": (), "faults": ()}
    return _integrator(replace(real, **others), steps)


@lru_cache(maxsize=128)
def _integrator(real: RealMachine, steps: int) -> "Function":
    import casadi as ca

    nominal = real.nominal
    size = nominal.size
    n = size + sum(friction.size for friction in real.frictions)
    full, u, d = ca.SX.sym("x", n), ca.SX.sym("u", nominal.m), ca.SX.sym("d", nominal.n)
    duration, later = ca.SX.sym("duration"), full
    given = full, u, d, duration
    step = ca.Function("step", given, [ca.vertcat(*real.stepped(full[:size], full[size:], u, d, duration))])
    for _ in range(steps):
        later = step(later, u, d, duration / steps)
    return ca.Function("real", given, [later])


_UNITS = (
    ("dead_time", "s"), ("dead_band", "Pa"), ("encoder", "rad"), ("reading_age", "s"), ("pressure_noise", "Pa")
)  # fmt: skip
