"""Arms that are read from MuJoCo models move as MuJoCo moves them, by formulas and by differences."""

import mujoco
import numpy as np
import pytest

from allocator import InvalidInput
from allocator.errors import InvalidFile
from allocator.mechanism import Endpoint, Link
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N as MUSCLE
from mpc.model.arm.differences import Differences
from mpc.model.arm.model import Arm
from mpc.model.arm.mujoco_mechanics import Mechanics, MujocoBodies, MujocoTendons, TendonJacobian
from mpc.model.arm.reading import read_arm
from mpc.model.arm.tree import TreeBodies
from mpc.model.experiment import RESOLUTION
from mpc.tracking.linearise import Predictor

LATIN = """<mujoco><worldbody><body><joint name="sch\u00fctz"/><geom size=".1"/></body></worldbody></mujoco>"""

CROOKED = """<mujoco><compiler angle="degree"/><option gravity="1 -2 -9"/>
<worldbody><site name="w" pos="-.3 0 0.1"/><body pos=".1 .2 .3" euler="10 20 30">
<joint name="a" axis="0 1 1" pos="0.02 0 0.01" damping=".2" armature=".01" ref="10"/>
<joint name="b" axis="1 0 0" pos="0.02 0.03 0.01" damping=".1" stiffness="3" springref="20"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0.1" size=".03"/><site name="u" pos=".1 .1 .1"/>
<body pos=".3 0 .1" euler="0 40 0"><geom type="box" size=".02 .03 .05" pos="0 0.05 0"/>
 <body pos="0 .1 0"><joint name="c" axis="0 0 1"/><geom type="sphere" size=".05" pos=".1 0 0"/><site name="v"/></body>
 <body pos="0 .1 0.1"><joint name="d" axis="0 1 0"/><geom type="sphere" size=".03" pos=".1 0 0"/></body>
</body></body></worldbody>
<tendon><spatial name="one"><site site="w"/><site site="u"/></spatial></tendon></mujoco>"""

PAIRS = """<mujoco><option gravity="0 -9.81 0"/>{extra}<worldbody>
<site name="a1" pos="-.3 .02 0"/><site name="a2" pos="-.3 -.02 0"/>
<body><joint name="shoulder" axis="0 0 1" damping=".2" range="-45 45"/>
 <geom name="roll" type="cylinder" size=".02 .02" mass=".1"/>
 <geom type="capsule" fromto="0 0 0 .25 0 0" size=".01" mass=".5" contype="0" conaffinity="0"/>
 <site name="s1" pos="0 .03 0"/><site name="s2" pos="0 -.03 0"/><site name="b1" pos=".05 .02 0"/>
 <site name="b2" pos=".05 -.02 0"/>
 <body pos=".25 0 0"><joint name="elbow" axis="0 0 1" damping=".15" range="-45 45"/>
  <geom type="capsule" fromto="0 0 0 .2 0 0" size=".01" mass=".3" contype="0" conaffinity="0"/>
  <site name="c1" pos=".06 .03 0"/><site name="c2" pos=".06 -.03 0"/><site name="tip" pos=".2 0 0"/></body></body>
</worldbody><tendon>
<spatial name="flexor"><site site="a1"/>{over}<site site="b1"/></spatial>
<spatial name="extensor"><site site="a2"/>{under}<site site="b2"/></spatial>
<spatial name="biceps"><site site="a1"/><site site="b1"/><site site="c1"/></spatial>
<spatial name="triceps"><site site="a2"/><site site="b2"/><site site="c2"/></spatial>
</tendon></mujoco>"""
STRAIGHT = PAIRS.format(extra="", over="", under="")
ROUND = (
    PAIRS.format(extra="", over='<geom geom="roll" sidesite="s1"/>', under='<geom geom="roll" sidesite="s2"/>')
    .replace('pos="-.3 .02 0"', 'pos="-.3 .01 0"')
    .replace('pos="-.3 -.02 0"', 'pos="-.3 -.01 0"')
)


def read(text, **other):
    return read_arm(text, MUSCLE, **({"rest_length": 0.3, "contraction": 0.14} | other))


def test_crooked_bodies_on_crooked_hinges_are_mujoco_s():
    arm = Arm.from_mjcf(CROOKED, MUSCLE, 0.3, contraction=0.14)
    bodies = arm.bodies
    assert isinstance(bodies, TreeBodies)
    model = mujoco.MjModel.from_xml_string(CROOKED)
    data, rng = mujoco.MjData(model), np.random.default_rng(7)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    for _ in range(10):
        q, omega, alpha = rng.uniform(-2, 2, 4), rng.normal(0, 4, 4), rng.normal(0, 20, 4)
        data.qpos[:], data.qvel[:] = q, omega
        mujoco.mj_forward(model, data)
        M = np.zeros((4, 4))
        mujoco.mj_fullM(model, data, M)
        data.qacc[:] = alpha
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(bodies.mass_matrix(q), M, rtol=0, atol=1e-12)
        np.testing.assert_allclose(bodies.torque_for(q, omega, alpha), data.qfrc_inverse, rtol=0, atol=1e-11)
        own = bodies.mass_matrix(q) @ alpha + bodies.bias(q, omega)
        np.testing.assert_allclose(own, data.qfrc_inverse, rtol=0, atol=1e-11)


