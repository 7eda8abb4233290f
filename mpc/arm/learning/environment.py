"""Environments of gymnasium with one arm that reaches or wipes, or many at a time.

>>> import gymnasium
>>> from mpc.arm.learning.reaching import Reaching
>>> env = gymnasium.make("mpc.arm.learning.environment:antagonist/Reach-v0", task=Reaching(actions="posture-stiffness"))
>>> observation, info = env.reset(seed=0)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
"""

from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from mpc.arm.learning.actions import Governor
from mpc.arm.learning.episodes import Episodes, Seen
from mpc.arm.learning.reaching import Reaching
from mpc.arm.learning.task import Task
from mpc.arm.learning.wiping import Wiping

if TYPE_CHECKING:
    from mpc.arm.picture import Camera

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
