"""What is written as MJCF is read again as it was, and MuJoCo finds the bodies' equations of motion in it."""

import mujoco
import numpy as np
import pytest

from allocator import InvalidInput
from allocator.mechanism import Link, Mechanism, Pulleys, Sites, Tables, machines
from allocator.mechanism.bodies import Bodies, arm26_bodies, arm48_bodies, leg37_bodies
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc.arm.mjcf import to_mjcf

ODD = Bodies(
    (0.3, 0.25, 0.2), (1.1, 0.7, 0.3), (0.1, 0.2, 0.05), (0.02, 0.01, 0.003), (0.3, 0.1, 0.0), (3.0, -9.0), (-1, 1, -1)
)
MACHINES = {
    "arm26": (machines.arm26(), arm26_bodies()),
    "arm48": (machines.arm48(), arm48_bodies()),
    "leg37": (machines.leg37(), leg37_bodies()),
    "odd": (machines.leg37(), ODD),
}
TURNED = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
TREE = Sites(
    (0.4, 0.35, 0.5),
    [
        Link(axis=(0.1, 0.0, 1.0), zero=0.2),
        Link(0, (0.3, 0.01, 0.02), (0.0, 1.0, 0.3), orientation=TURNED),
        Link(0, (0.2, 0.0, 0.0), (1.0, 0.2, 0.0), kind="slide", zero=0.05),
    ],
    [
        [(-1, (0.05, 0.06, 0.01)), (0, (0.2, 0.03, 0.0))],
        [(-1, (0.05, -0.06)), (0, (0.2, -0.03)), (1, (0.1, 0.04, -0.02))],
        [(0, (0.1, 0.05)), (2, (0.15, 0.02, 0.01))],
    ],
    (0.0, 0.02, -0.1),
)


def compare_routes(one, two, count=50):
    q = np.random.default_rng(1).uniform(-0.6, 0.6, (count, one.n))
    for a, b in zip(one.routes.at(q), two.routes.at(q), strict=True):
        assert a == pytest.approx(b, rel=1e-13, abs=1e-14)
    assert one.routes.contraction(one.routes.at(q).length) == pytest.approx(two.contractions(q), abs=1e-13)


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_on_pulleys_is_read_as_it_was(name):
    machine, bodies = MACHINES[name]
    read = Mechanism.from_mjcf(to_mjcf(machine, bodies), machine.muscles)
    assert isinstance(read.routes, Pulleys)
    assert read.routes.arms == machine.routes.arms
    assert (read.muscle_names, read.joint_names) == (machine.muscle_names, machine.joint_names)
    assert read.angle_limits == machine.angle_limits
    compare_routes(machine, read)


def test_sites_of_a_tree_in_space_are_read_as_they_were(tmp_path):
    machine = Mechanism(TREE, SAROSI_DMSP_20_400N, joint_names=("a", "b", "c"))
    path = tmp_path / "tree.xml"
    path.write_text(to_mjcf(machine, ODD))
    read = Mechanism.from_mjcf(path, SAROSI_DMSP_20_400N)
    assert read.routes.cable == TREE.cable
    assert read.routes.rest_length == TREE.rest_length
    assert read.angle_limits is None
    compare_routes(machine, read)


@pytest.mark.parametrize("name", MACHINES)
def test_mujoco_moves_the_bodies(name):
    machine, bodies = MACHINES[name]
    model = mujoco.MjModel.from_xml_string(to_mjcf(machine, bodies))
    data, M = mujoco.MjData(model), np.zeros((bodies.n, bodies.n))
    rng = np.random.default_rng(2)
    for _ in range(30):
        q, omega = rng.uniform(-1.5, 1.5, bodies.n), rng.uniform(-5, 5, bodies.n)
        data.qpos[:], data.qvel[:] = q, omega
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        assert M == pytest.approx(bodies.mass_matrix(q), rel=1e-11)
        bias = data.qfrc_bias - data.qfrc_passive
        assert bias == pytest.approx(bodies.bias(q, omega), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("name", MACHINES)
def test_what_is_drawn_touches_nothing(name):
    machine, bodies = MACHINES[name]
    model = mujoco.MjModel.from_xml_string(to_mjcf(machine, bodies))
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert model.body_mass[1:] == pytest.approx(bodies.mass)


def test_a_planar_chain_of_sites_moves_as_its_bodies():
    back = (0.0, 0.0, -1.0)  # the sense of an axis
    links = [Link(axis=back), Link(0, (0.3, 0.0)), Link(1, (0.25, 0.0), back)]
    paths = [
        [(-1, (-0.1, 0.05)), (0, (0.1, 0.03))],
        [(0, (0.1, 0.03)), (1, (0.1, 0.03))],
        [(1, (0.1, 0.03)), (2, (0.1, 0.02))],
    ]
    text = to_mjcf(Mechanism(Sites(0.3, links, paths), SAROSI_DMSP_20_400N), ODD)
    model = mujoco.MjModel.from_xml_string(text)
    data, M = mujoco.MjData(model), np.zeros((3, 3))
    data.qpos[:] = q = (0.3, -0.5, 0.9)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    assert M == pytest.approx(ODD.mass_matrix(q), rel=1e-12)


def test_what_cannot_be_written_is_refused():
    with pytest.raises(InvalidInput, match="n = 2 links; the mechanism has n = 3"):
        to_mjcf(machines.leg37(), arm26_bodies())
    grid = np.linspace(-1, 1, 5)
    table = Tables(0.4, [grid], (0.345 - 0.02 * grid)[:, None])
    one = Bodies.rods((0.3,), (1.0,), 0.1)
    with pytest.raises(InvalidInput, match="Tables cannot be written as MJCF"):
        to_mjcf(Mechanism(table, SAROSI_DMSP_20_400N), one)


def test_a_model_that_does_not_tell_its_rest_lengths_says_so():
    text = to_mjcf(*MACHINES["arm26"]).replace('name="antagonist" data', 'name="other" data')
    with pytest.raises(InvalidInput, match=r"give the rest lengths of the muscles \(rest_length \[m\]"):
        Mechanism.from_mjcf(text, SAROSI_DMSP_20_400N)
    read = Mechanism.from_mjcf(text, SAROSI_DMSP_20_400N, 0.4, cable=-0.345)
    assert read.routes.initial_contraction == pytest.approx((0.1375,) * 6)