def test_stacks_of_postures_and_slopes_of_gravity_are_those_of_single_ones():
    bodies = read(CROOKED).bodies
    q, omega, alpha = np.random.default_rng(1).normal(size=(3, 2, 5, 4))
    whole = bodies.torque_for(q, omega, alpha), bodies.mass_matrix(q), bodies.gravity_stiffness(q)
    for k in np.ndindex(2, 5):
        one = bodies.torque_for(q[k], omega[k], alpha[k]), bodies.mass_matrix(q[k]), bodies.gravity_stiffness(q[k])
        for stack, single in zip(whole, one, strict=True):
            np.testing.assert_allclose(stack[k], single, atol=1e-13)
    single = TreeBodies((Link(),), 1.0, [[0.1, 0, 0]], [np.eye(3) * 0.01], 0.1, 0.0, 0.0, 0.0, (0.0, -9.81, 0.0))
    assert single.mass_matrix([0.3]).shape == (1, 1)
    assert single.mass_matrix(np.zeros((5, 1))).shape == single.gravity_stiffness(np.zeros((5, 1))).shape == (5, 1, 1)
    np.testing.assert_allclose(single.gravity_torque([[0.0], [np.pi]]), [[0.981], [-0.981]])
    h = 1e-6 * np.eye(4)
    slope = (bodies.gravity_torque(q[0, 0] + h) - bodies.gravity_torque(q[0, 0] - h)) / 2e-6
    np.testing.assert_allclose(whole[2][0, 0], slope, atol=1e-7)


