"""A wall pushes an arm's hand as MuJoCo's bodies are moved by the same force, and gives back at most what it took."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from allocator import InvalidInput
from allocator.mechanism.bodies import Bodies
from allocator.mechanism.endpoint import Endpoint
from allocator.units import BAR
from mpc.arm.learning.mujoco_batch import MujocoBatch, plant_of
from mpc.arm.learning.plant import ArmBatch, Touch, VariedArm, Wall
from mpc.arm.learning.variation import Variation
from mpc.arm.mjcf import to_mjcf
from mpc.model.arm.model import Arm

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
HAND = ARM.bodies.endpoint
SKEW = (0.8, 0.6)  # a normal that mixes both coordinates
BENT = np.array([-0.45, 0.85])  # [rad] hand at (0.592, -0.003) m


def walled(stiffness=3000.0, damping=0.0, normal=SKEW, depth=-0.01, arm=ARM):
    """A wall `depth` behind the hand of the bent arm."""
    offset = float(np.dot(normal, HAND.position(BENT))) - depth
    return VariedArm(arm, wall=Wall(normal, offset, stiffness, damping))


def thrown(varied, speed=0.6, dt=0.001, **options):
    """A batch of one arm whose hand flies into the wall, without muscles."""
    batch = ArmBatch(varied, 1, dt, **options)
    towards = np.linalg.solve(HAND.jacobian(BENT), np.array(varied.wall.normal))
    batch.x[0, :4] = *BENT, *(speed * towards)
    batch.v[0, varied.places["gains"]] = 0.0
    return batch


def energies(varied, x, v):
    """Kinetic energy, and that in the wall's spring [J], in numbers of bodies and endpoint."""
    q, omega, wall = x[:2], x[2:4], v[varied.places["wall"]]
    depth = np.dot(varied.wall.normal, HAND.position(q)) - wall[0]
    return omega @ ARM.bodies.mass_matrix(q) @ omega / 2, wall[1] * max(depth, 0.0) ** 2 / 2


def collision(varied, dt=0.001):
    """Energies (k, 2) [J] along a push that ends clear of the wall, and the greatest force [N]."""
    batch, none = thrown(varied, dt=dt), (np.zeros((1, 6)), np.zeros((1, 2)))
    found, most, touch = [energies(varied, batch.x[0], batch.v[0])], 0.0, Touch(varied, 1)
    while len(found) < 1000 and (most == 0.0 or found[-1][1] > 0):
        batch.advance(*none)
        found.append(energies(varied, batch.x[0], batch.v[0]))
        most = max(most, float(touch(batch.q, batch.omega, batch.v).force[0]))
    assert found[-1][1] == 0.0
    return np.array(found), most


# --- the formula ------------------------------------------------------------------------------------------------------


