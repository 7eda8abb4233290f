"""The environments keep gymnasium's contract, repeat by their seeds, and show what a rig shows."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from allocator import InvalidInput, MissingBackend, allocate, report_joint
from allocator.allocation.box import ready
from allocator.units import BAR
from benchmarks.arm.unmodelled import machine
from mpc.arm.learning.actions import BoxAndSlew, PostureAndStiffness, governor_of
from mpc.arm.learning.environment import ArmEnvironment, ArmVectorEnvironment
from mpc.arm.learning.task import Reaching, Task
from mpc.arm.learning.variation import Variation
from mpc.arm.learning.wiping import Wiping
from mpc.governor import PressureGovernor
from mpc.model.arm.model import Arm

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
VARIED = Variation(gains=0.05, lags=0.1, mass=0.1, damping=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("actions", "dynamics"), [("posture-stiffness", "compiled"), ("pressures", "mujoco")])
@pytest.mark.parametrize(("name", "kind"), [("antagonist/Reach-v0", Reaching), ("antagonist/Wipe-v0", Wiping)])
def test_gymnasium_s_checker_finds_nothing(name, kind, actions, dynamics):
    """Its remarks are warnings, and warnings are errors here. Pictures of it need a GL; see the test of pictures."""
    task = kind(actions=actions, dynamics=dynamics, variation=VARIED)
    env = gymnasium.make(name, task=task).unwrapped
    assert env.episodes.task == task
    check_env(env, skip_render_check=True)
    assert isinstance(gymnasium.make(name).unwrapped.episodes.task, kind)


def test_an_episode_repeats_by_its_seed():
    task = Reaching(ARM, variation=VARIED, samples=5)
    twins, seen = [ArmEnvironment(task), ArmEnvironment(task)], []
    for env in twins:
        env.action_space.seed(1)
        rows = [env.reset(seed=7)[0]]
        for _ in range(5):
            observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
            rows.append(observation)
        assert truncated
        assert not terminated
        seen.append(np.array(rows))
    assert (seen[0] == seen[1]).all()
    assert (twins[0].episodes.batch.v == twins[1].episodes.batch.v).all()
    assert (ArmEnvironment(task).reset(seed=8)[0] != seen[0][0]).any()


def test_many_arms_begin_anew_one_step_after_they_were_cut_off():
    env = ArmVectorEnvironment(3, Reaching(ARM, samples=4))
    first, _ = env.reset(seed=0)
    assert first in env.observation_space
    goals = env.episodes.goal.copy()
    for k in range(4):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert truncated.all() == (k == 3)
        assert not terminated.any()
    assert info["error_rad"].shape == (3,)
    assert (env.episodes.goal == goals).all()
    _, reward, _, truncated, _ = env.step(env.action_space.sample())
    assert (reward == 0).all()
    assert not truncated.any()
    assert (env.episodes.goal != goals).all()
    again, _ = env.reset(seed=0)
    assert (again == first).all()


def test_many_arms_are_one_arm_many_times():
    """Without noise and variation each moves as alone."""
    task = Reaching(ARM, pressure_noise=0.0, push=0.0)
    many, one = ArmVectorEnvironment(4, task), ArmEnvironment(task)
    many.reset(seed=0)
    one.reset(seed=0)
    one.episodes.batch.x[0], one.episodes.goal[0] = many.episodes.batch.x[2], many.episodes.goal[2]
    for alone, all_of in zip(one.episodes._encoders, many.episodes._encoders, strict=True):
        alone[0] = all_of[2]
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 6)):
        rows, rewards, *_ = many.step(np.tile(action, (4, 1)))
        row, reward, *_ = one.step(action)
        assert row == pytest.approx(rows[2], abs=1e-6)
        assert reward == pytest.approx(rewards[2], rel=1e-9)


def test_what_is_seen_is_what_a_rig_sees():
    env = ArmEnvironment(Reaching(ARM, encoder=1e-3, pressure_noise=0.05 * BAR, push=0.0, samples=1000))
    before, _ = env.reset(seed=3)
    errors = []
    for _ in range(300):
        seen, _, _, _, info = env.step(np.zeros(6))
        batch = env.episodes.batch
        assert seen[:2] == pytest.approx(1e-3 * np.round(batch.q[0] / 1e-3), abs=1e-7)
        assert seen[2:4] == pytest.approx(before[:2], abs=0)
        assert seen[10:16] == pytest.approx(info["u_Pa"] / BAR, rel=1e-6)
        assert seen[16:] == pytest.approx(env.episodes.goal[0], rel=1e-6)
        errors.append(seen[4:10] - batch.P[0] / BAR)
        before = seen
    assert np.std(errors) == pytest.approx(0.05, rel=0.06)


def test_commands_arrive_late_and_no_faster_than_the_slew():
    env = ArmEnvironment(Reaching(replace(ARM, slew=10 * BAR), delay=2))
    env.reset(seed=0)
    full, step = np.ones(6), 0.1 * BAR
    for k in range(1, 4):
        assert env.step(full)[4]["u_Pa"] == pytest.approx([2.5 * BAR + k * step] * 6)
        arrived = 2.5 * BAR + max(k - 2, 0) * step
        rising = env.episodes.batch.P[0] > 2.5 * BAR + 1
        assert rising.all() == (arrived > 2.5 * BAR)


def test_a_governor_of_ones_own_has_the_last_word():
    seen = []

    def careful(q, omega, P, command, previous):
        seen.append((q.shape, omega.shape, P.shape, command.shape, previous[0, 0]))
        return np.full_like(command, 2 * BAR)

    env = ArmEnvironment(Reaching(ARM), governor=careful)
    env.reset(seed=0)
    assert (env.step(np.ones(6))[4]["u_Pa"] == 2 * BAR).all()
    env.step(np.ones(6))
    shapes = (1, 2), (1, 2), (1, 6), (1, 6)
    assert seen == [(*shapes, 2.5 * BAR), (*shapes, 2 * BAR)]


def test_by_default_a_governor_keeps_the_joints_in_range():
    env = ArmVectorEnvironment(2, Reaching(ARM))
    governor = env.episodes.governor
    assert isinstance(governor, PressureGovernor)
    assert governor.lag == pytest.approx(ARM.lags + 0.01)  # dead time counts as lag
    steep = replace(ARM.mechanism, muscles=(report_joint().agonist,) * 6)
    assert isinstance(governor_of(replace(ARM, mechanism=steep), 0.01, 1), BoxAndSlew)


def test_arms_of_up_to_three_joints_are_governed(monkeypatch):
    monkeypatch.setattr(PressureGovernor, "warm_up", lambda governor: True)
    for arm, kind in ((machine("three").arm, PressureGovernor), (Arm.machine("arm48"), BoxAndSlew)):
        assert isinstance(governor_of(arm, 0.01, 1), kind)


def test_box_and_slew_change_nothing_that_is_within():
    governor = BoxAndSlew(ARM, 0.01)
    P, q = np.full((2, 6), 2 * BAR), np.zeros((2, 2))
    allowed = P + 0.04 * BAR
    assert (governor(q, q, P, allowed, P) == allowed).all()
    assert governor(q, q, P, P + 9 * BAR, allowed) == pytest.approx(allowed + 0.05 * BAR)
    assert (governor(q, q, P, P - 9 * BAR, np.full((2, 6), 0.01 * BAR)) == 0).all()


def test_postures_and_stiffnesses_become_the_allocation_s_pressures():
    meant = PostureAndStiffness(Arm.machine("arm48"))
    action = np.random.default_rng(0).uniform(-0.5, 0.5, (4, 8))  # as many as joints: diagonals, no matrix
    q, K = meant.targets(action)
    P = meant.pressures(action)
    for i in range(4):
        alone = allocate(q[i], K[i], meant.arm.bodies.gravity_torque(q[i]), joint=meant.arm.mechanism)
        assert P[i] == pytest.approx(alone.P, rel=1e-9)
    ends = meant.targets(np.array([[-1.0] * 8, [1.0] * 8]))
    assert ends[0][:, 0] == pytest.approx(np.deg2rad([-90, 90]))
    assert (ends[1][0] < ends[1][1]).all()


def test_more_arms_than_one_compiled_call_takes_get_the_same_pressures(monkeypatch):
    meant = PostureAndStiffness(ARM)
    actions = np.random.default_rng(3).uniform(-1, 1, (7, meant.size))
    together = meant.pressures(actions)
    monkeypatch.setattr(ready, "MOST", 3)
    assert (meant.pressures(actions) == together).all()


def test_an_arm_settles_where_its_action_says():
    env = ArmEnvironment(Reaching(ARM, "posture-stiffness", push=0.0))
    env.reset(seed=5)
    action = np.array([0.3, -0.4, 0.0, 0.0])
    env.step(action)
    batch, P = env.episodes.batch, env.episodes.action.pressures(action[None])
    for _ in range(1500):
        batch.advance(P, np.zeros((1, 2)))
    assert batch.q[0] == pytest.approx(action[:2] * np.deg2rad(60), abs=1e-4)


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        ({"actions": "torques"}, MissingBackend, "posture-stiffness, pressures"),
        ({"dynamics": "bullet"}, MissingBackend, "compiled, mujoco"),
        ({"samples": 0}, InvalidInput, "samples"),
        ({"push": -1.0}, InvalidInput, r"push = -1.0 has to be one number that is not negative \[N·m\]"),
        ({"reach": 1.5}, InvalidInput, "reach"),
    ],
)
def test_wrong_tasks_are_refused(options, error, sentence):
    with pytest.raises(error, match=sentence):
        Reaching(ARM, **options)


def test_unknown_render_modes_are_refused():
    with pytest.raises(InvalidInput, match="rgb_array"):
        ArmEnvironment(Reaching(ARM), render_mode="human")


@pytest.mark.slow
def test_an_environment_shows_itself_or_says_which_gl_is_missing():
    env = gymnasium.make(
        "antagonist/Reach-v0", task=Reaching(ARM, dynamics="mujoco"), render_mode="rgb_array"
    ).unwrapped
    env.reset(seed=0)
    picture, said = None, ""
    try:
        picture = env.render()
    except MissingBackend as error:
        said = str(error)
    if picture is None:
        assert "EGL" in said
        return
    assert picture.shape == (480, 640, 3)
    for _ in range(30):
        env.step(np.ones(6))
    assert (env.render() != picture).any(axis=-1).sum() > 500  # pixels: it has moved, and reddened
    env.close()


class Braking(Task):
    """A task that the library does not have: to come to rest from a posture, as an observed rate asks."""

    unit = "rad²/s²"
    asked_range = np.array([[0.0], [2.0]])

    def draw(self, count, rng):
        return np.zeros((count, self.arm.n)), rng.uniform(0.5, 1.5, (count, 1))

    def asked(self, goal, sample):
        return goal * np.exp(-sample[:, None])

    def judge(self, size):
        def judged(batch, asked):
            speed = np.linalg.norm(batch.omega, axis=1)
            return speed**2, {"speed_rad_s": speed}

        return judged


@pytest.mark.slow
def test_tasks_of_one_s_own_have_environments():
    task = Braking(ARM, effort=0.0)
    check_env(ArmEnvironment(task), skip_render_check=True)
    env = ArmVectorEnvironment(3, task)
    seen, info = env.reset(seed=0)
    assert seen.shape == (3, 2 + 2 + 6 + 6 + 1)
    assert (info["speed_rad_s"] == 0).all()
    later, reward, *_, info = env.step(np.ones((3, 6)))
    assert later[:, -1] == pytest.approx(seen[:, -1] * np.exp(-1))
    assert reward == pytest.approx(-(info["speed_rad_s"] ** 2))
