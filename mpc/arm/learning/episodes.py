"""Episodes of many arms: actions, governor, delay, dynamics and sensors of a task, for both environments."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.units import BAR
from mpc.arm.learning.actions import KINDS, Governor, governor_of, within
from mpc.arm.learning.plant import ArmBatch, VariedArm
from mpc.arm.learning.task import Batch, Task

Seen = NDArray[np.float32]


class Episodes:
    """N arms, each in its own episode of a task."""

    def __init__(self, task: Task, size: int, governor: Governor | None = None) -> None:
        """Prepare `size` arms; `begin` has to be called next. Raises `InvalidInput`."""
        arm, varied = task.arm, task.varied
        self.task, self.size = task, size
        task.variation.check(varied)
        self.judge = task.judge(size)
        self.batch: Batch = _BATCHES[task.dynamics](varied, size, task.dt)
        self.action = KINDS[task.actions](arm)
        self.governor = governor_of(arm, task.dt, task.delay) if governor is None else governor
        self.seen_range = tuple(task.seen_range)
        n, m = arm.n, arm.m
        self.goal = task.draw(size, np.random.default_rng(0))[1]  # (N, g), any before `begin`
        self.push, self.sample = np.zeros((size, n)), np.zeros(size, np.int64)
        self.asked = task.asked(self.goal, self.sample)  # (N, a)
        self._price = task.effort / (m * arm.mechanism.pressure_limits[1] ** 2)  # of the sum of P²
        self._units = np.repeat([1.0, BAR, 1.0], [2 * n, 2 * m, self.asked.shape[1]])  # of the observations
        self._encoders = [np.zeros((size, n)) for _ in range(2)]  # now and one sample before
        self._waiting = [np.zeros((size, m)) for _ in range(task.delay + 1)]  # commands, the newest first

    def begin(self, which: Mask, rng: np.random.Generator) -> None:
        """Begin new episodes of the arms `which` (N,): at rest, with a new goal."""
        task, batch, arm, count = self.task, self.batch, self.task.arm, int(which.sum())
        batch.v[which] = task.variation.draw(batch.varied, count, rng)
        start, goal = task.draw(count, rng)
        x = np.zeros((count, arm.size))
        x[:, : arm.n] = start
        x[:, 2 * arm.n :] = self._middle
        batch.x[which] = x
        batch.renew(which)
        self.goal[which] = goal
        self.push[which] = task.push * rng.standard_normal((count, arm.n))
        self.sample[which] = 0
        self.asked = task.asked(self.goal, self.sample)
        for commands in self._waiting:
            commands[which] = x[:, 2 * arm.n :]
        for read in self._encoders:
            read[which] = self._rounded(start)

    @property
    def commands(self) -> Array:
        """Last commands (N, m) [Pa]."""
        return self._waiting[0]

    @property
    def _middle(self) -> float:
        """Initial pressure [Pa], in the middle of the supply's limits."""
        return sum(self.task.arm.mechanism.pressure_limits) / 2

    def advance(self, action: Array) -> None:
        """Advance by a sample with the actions (N, …)."""
        batch = self.batch
        meant = self.action.pressures(within(action, -1.0, 1.0))
        safe = self.governor(batch.q, batch.omega, batch.P, meant, self._waiting[0])
        self._waiting = [safe.copy(), *self._waiting[:-1]]
        batch.advance(self._waiting[-1], self.push)
        self._encoders = [self._rounded(batch.q), self._encoders[0]]
        self.sample += 1
        self.asked = self.task.asked(self.goal, self.sample)

    def judged(self) -> tuple[Array, dict[str, Array]]:
        """Return the rewards (N,) of the present sample, and the task's numbers (N,) for `info`."""
        batch = self.batch
        cost, info = self.judge(batch, self.asked)
        return -cost - self._price * np.add.reduce(batch.P**2, axis=1), info

    def observe(self, rng: np.random.Generator) -> Seen:
        """Return the observations (N, 2n + 2m + a) with new noise."""
        P = self.batch.P + self.task.pressure_noise * rng.standard_normal(self.batch.P.shape)
        seen = np.concatenate([*self._encoders, P, self._waiting[0], self.asked], axis=1) / self._units
        return np.asarray(within(seen, *self.seen_range), np.float32)

    def _rounded(self, q: Array) -> Array:
        step = self.task.encoder
        return np.asarray(step * np.rint(q / step)) if step else q.copy()


def _mujoco(varied: VariedArm, size: int, dt: float) -> Batch:
    from mpc.arm.learning.mujoco_batch import MujocoBatch

    return MujocoBatch(varied, size, dt)


_BATCHES: Mapping[str, Callable[[VariedArm, int, float], Batch]] = {"compiled": ArmBatch, "mujoco": _mujoco}
