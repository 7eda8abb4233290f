"""The stiffness of a hand follows, and is what pushing the hand in MuJoCo finds."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidInput, Stiffness, allocate
from allocator.mechanism import Endpoint
from allocator.units import DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.plan import PlanStatus, Rung
from mpc.trials.motions.arm_trajectories import draw, hold
from mpc.trials.simulation import in_motion, simulate

JOINTS = Arm.machine("arm26")
ARM = replace(JOINTS, endpoint=JOINTS.bodies.endpoint)


@pytest.fixture(scope="module")
def controller():
    return TrackingMPC(ARM)


@pytest.fixture
def plant():
    return MujocoPlant.of(ARM)


def pushed_hand(plant, force=0.2):
    """Return K_x (2, 2) [N/m] by forces at the hand, of which MuJoCo makes torques itself."""
    body = plant.model.nbody - 1
    moved = np.empty((2, 2))
    for i, direction in enumerate(np.eye(2)):
        ends = []
        for sign in (1.0, -1.0):
            f = np.append(sign * force * direction, 0.0)
            for _ in range(3):  # the hand moves, and its lever with it
                place = plant.data.xpos[body] + plant.data.xmat[body].reshape(3, 3) @ [ARM.bodies.length[-1], 0, 0]
                plant.data.xfrc_applied[body] = np.concatenate([f, np.cross(place - plant.data.xipos[body], f)])
                rest = plant.settle()
            ends.append(ARM.bodies.points(rest)[-1])
            plant.data.xfrc_applied[body] = 0.0
        moved[:, i] = (ends[0] - ends[1]) / (2 * force)
    return np.linalg.inv(moved)


@pytest.mark.slow
def test_the_hand_s_stiffness_turns_as_asked(controller, plant):
    asked = draw(ARM, turns=0.25)
    run = simulate(plant, controller, asked, x0=in_motion(ARM, asked))
    assert (np.sqrt(np.mean((run.theta - run.theta_ref) ** 2, axis=0)) <= 0.05 * DEG).all()
    error = np.sqrt(np.mean((run.K - run.K_ref)[50:] ** 2, axis=0)).max()
    assert error <= 0.002 * np.abs(run.K_ref).max()
    assert set(run.rung) == {Rung.QP}
    assert (run.forces > 0).all()


@pytest.mark.slow
def test_pushing_the_hand_finds_the_stiffness_that_was_asked(controller, plant):
    asked = hold(replace(ARM, endpoint=None), 0.6)
    K_x = ARM.seen(asked.theta[0], asked.K[0])
    simulate(plant, controller, replace(asked, K=np.tile(K_x, (asked.t.size, 1, 1))))
    rest = plant.settle()
    np.testing.assert_allclose(ARM.seen(rest, ARM.mechanism.stiffness(rest, plant.P)), K_x, rtol=2e-3)
    np.testing.assert_allclose(pushed_hand(plant), K_x, rtol=5e-3)


def test_the_formula_is_that_of_the_endpoint():
    import casadi as ca

    s = ARM.statics
    outputs = ca.Function("outputs", [s.q, s.P], [ARM.outputs])
    rng = np.random.default_rng(4)
    for _ in range(5):
        x = np.concatenate([rng.uniform(0.2, 0.8, 2), np.zeros(2), rng.uniform(2e5, 4e5, 6)])
        K = ARM.matrix(outputs(x[:2], x[4:]).full().ravel()[:3])
        np.testing.assert_allclose(K, ARM.tracked_stiffness(x), rtol=1e-10)
        expected = ARM.endpoint.stiffness(x[:2], ARM.mechanism.stiffness(x[:2], x[4:]))
        np.testing.assert_allclose(K, expected, rtol=1e-10)


@pytest.mark.parametrize("name", ["arm26", "leg37"])
def test_the_feed_forward_asks_the_hand(name):
    arm = Arm.machine(name)
    arm = replace(arm, endpoint=arm.bodies.endpoint)  # of leg37 with three joints, two coordinates
    N, q = 6, np.full(arm.n, 0.4) + 0.02 * np.arange(7)[:, None]
    K = arm.seen(q, np.tile(6 * np.eye(arm.n), (7, 1, 1)))
    feed = InverseDynamics(arm, 0.01, N)(q, K, np.zeros((7, arm.n)))
    T = arm.bodies.torque_for(feed.x[:, : arm.n], feed.x[:, arm.n : 2 * arm.n], np.zeros((7, arm.n)))
    held = allocate(q, K, T, joint=arm.mechanism, stiffness=Stiffness(endpoint=arm.endpoint))
    np.testing.assert_allclose(arm.matrix(feed.y[:, : arm.stiffnesses]), held.K_x, rtol=1e-3, atol=1e-3 * K.max())


@pytest.mark.slow
def test_a_singular_hand_is_refused_and_not_raised(controller):
    controller.reset()
    x = ARM.at_rest(np.array([0.3, 0.5]), 200 * np.eye(2))
    with pytest.warns(UserWarning, match="singular"):
        plan = controller.step(x, np.array([0.3, 0.0]), 200 * np.eye(2))
    assert plan.status is PlanStatus.BAD_INPUT
    controller.reset()


def test_an_endpoint_has_to_be_one_of_the_arm():
    with pytest.raises(InvalidInput, match="n = 2 joints"):
        replace(JOINTS, endpoint=Endpoint.planar([0.3, 0.3, 0.3]))
    with pytest.raises(InvalidInput, match="expected an Endpoint"):
        replace(JOINTS, endpoint="hand")


@pytest.mark.slow
def test_the_compiled_feed_forward_asks_what_the_readable_one_asks(controller):
    N, rng = controller.N, np.random.default_rng(5)
    readable, compiled = InverseDynamics(ARM, controller.dt, N), controller._feed_forward
    assert type(compiled).__name__ == "CompiledHandFeedForward"
    for reach, still in ((1.0, False), (2.0, False), (2.0, True)):  # 2.0: stiffness beyond what the muscles can do
        q = [0.3, 0.6] + 0.1 * rng.random(2) * np.linspace(0, 1, N + 1)[:, None]
        d = 0.1 * rng.normal(size=(N + 1, 2))
        q, d = (np.tile(preview[:1], (N + 1, 1)) if still else preview for preview in (q, d))
        K = reach * ARM.seen(q, np.tile([[12.0, 4.6], [4.6, 9.5]], (N + 1, 1, 1)))
        one, other = readable(q, K, d), compiled(q, K, d)
        assert (one.moved.K > 1.0) == (reach > 1)
        np.testing.assert_allclose(other.x, one.x, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(other.y, one.y, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(other.moved, one.moved, rtol=1e-5, atol=1e-8)
