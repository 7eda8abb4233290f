"""A hand that wipes is asked for a path and a force, pays for both, and presses as hard as it is stiff."""

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.mechanism.endpoint import Endpoint
from mpc.arm.learning.actions import BoxAndSlew
from mpc.arm.learning.environment import ArmEnvironment, ArmVectorEnvironment
from mpc.arm.learning.plant import Wall
from mpc.arm.learning.variation import Variation
from mpc.arm.learning.wiping import Wiping
from mpc.model.arm.model import Arm

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
HAND = ARM.bodies.endpoint
VARIED = Variation(wall_offset=0.003, wall_stiffness=0.3)


def environment(size=None, **options):
    """An environment without the pressure governor, which takes long to compile."""
    task = Wiping(ARM, **options)
    governor = BoxAndSlew(ARM, task.dt)
    return ArmEnvironment(task, governor) if size is None else ArmVectorEnvironment(size, task, governor)


def test_episodes_begin_before_the_wall_at_the_place_asked_for():
    env = environment(50, clearance=0.02)
    seen, info = env.reset(seed=0)
    assert seen in env.observation_space
    x = HAND.position(env.episodes.batch.q)
    assert x[:, 0] == pytest.approx(0.59 - 0.02, abs=1e-4)
    assert x[:, 1] == pytest.approx(seen[:, -3], abs=1e-4)  # s*
    assert np.ptp(x[:, 1]) > 0.09
    assert info["error_m"] == pytest.approx(0.02, abs=1e-4)  # the gap
    assert (info["force_N"] == 0).all()
    assert info["asked_N"] == pytest.approx(seen[:, -1])


def test_a_wall_at_an_angle_is_wiped_along_its_own_line():
    wall = Wall((0.6, 0.8), 0.58)
    task = Wiping(ARM, wall=wall, stroke=(-0.1, 0.1))
    places = np.linspace(-0.1, 0.1, 5)
    x = HAND.position(task.postures(0.004, places))
    assert x @ [0.6, 0.8] == pytest.approx(0.584, abs=2e-6)
    assert x @ [-0.8, 0.6] == pytest.approx(places, abs=2e-6)


def test_redundant_arms_find_postures_along_a_wall():
    arm = Arm.machine("arm48")
    task = Wiping(arm, wall=Wall((0.0, 1.0), 0.5), stroke=(-0.5, -0.3))
    q = task.postures(0.0, np.linspace(-0.5, -0.3, 5))
    low, high = arm.angle_limits
    assert ((low <= q) & (q <= high)).all()
    assert arm.bodies.endpoint.position(q)[:, 1] == pytest.approx(0.5, abs=2e-6)


def test_targets_follow_a_sine_with_their_velocity():
    env = environment(samples=200, period=1.0, stroke=(-0.04, 0.06))
    rows = [env.reset(seed=1)[0]]
    rows += [env.step(np.zeros(6))[0] for _ in range(150)]
    place, speed, force = np.array(rows, float)[:, -3:].T
    assert (force == force[0]).all()
    assert place[100:] == pytest.approx(place[:51], abs=1e-6)  # a period later
    assert (place.min(), place.max()) == pytest.approx((-0.04, 0.06), abs=1e-4)
    assert (place[2:] - place[:-2]) / 0.02 == pytest.approx(speed[1:-1], abs=1e-3)


def test_costs_are_those_of_path_force_and_effort():
    """In numbers of the endpoint; every arm has its own wall."""
    env = environment(20, variation=VARIED, effort=0.1, scale=0.05, force=(1.0, 3.0))
    env.reset(seed=0)
    batch = env.episodes.batch
    rng = np.random.default_rng(0)
    for _ in range(40):
        seen, reward, _, _, info = env.step(rng.uniform(-1, 1, (20, 6)))
    offset, stiffness, damping = batch.v[:, batch.varied.places["wall"]].T
    assert np.ptp(offset) > 0.005
    x, speed = HAND.position(batch.q), (HAND.jacobian(batch.q) @ batch.omega[..., None])[:, 0, 0]
    depth = x[:, 0] - offset
    force = np.where(depth > 0, np.maximum(stiffness * depth + damping * speed, 0), 0)
    assert 0 < (force > 0).sum() < 20
    distance = np.hypot(x[:, 1] - seen[:, -3], np.minimum(depth, 0))
    assert info["force_N"] == pytest.approx(force, rel=1e-6, abs=1e-9)
    assert info["error_m"] == pytest.approx(distance, abs=1e-6)
    cost = (distance / 0.05) ** 2 + ((force - seen[:, -1]) / 3.0) ** 2 + 0.1 * np.mean((batch.P / 5e5) ** 2, axis=1)
    assert reward == pytest.approx(-cost, rel=1e-4)


