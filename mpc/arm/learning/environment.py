"""Environments of gymnasium with one arm that reaches or wipes, or many at a time.

>>> import gymnasium
>>> from mpc.arm.learning.task import Reaching
>>> env = gymnasium.make("mpc.arm.learning.environment:antagonist/Reach-v0", task=Reaching(actions="posture-stiffness"))
>>> observation, info = env.reset(seed=0)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

Both run `Episodes` of many arms: actions, governor, delay, dynamics and sensors of a task.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.presentation.progress import waiting
from allocator.units import BAR
from mpc.arm.learning.actions import KINDS, Governor, governor_of, within
from mpc.arm.learning.plant import ArmBatch, VariedArm
from mpc.arm.learning.task import Batch, Reaching, Task
from mpc.arm.learning.wiping import Wiping

if TYPE_CHECKING:
    from mpc.arm.picture import Camera


Seen = NDArray[np.float32]


class Episodes:
    """N arms, each in its own episode of a task."""

    def __init__(self, task: Task, size: int, governor: Governor | None = None) -> None:
        """Prepare `size` arms; `begin` has to be called next. Raises `InvalidInput`."""
        arm, varied = task.arm, task.varied
        self.task, self.size = task, size
        task.variation.check(varied)
        self.judge = task.judge(size)
        with waiting("compiling the environment, once for each kind of arm"):
            self.action = KINDS[task.actions](arm)
            self.batch: Batch = _BATCHES[task.dynamics](varied, size, task.dt)
            moved = replace(arm, gas=task.gas)
            self.governor = governor_of(moved, task.dt, task.delay) if governor is None else governor
            self.action.warm_up()
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


Info: TypeAlias = dict[str, object]
TASKS: dict[str, Task] = {"antagonist/Reach-v0": Reaching(), "antagonist/Wipe-v0": Wiping()}
"""Default tasks of the environments by name."""


class ArmEnvironment(gymnasium.Env[Any, Any]):
    """One arm with a task; an episode is truncated after `task.samples`.

    The reward of a sample is minus the costs of the task and of the effort, in the unit of the task; `info` has the
    task's numbers, the pressures "P_Pa" and the governor's commands "u_Pa".
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012  # gymnasium's

    def __init__(self, task: Task, governor: Governor | None = None, render_mode: str | None = None) -> None:
        """Set the `task`, such as `Reaching()` or `Wiping()`. Raises `InvalidInput`."""
        if render_mode not in (None, "rgb_array"):
            raise InvalidInput(f"render_mode = {render_mode!r} is unknown; there is 'rgb_array', or None")
        self.render_mode = render_mode
        self.episodes = Episodes(task, 1, governor)
        self.action_space, self.observation_space = _spaces(self.episodes)
        self._camera: Camera | None = None
        self._all = np.ones(1, bool)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Seen, Info]:
        """Begin an episode; equal seeds give equal episodes."""
        super().reset(seed=seed)
        self.episodes.begin(self._all, self.np_random)
        return self.episodes.observe(self.np_random)[0], self._judged()[1]

    def step(self, action: Array) -> tuple[Seen, float, bool, bool, Info]:
        """Advance by one sample."""
        episodes = self.episodes
        episodes.advance(np.asarray(action, float)[None])
        reward, info = self._judged()
        cut = bool(episodes.sample[0] >= episodes.task.samples)
        return episodes.observe(self.np_random)[0], reward, False, cut, info

    def _judged(self) -> tuple[float, Info]:
        """Return the reward of the present sample and its information."""
        reward, numbers = self.episodes.judged()
        info: Info = {name: float(values[0]) for name, values in numbers.items()}
        info |= {"P_Pa": self.episodes.batch.P[0].copy(), "u_Pa": self.episodes.commands[0].copy()}
        return float(reward[0]), info

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) by MuJoCo. Raises `MissingBackend` if nothing renders offscreen."""
        if self.render_mode is None:
            return None
        if self._camera is None:
            from mpc.arm.learning.mujoco_batch import plant_of
            from mpc.arm.picture import Camera

            self._camera = Camera(plant_of(self.episodes.batch.varied))
        x, n = self.episodes.batch.x[0], self.episodes.task.arm.n
        self._camera.plant.reset(x[:n], x[2 * n :])
        return self._camera.render()

    def close(self) -> None:
        """Release the resources of pictures."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None


class ArmVectorEnvironment(VectorEnv[Any, Any, Any]):
    """`num_envs` arms with a task in one compiled loop, otherwise like `ArmEnvironment`.

    After a truncated episode the next step begins a new one (AutoresetMode.NEXT_STEP).
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, num_envs: int, task: Task, governor: Governor | None = None) -> None:
        """Set the `task` of all arms. Raises `InvalidInput`."""
        self.num_envs = num_envs
        self.episodes = Episodes(task, num_envs, governor)
        self.single_action_space, self.single_observation_space = _spaces(self.episodes)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._cut = np.ones(num_envs, bool)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Seen, Info]:
        """Begin episodes of all arms; equal seeds give equal episodes."""
        super().reset(seed=seed)
        self._cut[:] = False
        self.episodes.begin(np.ones(self.num_envs, bool), self.np_random)
        return self.episodes.observe(self.np_random), {**self.episodes.judged()[1]}

    def step(self, actions: Array) -> tuple[Seen, Array, Mask, Mask, Info]:
        """Advance all arms by one sample; truncated ones begin a new episode, without a reward."""
        renewed = self._cut.copy()
        self.episodes.advance(np.asarray(actions, float))
        if renewed.any():
            self.episodes.begin(renewed, self.np_random)
        reward, info = self.episodes.judged()
        reward[renewed] = 0.0
        self._cut = self.episodes.sample >= self.episodes.task.samples
        seen, never = self.episodes.observe(self.np_random), np.zeros(self.num_envs, bool)
        return seen, reward, never, self._cut.copy(), {**info}


def _spaces(episodes: Episodes) -> tuple[Box, Box]:
    low, high = (end.astype(np.float32) for end in episodes.seen_range)
    actions = Box(-1.0, 1.0, (episodes.action.size,), np.float32)
    return actions, Box(low, high, dtype=np.float32)


for _name, _task in TASKS.items():
    gymnasium.register(
        _name,
        entry_point="mpc.arm.learning.environment:ArmEnvironment",
        vector_entry_point="mpc.arm.learning.environment:ArmVectorEnvironment",
        kwargs={"task": _task},
    )
