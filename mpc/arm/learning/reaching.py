"""Reaching task: an arm has to hold a posture under unknown torques, with the sensors of a test rig.

Observations are the encoders now and one sample before, the pressure sensors, the last commands and the target posture:
(q, q before, P, u, q*) (blocks of n or m numbers), angles in rad, pressures in bar. Velocities and the parameters of
the arm are not observed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.gas import Gas
from allocator.units import BAR, DEG
from mpc.arm.learning.actions import KINDS, Governor, governor_of, within
from mpc.arm.learning.plant import ArmBatch, VariedArm
from mpc.arm.learning.variation import Variation
from mpc.model.arm.model import Arm

Seen = NDArray[np.float32]

DYNAMICS = ("compiled", "mujoco")
_BEYOND = 0.5  # [-] of the span: observations beyond the ranges


@dataclass(frozen=True)
class Reaching:
    """Task, arm and sensors of reaching; immutable. SI units."""

    arm: Arm = field(default_factory=lambda: Arm.machine("arm26"))
    actions: str = "pressures"  # or "posture-stiffness"
    dt: float = 0.01  # sample time [s]
    samples: int = 200  # per episode
    variation: Variation = field(default_factory=Variation)
    gas: Gas | None = None
    encoder: float = 0.02 * DEG  # step [rad]
    pressure_noise: float = 0.01 * BAR  # standard deviation [Pa]
    delay: int = 1  # [samples] from a command to the valve
    push: float = 0.5  # standard deviation of the unknown torque on every joint [N·m]
    effort: float = 0.02  # cost of all pressures at their upper limit [rad²]
    reach: float = 0.8  # share of the angle range for targets [-]
    dynamics: str = "compiled"  # or "mujoco"

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput` and `MissingBackend`."""
        for name, value, known in (("actions", self.actions, KINDS), ("dynamics", self.dynamics, DYNAMICS)):
            if value not in known:
                raise MissingBackend(name, value, known)
        checks.count("samples", self.samples, 1)
        checks.count("delay", self.delay, 0, 100)
        for name, unit in (("encoder", "rad"), ("pressure_noise", "Pa"), ("push", "N·m"), ("effort", "rad²")):
            if checks.number(name, getattr(self, name), unit) < 0:
                raise InvalidInput(f"{name} = {getattr(self, name):g} {unit} has to be 0 or more")
        if not 0 < checks.number("reach", self.reach, "-") <= 1:
            raise InvalidInput(f"reach = {self.reach:g} has to be a share of the angle range, such as 0.8")
        if self.arm.mechanism.angle_limits is None:
            raise InvalidInput("the mechanism has no angle_limits, which define the target postures")


class Batch(Protocol):
    """N simulated arms: states, values and their views."""

    varied: VariedArm
    x: Array  # (N, 2n + m)
    v: Array  # (N, p)
    q: Array  # (N, n)
    omega: Array  # (N, n)
    P: Array  # (N, m)

    def renew(self, which: Mask) -> None:
        """Apply changed states and values of the arms `which` (N,)."""

    def advance(self, u: Array, d: Array) -> None:
        """Advance all arms by a sample under the commands `u` (N, m) [Pa] and the torques `d` (N, n) [N·m]."""