def test_the_wall_s_torques_are_those_of_the_hand_s_force():
    """In numbers of the endpoint, for every arm with its own wall: N = max(k e + c e', 0), and -N Jᵀν."""
    varied = walled(2000.0, 300.0, depth=0.005)
    rng = np.random.default_rng(0)
    v = np.tile(varied.nominal, (40, 1))
    at = varied.places["wall"]
    v[:, at] *= rng.uniform([0.99, 0.5, 0.5], [1.01, 2.0, 2.0], (40, 3))
    q, omega = BENT + rng.normal(0, 0.03, (40, 2)), rng.normal(0, 1, (40, 2))
    touched = Touch(varied, 40)(q, omega, v)
    normal, J = np.array(SKEW), HAND.jacobian(q)
    depth, speed = HAND.position(q) @ normal - v[:, at][:, 0], (J @ omega[..., None])[..., 0] @ normal
    force = np.where(depth > 0, np.maximum(v[:, at][:, 1] * depth + v[:, at][:, 2] * speed, 0.0), 0.0)
    assert 5 < (force > 0).sum() < 35
    assert ((depth > 0) & (force == 0)).any()  # it does not pull a hand that leaves fast
    assert touched.x == pytest.approx(HAND.position(q), abs=1e-12)
    assert touched.force == pytest.approx(force, rel=1e-9, abs=1e-9)
    assert touched.torque == pytest.approx(HAND.torque(q, -force[:, None] * normal), rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_compiled_and_evaluated_hands_meet_the_same_wall():
    varied, none = walled(3000.0, 30.0), (np.zeros((1, 6)), np.zeros((1, 2)))
    batches = [thrown(varied, dt=0.01, compiled=compiled) for compiled in (True, False)]
    touch, forces = Touch(varied, 1), []
    for _ in range(12):
        for batch in batches:
            batch.advance(*none)
        forces.append(touch(batch.q, batch.omega, batch.v).force[0])
    assert max(forces) > 5
    assert batches[0].x == pytest.approx(batches[1].x, rel=1e-9, abs=1e-9)


def test_a_wall_out_of_reach_changes_nothing():
    free, far = VariedArm(ARM), VariedArm(ARM, wall=Wall(offset=2.0))
    batches = [ArmBatch(varied, 1, 0.01, compiled=False) for varied in (free, far)]
    for batch in batches:
        batch.x[0, 4:] = 3 * BAR
        for _ in range(5):
            batch.advance(np.full((1, 6), 4 * BAR), np.ones((1, 2)))
    assert (batches[0].x == batches[1].x).all()


def test_steps_are_short_enough_for_a_stiff_wall():
    """The substeps follow the wall's rate; with steps four times as short the rebound is the same to 1 %."""
    stiff = walled(1e5)
    assert stiff.fastest_rate > 5 * VariedArm(ARM).fastest_rate
    assert walled(3000.0, 1e4).fastest_rate > 5 * VariedArm(ARM).fastest_rate  # that of the damper
    batches = thrown(stiff, dt=0.02, compiled=False), thrown(stiff, dt=0.02, compiled=False)
    assert batches[0].substeps > 0.02 * stiff.fastest_rate
    batches[1].substeps *= 4
    for batch in batches:
        for _ in range(3):
            batch.advance(np.zeros((1, 6)), np.zeros((1, 2)))
    assert batches[0].omega == pytest.approx(batches[1].omega, rel=0.01)


# --- energy -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("dt", "stiffness"), [(0.001, 3000.0), (0.01, 3000.0), (0.01, 30000.0)])
def test_an_undamped_wall_gives_back_what_it_took(dt, stiffness):
    undamped = replace(ARM, bodies=replace(ARM.bodies, damping=0.0))
    found, most = collision(walled(stiffness, arm=undamped), dt)
    total = found.sum(axis=1)
    assert most > 5  # [N]
    assert found[:, 1].max() > 0.2 * total[0]
    assert total == pytest.approx(total[0], rel=1e-3)  # all along


@pytest.mark.slow
@pytest.mark.parametrize("damping", [3.0, 30.0, 300.0])
def test_a_damped_wall_never_gives_more(damping):
    undamped = replace(ARM, bodies=replace(ARM.bodies, damping=0.0))
    total = collision(walled(3000.0, damping, arm=undamped))[0].sum(axis=1)
    assert np.diff(total).max() < 1e-6 * total[0]
    assert total[-1] < 0.95 * total[0]


# --- MuJoCo -----------------------------------------------------------------------------------------------------------


def stepped(varied, x0, P, duration, step=5e-5):
    """Angles, velocities and forces at every ms of MuJoCo's own steps, with the wall as `xfrc_applied` at the hand."""
    mechanism, bodies, wall = varied.arm.mechanism, varied.arm.bodies, varied.wall
    model = mujoco.MjModel.from_xml_string(to_mjcf(mechanism, bodies, timestep=step))
    data, normal, found = mujoco.MjData(model), np.array([*wall.normal, 0.0]), []
    data.qpos[:], data.qvel[:] = x0[:2], x0[2:4]
    last, J = model.nbody - 1, np.zeros((3, model.nv))
    for k in range(round(duration / step)):
        mujoco.mj_fwdPosition(model, data)
        point = data.xpos[last] + data.xmat[last].reshape(3, 3) @ [bodies.length[-1], 0.0, 0.0]
        mujoco.mj_jac(model, data, J, None, point, last)
        depth = normal @ point - wall.offset
        N = max(wall.stiffness * depth + wall.damping * normal @ J @ data.qvel, 0.0) if depth > 0 else 0.0
        if k % round(1e-3 / step) == 0:
            found.append([*data.qpos, *data.qvel, N])
        data.qfrc_applied[:] = mechanism.torque(data.qpos, P)
        data.xfrc_applied[last] = *(-N * normal), *np.cross(point - data.xipos[last], -N * normal)
        mujoco.mj_step(model, data)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "tolerance"), [(0.0, 3e-4), (30.0, 8e-4)])
def test_mujoco_s_own_steps_move_the_arm_alike(damping, tolerance):
    """Under constant pressures: 0.3 s with rebounds from 0.3 m/s, in which the joints turn by 0.9 and 1.7 rad.

    The step in a damper's force at a touch makes the error of our Runge–Kutta steps one of first order.
    """
    varied = walled(3000.0, damping)
    P = np.array([3.0, 2.0, 2.5, 3.0, 2.5, 2.0]) * BAR
    batch, touch = ArmBatch(varied, 1, 0.001), Touch(varied, 1)
    batch.x[0] = [*BENT, *(0.3 * np.linalg.solve(HAND.jacobian(BENT), SKEW)), *P]
    other = stepped(varied, batch.x[0], P, 0.3)
    found = []
    for _ in other:
        found.append([*batch.x[0, :4], touch(batch.q, batch.omega, batch.v).force[0]])
        batch.advance(P[None], np.zeros((1, 2)))
    error = np.abs(np.array(found) - other)
    touching = other[:, 4] > 0
    assert touching.sum() > 30
    assert (np.diff(touching.astype(int)) != 0).sum() >= 2  # it comes and goes

    assert error[:, :2].max() < tolerance  # [rad]
    assert np.quantile(error[:, 4], 0.95) < 0.01 * other[:, 4].max()


