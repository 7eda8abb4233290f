"""Compensation of known effects of a joint beyond the nominal model, by observer and controllers.

The disturbance torque d contains the other effects. Observer and controller need the same `Compensation`. Its friction
is any model with the interface of `mpc.model.friction.contact.Hysteresis`: its memory follows the estimated angle, and
its torque along the intended motion is in the feed-forward and in the prediction. Thus the feed-forward applies the
inverse of a `PrandtlIshlinskii`, to first order, without an iteration.
"""

from dataclasses import dataclass, field, replace
from math import inf
from os import PathLike
from typing import Any, Self

import numpy as np

from allocator import AntagonistJoint, checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.toml import Table
from allocator.machine_file import frictions_in, load_joint
from allocator.units import BAR, DEG
from mpc.model.friction.contact import Hysteresis, Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import friction_of
from mpc.model.pressures import ratio
from mpc.model.storage import stored_regulators

SOFT = 0.02 * BAR  # over which the inverse of a dead band changes sides, without jumps due to noise
USUAL_DEAD_TIME = 0.02  # [s] of an arm's regulators
_PUNCTUAL = 1e-9  # samples: rounding
JITTER = 0.03 * DEG  # smaller motions count as noise of the angle


@dataclass(frozen=True)
class Compensation:
    """Known friction and regulator effects of a joint; none by default.

    Observer and controllers take account of the friction, the dead time and the dead band, the observer of the reading
    age. If angle and pressures are read with the same delay, it is a dead time: add it to `dead_time`. The pressures
    are predicted with the lags of the `Plant`, and by the observer with the `flow`; `lag_up` and `lag_down` apply only
    to simulated plants (`RealPlant.of`). If both lags are given, the observer's diagnosis counts the lag of the `Plant`
    as measured, which narrows its limits.
    """

    friction: Hysteresis = field(default_factory=Friction)  # a `PrandtlIshlinskii` becomes `MaxwellSlip.of` it
    dead_time: float = 0.0  # of the commands [s]
    dead_band: float = 0.0  # [Pa], total
    reading_age: float = 0.0  # of the angle's readings [s]; those of the pressures are new
    lag_up: float | None = None  # time constant of a rising pressure [s], see `RealPlant`; None: that of the plant
    lag_down: float | None = None  # of a falling one [s]
    flow: float = inf  # fastest change of a pressure [Pa/s]
    frictions: tuple[Hysteresis, ...] = ()  # of an arm's joints, if they differ; else all have `friction`

    def __post_init__(self) -> None:
        """Check the numbers."""
        object.__setattr__(self, "friction", friction_of(self.friction))
        checks.instance("frictions", self.frictions, tuple | list, "a row of friction models, one a joint")
        object.__setattr__(self, "frictions", tuple(map(friction_of, self.frictions)))
        object.__setattr__(self, "dead_band", checks.not_negative("dead_band", self.dead_band, "Pa"))
        checks.pressure("dead_band", self.dead_band)
        check_regulators(self)
        for name, part in (("dead_time", "regulator"), ("reading_age", "sensor")):
            object.__setattr__(self, name, checks.delay(name, getattr(self, name), part))

    @classmethod
    def of(cls, joint: AntagonistJoint) -> Self:
        """Return the effects identified on a joint beyond its muscle models: the hysteresis of its angle, or else
        friction μ.

        The operator contains the whole hysteresis of the joint that it was fitted to, so that μ is then ignored.
        """
        return cls(Friction(mu=joint.friction) if joint.hysteresis is None else friction_of(joint.hysteresis))

    @classmethod
    def load(cls, path: str | PathLike[str], *, scale_needed: bool = True) -> Self:
        """Read the contents of a plant's file beyond `Plant`: the joint's hysteresis or friction, and its regulators.

        Raises `InvalidFile`, also if the scale of the joint's forces is unknown, unless `scale_needed` is false.
        """
        joint, told = load_joint(path, scale_needed=scale_needed), stored_regulators(path)
        try:
            known = cls.of(joint)
        except InvalidInput as error:
            raise InvalidFile(path, f"[hysteresis]: {error}") from None
        try:
            return replace(known, **told)
        except InvalidInput as error:
            raise InvalidFile(path, f"[regulators]: {error}") from None

    @classmethod
    def of_arm(cls, path: str | PathLike[str] | None = None) -> Self:
        """Return the friction, regulators and sensors in an arm's file; the dead time is 0.02 s if none is given.

        Raises `InvalidFile`.
        """
        told: dict[str, Any] = {"dead_time": USUAL_DEAD_TIME}
        if path is not None:
            told |= stored_regulators(path) | {"frictions": _frictions(path)}
        try:
            return cls(**told)
        except InvalidInput as error:
            raise InvalidFile(str(path), f"[regulators]: {error}") from None

    @property
    def summary(self) -> str:
        """One line with the known effects; "" if there are none."""
        parts = list(dict.fromkeys(one.summary for one in self.frictions or (self.friction,) if not one.absent))
        parts += [f"dead time {self.dead_time:g} s"] * bool(self.dead_time)
        parts += [f"reading age {self.reading_age:g} s"] * bool(self.reading_age)
        parts += [f"flow up to {self.flow / BAR:.3g} bar/s"] * (self.flow < inf)
        return ", ".join(parts + [f"dead band {self.dead_band / BAR:g} bar"] * bool(self.dead_band))

    @property
    def told(self) -> dict[str, Any]:
        """Known effects by name, without those at their defaults."""
        return {name: value for name, value in vars(self).items() if value != vars(Compensation())[name]}

    def untold(self, model: Any) -> str:
        """Return one line with the lags of regulators that controllers with this `Machine` do not use, or ""."""
        rising, falling = model.lags_each_way
        alike = self.lag_up and self.lag_down and ratio(self.lag_up, self.lag_down) == 1
        known = alike or (self.measured_lags and tuple(rising) != tuple(falling))
        lags = {} if known else {"rising": self.lag_up, "falling": self.lag_down}
        parts = [f"lag {lag:.3g} s of a {way} pressure" for way, lag in lags.items() if lag is not None]
        return " and ".join(parts)

    @property
    def measured_lags(self) -> bool:
        """Whether both lags of the regulators are known, as `fit_motion` finds them."""
        return self.lag_up is not None and self.lag_down is not None

    @property
    def frictionless(self) -> bool:
        """Whether no joint is known to have friction."""
        return all(friction.absent for friction in self.frictions or (self.friction,))

    def of_joints(self, n: int) -> tuple[Hysteresis, ...]:
        """Return the friction of each of `n` joints. Raises `InvalidInput` for another number of `frictions`."""
        if len(self.frictions) not in (0, n):
            raise InvalidInput(f"compensation: {len(self.frictions)} frictions for n = {n} joints; give one for each")
        return self.frictions or (self.friction,) * n

    def delay(self, dt: float) -> int:
        """Return the dead time in whole samples of `dt` [s], so that its sum with `age` is rounded once."""
        return round((self.dead_time + self.reading_age) / dt) - self.age(dt)

    def age(self, dt: float) -> int:
        """Return the reading age in whole samples of `dt` [s]."""
        return round(self.reading_age / dt)

    def older(self, dt: float) -> float:
        """Return by how much the readings are older than `age` samples of `dt` [s]: -dt/2 to dt/2 [s]."""
        rest = self.reading_age - self.age(dt) * dt
        return 0.0 if abs(rest) < _PUNCTUAL * dt else rest

    def after_dead_band(self, u: Array, P: Array) -> Array:
        """Return the command [Pa] that moves a regulator without dead band as `u` moves this one at pressures P."""
        rest, e = self.dead_band / 2, u - P
        return P + e - np.clip(e, -rest, rest)

    def inverse_dead_band(self, v: Array, P: Array) -> Array:
        """Return the command [Pa] for `v` to act: the inverse of `after_dead_band`, smooth where v passes P."""
        return np.asarray(v + self.dead_band / 2 * np.tanh((v - P) / SOFT))