def test_bodies_keep_the_numbers_that_their_formulas_were_compiled_with():
    bodies = read(CROOKED).bodies
    for name in ("mass", "centre", "inertia", "damping", "armature", "spring", "spring_zero", "gravity"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(bodies, name)[0] = 1.0


def test_what_mujoco_is_asked_for_is_what_the_formulas_say():
    read_ = read(STRAIGHT)
    mechanics, rng = Mechanics(read_.model), np.random.default_rng(2)
    bodies, routes = MujocoBodies(mechanics), MujocoTendons.of(mechanics, 0.3, read_.mechanism.routes.cable)
    assert not read_.asked_of_mujoco
    q, omega, alpha = rng.uniform(-0.6, 0.6, (3, 6, 2))
    np.testing.assert_allclose(bodies.torque_for(q, omega, alpha), read_.bodies.torque_for(q, omega, alpha), atol=1e-12)
    np.testing.assert_allclose(bodies.gravity_stiffness(q), read_.bodies.gravity_stiffness(q), atol=1e-8)
    for mine, theirs in zip(routes.at(q), read_.mechanism.routes.at(q), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9)


def relative(found, exact):
    """Return the greatest error of matrices by states or commands, in fractions of their rows."""
    units = np.array([1.0] * (exact.shape[-1] - 4) + [1e5] * 4)  # the last four are pressures
    return (np.abs(found - exact) * units / np.abs(exact * units).max(axis=-1, keepdims=True)).max()


@pytest.mark.parametrize("gas", [False, True], ids=["no gas", "gas"])
@pytest.mark.parametrize("endpoint", [None, "tip"])
def test_differences_find_the_motion_and_the_slopes_of_the_formulas(endpoint, gas):
    from dataclasses import replace

    read_ = read(STRAIGHT)
    hand = None if endpoint is None else Endpoint.from_mjcf(read_.model, endpoint, axes="xy")
    arm = replace(Arm(read_.mechanism, read_.bodies, gas=gas), endpoint=hand)
    mechanics = Mechanics(read_.model)
    other = replace(
        arm,
        mechanism=replace(arm.mechanism, routes=MujocoTendons.of(mechanics, 0.3, read_.mechanism.routes.cable)),
        bodies=MujocoBodies(mechanics),
    )
    assert not arm.unformulated
    assert other.unformulated
    rng, N = np.random.default_rng(3), 4
    x = np.concatenate([[0.2, 0.5], rng.normal(0, 0.5, 2), rng.uniform(2.8e5, 3.2e5, 4)])
    u, d = rng.uniform(2.8e5, 3.2e5, (N, 4)), rng.normal(0, 0.3, (N, 2))
    errors = []
    for dt in (0.01, 0.005):
        exact = Predictor(arm, dt, N).linearise(x, u, d)
        states, y, A, B, slope = Differences(other, dt, RESOLUTION).linearise(x, u, d)
        assert relative(B[0], exact.B[0]) < 0.02
        errors.append(relative(A[0], exact.A[0]))
    assert errors[0] < 0.01
    assert errors[1] < errors[0] / 3  # of the third order in dt, in fractions of entries of the first
    np.testing.assert_allclose(states, exact.x, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(y[:, :-4], exact.K, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(y[:, -4:], exact.F, rtol=1e-5, atol=1e-4)
    units = np.concatenate([np.ones(4), np.full(4, 1e5)])
    np.testing.assert_allclose(slope * units, exact.slope * units, rtol=1e-4, atol=1e-3)


def test_a_tendon_round_a_geom_is_asked_of_mujoco():
    arm = Arm.from_mjcf(ROUND, MUSCLE, 0.3, contraction=0.14)
    assert "flexor" in read(ROUND).asked_of_mujoco
    assert arm.unformulated
    model = mujoco.MjModel.from_xml_string(ROUND)
    data = mujoco.MjData(model)
    data.qpos[:] = [0.1, 0.2]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(arm.mechanism.arms(data.qpos), -TendonJacobian(model, data)(), atol=1e-12)
    assert abs(arm.mechanism.arms(data.qpos)[1, 0] + 0.02) < 1e-9  # the radius of the roll
    P, h = np.full(4, 3e5), 1e-4 * np.eye(2)
    torque = arm.mechanism.torque
    slope = (torque(data.qpos + h, P) - torque(data.qpos - h, P)) / 2e-4
    np.testing.assert_allclose(arm.mechanism.stiffness(data.qpos, P), -slope, atol=1e-4)


TIED = '<equality><joint name="tie" joint1="shoulder" joint2="elbow"/></equality>'


@pytest.mark.parametrize(
    ("text", "given", "said"),
    [
        (STRAIGHT, {"rest_length": None, "contraction": None}, "its tendons are 35"),
        (STRAIGHT, {"rest_length": None}, "its tendons are 35"),
        (STRAIGHT, {"rest_length": 0.9}, "shorter than its muscle"),
        (STRAIGHT, {"contraction": 14.0}, "not per cent"),
        (STRAIGHT, {"cable": 0.1}, "both given"),
        (STRAIGHT, {"hand": "nowhere"}, "no site or body called 'nowhere'"),
        (STRAIGHT, {"muscles": [MUSCLE] * 3}, "3 given"),
        (PAIRS.format(extra=TIED, over="", under=""), {}, "equality constraint tie"),
        (STRAIGHT.replace('name="elbow"', 'name="elbow" type="slide"'), {}, "joint elbow is no hinge"),
        (STRAIGHT.replace('name="elbow" axis="0 0 1" damping=".15" range="-45 45"', 'type="ball"'), {}, "no hinge"),
    ],
)
def test_what_is_no_such_arm_is_one_sentence(text, given, said):
    options = {"muscles": MUSCLE, "rest_length": 0.3, "contraction": 0.14} | given
    with pytest.raises((InvalidInput, InvalidFile), match=said) as raised:
        read_arm(text, **options)
    assert "\n" not in str(raised.value)


def test_the_hand_is_the_last_site_with_what_the_joints_move():
    found = read(STRAIGHT)
    assert (found.hand_name, found.hand.dim, found.hand.kinematics.axes) == ("tip", 2, "xy")
    np.testing.assert_allclose(found.hand.position(np.zeros(2)), [0.45, 0.0], atol=1e-12)
    assert read(STRAIGHT, hand="c1:y").hand.kinematics.axes == "y"


def test_actuators_are_switched_off_and_that_is_said():
    motors = STRAIGHT.replace("</mujoco>", '<actuator><position joint="elbow" kp="50"/></actuator></mujoco>')
    assert "1 actuators" in read(motors).left_out
    assert read(motors).model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)


def test_a_model_that_is_not_in_utf8_is_refused_by_its_name_and_so_is_one_that_includes_such_a_file(tmp_path):
    wrong, including = tmp_path / "latin.xml", tmp_path / "including.xml"
    wrong.write_bytes(LATIN.encode("latin-1"))
    including.write_text('<mujoco><include file="latin.xml"/></mujoco>')
    for path in (wrong, including):
        with pytest.raises(InvalidFile, match=rf"{path.name}.* is not in UTF-8"):
            read_arm(path, MUSCLE, contraction=0.1)
    wrong.write_text(LATIN, encoding="utf-8")
    with pytest.raises(InvalidFile, match="has no tendons"):  # which is what is wrong with it otherwise
        read_arm(including, MUSCLE, contraction=0.1)