@pytest.mark.slow
def test_batches_on_mujoco_and_compiled_meet_the_same_wall():
    varied = walled(3000.0, 30.0)
    values = Variation(gains=0.1, mass=0.2, wall_offset=0.003, wall_stiffness=0.3).draw(
        varied, 3, np.random.default_rng(0)
    )
    batches, P = (ArmBatch(varied, 3, 0.005), MujocoBatch(varied, 3, 0.005)), np.full((3, 6), 3 * BAR)
    for some in batches:
        some.v[:] = values
        some.x[:, :2], some.x[:, 4:] = BENT, P
        some.x[:, 2:4] = 0.3 * np.linalg.solve(HAND.jacobian(BENT), SKEW)
        some.renew(np.ones(3, bool))
    touch, pressed = Touch(varied, 3), np.zeros(3)
    for _ in range(40):
        for some in batches:
            some.advance(P, np.zeros((3, 2)))
        pressed += touch(batches[0].q, batches[0].omega, values).force > 0
    assert (pressed > 0).all()
    assert np.abs(batches[0].q - batches[1].q).max() < 1e-4


def test_a_wall_is_drawn_where_it_is_and_touches_nothing():
    varied = walled()
    model = plant_of(varied).model
    box = model.geom(np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_BOX))[0])
    assert np.dot(box.pos, [*SKEW, 0.0]) - box.size[0] == pytest.approx(varied.wall.offset)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, box.quat)
    assert turn[::3] == pytest.approx([*SKEW, 0.0])  # its first axis is the normal
    assert box.contype[0] == box.conaffinity[0] == 0
    assert model.nbody == plant_of(VariedArm(ARM)).model.nbody


# --- what may be asked ------------------------------------------------------------------------------------------------


def test_walls_vary_as_wide_as_told():
    varied = walled()
    at = varied.places["wall"]
    v = Variation(wall_offset=0.003, wall_stiffness=0.4).draw(varied, 5000, np.random.default_rng(0))
    offset, stiffness, damping = v[:, at].T
    assert offset.mean() == pytest.approx(varied.wall.offset, abs=2e-4)
    assert offset.std() == pytest.approx(0.003, rel=0.05)
    assert np.log(stiffness / 3000).std() == pytest.approx(0.4, rel=0.05)
    assert (damping == varied.wall.damping).all()
    assert (np.delete(v, np.arange(v.shape[1])[at], axis=1) == np.delete(varied.nominal, np.r_[at])).all()


def test_a_hand_of_one_s_own_meets_the_wall():
    """Such as a point in the middle of the forearm, which has a wall of its own coordinates."""
    middle = Endpoint.on_link(ARM.bodies.links, 1, (0.17, 0.0), axes="x")
    varied = VariedArm(replace(ARM, endpoint=middle), wall=Wall((-1.0,), -0.3, 1000.0, 0.0))
    q = np.array([[0.0, 0.0], [0.9, 1.0]])
    force = Touch(varied, 2)(q, np.zeros((2, 2)), np.tile(varied.nominal, (2, 1))).force
    x = middle.position(q)[:, 0]
    assert x[1] < 0.3 < x[0]
    assert force == pytest.approx([0.0, 1000 * (0.3 - x[1])])


def test_wrong_walls_are_refused():
    with pytest.raises(InvalidInput, match="unit vector"):
        Wall((1.0, 1.0))
    with pytest.raises(InvalidInput, match="stiffness"):
        Wall(stiffness=-1.0)
    with pytest.raises(InvalidInput, match="damping"):
        Wall(damping=-1.0)
    with pytest.raises(InvalidInput, match="normal has 3 coordinates"):
        VariedArm(ARM, wall=Wall((0.0, 0.0, 1.0)))
    with pytest.raises(InvalidInput, match="wall is a float"):
        VariedArm(ARM, wall=0.5)
    with pytest.raises(InvalidInput, match="need a wall"):
        Variation(wall_offset=0.01).check(VariedArm(ARM))


def test_an_arm_without_a_hand_meets_no_wall():
    class Handless(Bodies):
        endpoint = None

    bodies = Handless(**{name: getattr(ARM.bodies, name) for name in ARM.bodies.__dataclass_fields__})
    with pytest.raises(InvalidInput, match="needs a hand"):
        VariedArm(replace(ARM, bodies=bodies), wall=Wall())