def _frictions(path: str | PathLike[str]) -> tuple[Friction, ...]:
    """Return the friction of each joint in an arm's file, or () without a table [friction]. Raises `InvalidFile`."""
    rows = frictions_in(Table.read(path))
    try:
        return tuple(Friction(**row) for row in rows)
    except InvalidInput as error:
        raise InvalidFile(path, f"[friction]: {error}") from None


def check_regulators(of: Any) -> None:
    """Turn `lag_up`, `lag_down` [s] and `flow` [Pa/s] of a frozen dataclass into floats. Raises `InvalidInput`."""
    for name in ("lag_up", "lag_down"):
        if (lag := getattr(of, name)) is not None:
            if (value := checks.number(name, lag, "s")) <= 0:
                raise InvalidInput(f"{name} = {value:g} s has to be positive, or None for the lag of the plant")
            object.__setattr__(of, name, checks.delay(name, value, "regulator", checks.SLOWEST))
    flow = checks.number_or_inf("flow", of.flow, "Pa/s")
    if flow <= checks.LOOKS_LIKE_BAR[1]:
        raise InvalidInput(f"flow = {flow:g} Pa/s is next to nothing; if bar/s was meant, multiply by 1e5")
    object.__setattr__(of, "flow", flow)


class FrictionState:
    """Memory of a friction model along the path of the angle."""

    def __init__(self, friction: Hysteresis) -> None:
        self.friction = friction
        self.memory: Value = friction.begun(0.0)
        self.theta: float | None = None

    def follow(self, theta: float, contact: Loads) -> Value:
        """Return the memory after a motion from the last call's angle to `theta` [rad] in `contact`."""
        if self.theta is None:
            self.theta, self.memory = theta, self.friction.begun(theta)
        motion = theta - self.theta
        if abs(motion) > JITTER:
            self.theta = theta
        else:
            motion = 0.0
        self.memory = self.friction.moved(self.memory, motion, contact)
        return self.memory

    def go_on(self, theta: float, memory: Array) -> None:
        """Set the `memory` (size,) computed by compiled code at the angle `theta` [rad]."""
        self.theta, self.memory = theta, float(memory[0]) if isinstance(self.memory, float) else memory.copy()
