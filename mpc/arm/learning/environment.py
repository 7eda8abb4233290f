"""Environments of gymnasium with one reaching arm, or many at a time.

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
from mpc.arm.learning.reaching import Reachers, Reaching, Seen

if TYPE_CHECKING:
    from mpc.arm.picture import Camera

Info: TypeAlias = dict[str, object]
NAME = "antagonist/Reach-v0"


class ReachEnvironment(gymnasium.Env[Any, Any]):
    """One reaching arm; an episode is truncated after `task.samples`.

    The reward of a sample is minus the squared error of the posture [rad²] and the effort; `info` has the error
    "error_rad", the pressures "P_Pa" and the governor's commands "u_Pa".
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012  # gymnasium's

    def __init__(
        self, task: Reaching | None = None, governor: Governor | None = None, render_mode: str | None = None
    ) -> None:
        """Set the `task`, by default an arm26's with pressures as actions. Raises `InvalidInput`."""
        task = Reaching() if task is None else task
        if render_mode not in (None, "rgb_array"):
            raise InvalidInput(f"render_mode = {render_mode!r} is unknown; there is 'rgb_array', or None")
        self.render_mode = render_mode
        self.reachers = Reachers(task, 1, governor)
        self.action_space, self.observation_space = _spaces(self.reachers)
        self._camera: Camera | None = None
        self._all = np.ones(1, bool)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Seen, Info]:
        """Begin an episode; equal seeds give equal episodes."""
        super().reset(seed=seed)
        self.reachers.begin(self._all, self.np_random)
        return self.reachers.observe(self.np_random)[0], self._info(np.nan)

    def step(self, action: Array) -> tuple[Seen, float, bool, bool, Info]:
        """Advance by one sample."""
        reward, square = self.reachers.advance(np.asarray(action, float)[None])
        cut = bool(self.reachers.sample[0] >= self.reachers.task.samples)
        return (
            self.reachers.observe(self.np_random)[0],
            float(reward[0]),
            False,
            cut,
            self._info(float(square[0]) ** 0.5),
        )

    def _info(self, error: float) -> Info:
        batch = self.reachers.batch
        return {"error_rad": error, "P_Pa": batch.P[0].copy(), "u_Pa": self.reachers.commands[0].copy()}

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) by MuJoCo. Raises `MissingBackend` if nothing renders offscreen."""
        if self.render_mode is None:
            return None
        if self._camera is None:
            from mpc.arm.learning.mujoco_batch import plant_of
            from mpc.arm.picture import Camera

            self._camera = Camera(plant_of(self.reachers.batch.varied))
        x, n = self.reachers.batch.x[0], self.reachers.task.arm.n
        self._camera.plant.reset(x[:n], x[2 * n :])
        return self._camera.render()

    def close(self) -> None:
        """Release the resources of pictures."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None


class ReachVectorEnvironment(VectorEnv[Any, Any, Any]):
    """`num_envs` reaching arms in one compiled loop, otherwise like `ReachEnvironment`.

    After a truncated episode the next step begins a new one (AutoresetMode.NEXT_STEP).
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, num_envs: int, task: Reaching | None = None, governor: Governor | None = None) -> None:
        """Set the `task` of all arms. Raises `InvalidInput`."""
        self.num_envs = num_envs
        self.reachers = Reachers(Reaching() if task is None else task, num_envs, governor)
        self.single_action_space, self.single_observation_space = _spaces(self.reachers)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._cut = np.ones(num_envs, bool)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Seen, Info]:
        """Begin episodes of all arms; equal seeds give equal episodes."""
        super().reset(seed=seed)
        self._cut[:] = False
        self.reachers.begin(np.ones(self.num_envs, bool), self.np_random)
        return self.reachers.observe(self.np_random), {}

    def step(self, actions: Array) -> tuple[Seen, Array, Mask, Mask, Info]:
        """Advance all arms by one sample; truncated ones begin a new episode, without a reward."""
        renewed = self._cut.copy()
        reward, square = self.reachers.advance(np.asarray(actions, float))
        if renewed.any():
            self.reachers.begin(renewed, self.np_random)
            reward[renewed] = 0.0
        self._cut = self.reachers.sample >= self.reachers.task.samples
        info: Info = {"error_rad": np.sqrt(square)}
        return self.reachers.observe(self.np_random), reward, np.zeros(self.num_envs, bool), self._cut.copy(), info


def _spaces(reachers: Reachers) -> tuple[Box, Box]:
    low, high = reachers.seen_range.astype(np.float32)
    actions = Box(-1.0, 1.0, (reachers.action.size,), np.float32)
    return actions, Box(low, high, dtype=np.float32)


gymnasium.register(
    NAME,
    entry_point="mpc.arm.learning.environment:ReachEnvironment",
    vector_entry_point="mpc.arm.learning.environment:ReachVectorEnvironment",
)