def test_an_episode_repeats_by_its_seed_and_many_are_one():
    found = []
    for env in (environment(variation=VARIED), environment(variation=VARIED)):
        env.reset(seed=4)
        found.append(np.array([env.step(action)[0] for action in np.random.default_rng(0).uniform(-1, 1, (5, 6))]))
    assert (found[0] == found[1]).all()
    many = environment(3, variation=VARIED, pressure_noise=0.0)
    many.reset(seed=4)
    one = environment(variation=VARIED, pressure_noise=0.0)
    one.reset(seed=5)
    for name in ("x", "v"):
        getattr(one.episodes.batch, name)[0] = getattr(many.episodes.batch, name)[2]
    one.episodes.goal[0], one.episodes.push[0] = many.episodes.goal[2], many.episodes.push[2]
    for action in np.random.default_rng(1).uniform(-1, 1, (60, 6)):
        *_, numbers = many.step(np.tile(action, (3, 1)))
        *_, number = one.step(action)
        assert number["force_N"] == pytest.approx(numbers["force_N"][2], rel=1e-9)
    assert number["force_N"] > 0


def pressed(share, depth, size=1, **options):
    """Forces (size,) [N] of hands at rest with a reference `depth` [m] behind the wall, and that by K_x."""
    env = environment(size, actions="posture-stiffness", push=0.0, **options)
    env.reset(seed=0)
    episodes, task = env.episodes, env.episodes.task
    (low, high), q = ARM.angle_limits, task.postures(depth, np.zeros(1))[0]
    action = np.array([*(2 * (q - low) / (high - low) - 1), share, share])
    P = episodes.action.pressures(action[None])
    for _ in range(4000):  # until they rest
        episodes.batch.advance(np.repeat(P, size, axis=0), np.zeros((size, 2)))
    K_x = HAND.stiffness(q, ARM.mechanism.stiffness(q, P[0]))  # isobaric
    compliance = np.linalg.inv(K_x)[0, 0] + 1 / task.wall.stiffness  # of the hand, free along the wall, and the wall
    return episodes.judged()[1]["force_N"], depth / compliance


@pytest.mark.slow
def test_a_stiffer_hand_presses_harder_by_its_stiffness():
    """1 mm behind the surface all forces are those of the isobaric K_x but for 1 %, while no muscle is slack."""
    forces = []
    for share in (0.0, 0.4, 0.8):
        (force,), expected = pressed(share, 0.001)
        assert force == pytest.approx(expected, rel=0.02)
        forces.append(force)
    assert (np.diff(forces) > 0.05).all()  # [N]
    (soft,), expected = pressed(-0.5, 0.001)  # muscles at the limit of slackness
    assert soft == pytest.approx(expected, rel=0.1)
    assert soft < forces[0]


@pytest.mark.slow
def test_a_softer_hand_keeps_its_force_at_walls_of_unknown_place():
    """Both press with 2 N on the nominal wall, the softer hand from further behind it."""
    spread, stiffness = [], []
    for share in (0.0, 0.8):
        stiffness.append(pressed(share, 0.001)[1] / 0.001)
        forces, _ = pressed(share, 2.0 / stiffness[-1], 60, variation=Variation(wall_offset=0.001))
        assert forces.mean() == pytest.approx(2.0, rel=0.1)
        spread.append(forces.std())
    assert spread[1] / spread[0] == pytest.approx(stiffness[1] / stiffness[0], rel=0.15)
    assert spread[1] > 1.4 * spread[0]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"stroke": (0.1, -0.1)}, r"stroke = \(0.1, -0.1\) m has to be a range"),
        ({"force": (0.0, 2.0)}, r"force = \(0, 2\) N"),
        ({"force": 3.0}, "force = 3.0 has to be two numbers"),
        ({"period": 0.0}, "period"),
        ({"scale": -1.0}, "scale"),
        ({"clearance": -0.01}, "clearance"),
        ({"effort": -1.0}, "effort = -1.0 has to be one number that is not negative"),
        ({"wall": Wall((1.0,), 0.5)}, "normal has 1 coordinates"),
    ],
)
def test_wrong_tasks_are_refused(options, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        Wiping(ARM, **options)


@pytest.mark.slow
def test_walls_out_of_reach_are_refused():
    with pytest.raises(InvalidInput, match="stroke along the wall: the hand does not reach"):
        environment(wall=Wall(offset=0.7))


def test_hands_with_one_coordinate_are_refused():
    one = Arm(ARM.mechanism, ARM.bodies, endpoint=Endpoint.on_link(ARM.bodies.links, 1, (0.34, 0.0), axes="x"))
    with pytest.raises(InvalidInput, match="two coordinates"):
        Wiping(one, wall=Wall((1.0,), 0.5))