class Reachers:
    """N reaching arms, each with its own target posture: the core of both environments."""

    def __init__(self, task: Reaching, size: int, governor: Governor | None = None) -> None:
        arm = task.arm
        self.task, self.size = task, size
        varied = VariedArm(arm, task.gas)
        task.variation.check(varied)
        self.batch: Batch = _BATCHES[task.dynamics](varied, size, task.dt)
        self.action = KINDS[task.actions](arm)
        self.governor = governor_of(arm, task.dt, task.delay) if governor is None else governor
        low, high = arm.angle_limits
        self.asked_range = (low + high) / 2 + task.reach * np.array([[-1.0], [1.0]]) * (high - low) / 2
        self.seen_range = self._seen_range(low, high)
        n, m = arm.n, arm.m
        self.goal, self.push, self.sample = np.zeros((size, n)), np.zeros((size, n)), np.zeros(size, np.int64)
        self._price = task.effort / (m * arm.mechanism.pressure_limits[1] ** 2)  # of the sum of P²
        self._encoders = np.zeros((2, size, n))  # now and one sample before
        self._waiting = np.zeros((task.delay + 1, size, m))  # commands, the newest first

    def _seen_range(self, low: Array, high: Array) -> Array:
        """Return the least and the greatest observations (2, 3n + 2m)."""
        arm = self.task.arm
        pressures = np.array(arm.mechanism.pressure_limits) / BAR
        over, above = _BEYOND * (high - low), _BEYOND * float(np.ptp(pressures))
        q = np.stack([low - over, high + over])
        P = np.repeat(np.array([[pressures[0] - above], [pressures[1] + above]]), arm.m, axis=1)
        return np.concatenate([q, q, P, P, q], axis=1)

    def begin(self, which: Mask, rng: np.random.Generator) -> None:
        """Begin new episodes of the arms `which` (N,): at rest in a random posture, with another one as target."""
        task, batch, arm, count = self.task, self.batch, self.task.arm, int(which.sum())
        batch.v[which] = task.variation.draw(batch.varied, count, rng)
        start = rng.uniform(self.asked_range[0], self.asked_range[1], (count, arm.n))
        x = np.zeros((count, arm.size))
        x[:, : arm.n] = start
        x[:, 2 * arm.n :] = self._middle
        batch.x[which] = x
        batch.renew(which)
        self.goal[which] = rng.uniform(self.asked_range[0], self.asked_range[1], (count, arm.n))
        self.push[which] = task.push * rng.standard_normal((count, arm.n))
        self.sample[which] = 0
        self._waiting[:, which] = x[:, 2 * arm.n :]
        self._encoders[:, which] = self._rounded(start)

    @property
    def commands(self) -> Array:
        """Last commands (N, m) [Pa]."""
        return np.asarray(self._waiting[0])

    @property
    def _middle(self) -> float:
        """Initial pressure [Pa], in the middle of the supply's limits."""
        return sum(self.task.arm.mechanism.pressure_limits) / 2

    def advance(self, action: Array) -> tuple[Array, Array]:
        """Advance by a sample with the actions (N, …); return the rewards (N,) and the squared errors (N,) [rad²]."""
        batch = self.batch
        meant = self.action.pressures(within(action, -1.0, 1.0))
        safe = self.governor(batch.q, batch.omega, batch.P, meant, self._waiting[0])
        self._waiting[1:] = self._waiting[:-1]
        self._waiting[0] = safe
        batch.advance(self._waiting[-1], self.push)
        self._encoders[1] = self._encoders[0]
        self._encoders[0] = self._rounded(batch.q)
        self.sample += 1
        error = batch.q - self.goal
        square = np.einsum("ij,ij->i", error, error)
        return -square - self._price * np.einsum("ij,ij->i", batch.P, batch.P), square

    def observe(self, rng: np.random.Generator) -> Seen:
        """Return the observations (N, 3n + 2m) with new noise."""
        P = self.batch.P + self.task.pressure_noise * rng.standard_normal(self.batch.P.shape)
        seen = np.concatenate([*self._encoders, P / BAR, self._waiting[0] / BAR, self.goal], axis=1)
        return np.asarray(within(seen, *self.seen_range), np.float32)

    def _rounded(self, q: Array) -> Array:
        step = self.task.encoder
        return np.asarray(step * np.rint(q / step)) if step else q


def _mujoco(varied: VariedArm, size: int, dt: float) -> Batch:
    from mpc.arm.learning.mujoco_batch import MujocoBatch

    return MujocoBatch(varied, size, dt)


_BATCHES: Mapping[str, Callable[[VariedArm, int, float], Batch]] = {"compiled": ArmBatch, "mujoco": _mujoco}
