"""MuJoCo as the witness: lengths and arms are its tendons', torque and stiffness those of forces along them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from allocator import InvalidFile
from allocator.mechanism import Link, Mechanism, Sites
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR

SWING = '<joint name="swing" axis="0 0.1 1" range="-1 1" limited="true"/>'
TWIST = '<joint name="twist" axis="1 0 0" pos="0.02 0.01 0" ref="0.1" range="-1 1" limited="true"/>'
ARM = f"""
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <site name="s1" pos="0.03 0.05 0.01"/> <site name="s2" pos="0.03 -0.05 0.0"/>
    <site name="s3" pos="-0.02 0.07 -0.01"/> <site name="s4" pos="-0.02 -0.07 0.02"/>
    <body name="upper" pos="0 0 0.02" quat="0.98 0.05 -0.1 0.17">
      {SWING}
      {TWIST}
      <geom size="0.02" mass="1"/>
      <site name="u1" pos="0.12 0.04 0"/> <site name="u2" pos="0.12 -0.04 0"/>
      <body name="bracket" pos="0.15 0 0.01" euler="0.2 0 0">
        <geom size="0.02" mass="1"/>
        <site name="b1" pos="0.02 0.045 0"/> <site name="b2" pos="0.02 -0.045 0.01"/>
        <body name="lower" pos="0.13 0 0">
          <joint name="elbow" axis="0.05 0 1" pos="0.01 0.01 0" range="-1 1" limited="true"/>
          <geom size="0.02" mass="1"/>
          <site name="l1" pos="0.12 0.03 0.01"/> <site name="l2" pos="0.12 -0.03 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="flexor"><site site="s1"/><site site="u1"/></spatial>
    <spatial name="extensor"><site site="s2"/><site site="u2"/></spatial>
    <spatial name="elbow flexor"><site site="b1"/><site site="l1"/></spatial>
    <spatial name="elbow extensor"><site site="b2"/><site site="l2"/></spatial>
    <spatial name="long flexor"><site site="s3"/><site site="b1"/><site site="l1"/></spatial>
    <spatial name="long extensor"><site site="s4"/><site site="u2"/><site site="l2"/></spatial>
  </tendon>
</mujoco>
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mjcf") / "arm.xml"
    path.write_text(ARM)
    return path


@pytest.fixture(scope="module")
def arm(file):
    at_rest = mujoco.MjModel.from_xml_path(str(file)).tendon_length0
    return Mechanism.from_mjcf(file, SAROSI_DMSP_20_400N, 0.4, cable=at_rest - 0.4 * (1 - 0.1375))


class Witness:
    """MuJoCo's own lengths and generalised forces, with a force along every tendon."""

    def __init__(self, file):
        self.model = mujoco.MjModel.from_xml_path(str(file))
        self.data = mujoco.MjData(self.model)

    def at(self, q):
        self.data.qpos[:] = q
        mujoco.mj_forward(self.model, self.data)
        J = np.array(self.data.ten_J)
        if J.shape != (self.model.ntendon, self.model.nv):  # sparse in newer versions
            dense = np.zeros((self.model.ntendon, self.model.nv))
            mujoco.mju_sparse2dense(dense, J.ravel(), *self._layout())
            J = dense
        return np.array(self.data.ten_length), J

    def _layout(self):
        holder = self.data if hasattr(self.data, "ten_J_rownnz") else self.model
        return (np.ravel(getattr(holder, f"ten_J_{part}")) for part in ("rownnz", "rowadr", "colind"))

    def torque(self, q, P, arm, length0):
        """-Jᵀ F, F of the muscle's law at MuJoCo's lengths (τ_j = -∂l/∂q F)."""
        length, J = self.at(q)
        eps = (0.4 - (length - length0 + 0.4 * (1 - 0.1375))) / 0.4
        return -J.T @ np.array([m.force(p, e) for m, p, e in zip(arm.muscles, P, eps, strict=True)])


@pytest.mark.parametrize("postures", [50, pytest.param(1000, marks=pytest.mark.slow)])
def test_torque_and_stiffness_are_mujoco_s(arm, file, postures):
    witness = Witness(file)
    length0 = witness.model.tendon_length0
    rng = np.random.default_rng(0)
    Q, P = rng.uniform(-0.6, 0.6, (postures, 3)), rng.uniform(1, 5, (postures, 6)) * BAR
    T, K = arm.torque(Q, P), arm.stiffness(Q, P)
    lengths, arms = arm.lengths(Q), arm.arms(Q)
    h = 1e-5
    for i in range(postures):
        length, J = witness.at(Q[i])
        assert lengths[i] == pytest.approx(length - length0 + 0.4 * (1 - 0.1375), abs=1e-13)
        assert arms[i] == pytest.approx(-J, abs=1e-13)
        expected = witness.torque(Q[i], P[i], arm, length0)
        assert np.abs(T[i] - expected).max() <= 1e-11 * np.abs(expected).max()
        steps = [
            (witness.torque(Q[i] + h * e, P[i], arm, length0) - witness.torque(Q[i] - h * e, P[i], arm, length0))
            for e in np.eye(3)
        ]
        K_witness = -np.stack(steps, axis=-1) / (2 * h)
        assert np.abs(K[i] - K_witness).max() <= 1e-6 * np.abs(K_witness).max()


def test_from_mjcf_is_what_one_writes_by_hand(tmp_path):
    path = tmp_path / "planar.xml"
    path.write_text("""
      <mujoco><worldbody>
        <site name="g1" pos="0.05 0.06 0"/><site name="g2" pos="0.05 -0.06 0"/>
        <body><joint type="hinge" axis="0 0 1"/><geom size="0.01" mass="1"/>
          <site name="a1" pos="0.3 0.03 0"/><site name="a2" pos="0.3 -0.03 0"/>
          <body pos="0.35 0 0"><joint type="hinge" axis="0 0 1"/><geom size="0.01" mass="1"/>
            <site name="c" pos="0.05 0.04 0"/></body></body>
      </worldbody><tendon>
        <spatial><site site="g1"/><site site="a1"/></spatial>
        <spatial><site site="g2"/><site site="a2"/></spatial>
        <spatial><site site="g1"/><site site="a1"/><site site="c"/></spatial>
      </tendon></mujoco>""")
    read = Mechanism.from_mjcf(path, SAROSI_DMSP_20_400N, 0.4)
    hand = Sites(
        0.4,
        [Link(), Link(0, (0.35, 0.0))],
        [
            [(-1, (0.05, 0.06)), (0, (0.3, 0.03))],
            [(-1, (0.05, -0.06)), (0, (0.3, -0.03))],
            [(-1, (0.05, 0.06)), (0, (0.3, 0.03)), (1, (0.05, 0.04))],
        ],
    )
    assert read.muscle_names == ("1", "2", "3")
    assert read.angle_limits is None
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 2))
    for one, two in zip(read.routes.at(q), hand.at(q), strict=True):
        assert one == pytest.approx(two, rel=1e-13, abs=1e-15)


def test_names_and_ranges_come_along(arm):
    assert arm.muscle_names[4] == "long flexor"
    assert arm.joint_names == ("swing", "twist", "elbow")
    assert arm.angle_limits == ((-1.0, 1.0),) * 3


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("<mujoco><worldbody/></mujoco>", "no tendons"),
        ("<mujoco><nonsense", "not read by MuJoCo"),
        (ARM.replace(SWING, '<joint type="ball"/>').replace(TWIST, ""), "neither a hinge nor a slide"),
        (ARM.replace("</tendon>", '<fixed name="sum"><joint joint="elbow" coef="1"/></fixed></tendon>'), "tendon sum"),
        (
            ARM.replace(SWING, SWING.replace('-1 1" limited="true"', '1 -1"')),
            "swing has the range 1 to -1 rad .* lower end",
        ),
        (ARM.replace('<site site="u1"/>', '<site site="s2"/>'), "tendon flexor has no arm at any joint"),
        (ARM.replace('pos="0.03 0.05 0.01"', 'pos="30 50 10"'), "tendon flexor is 59.* m long; .* in metres"),
    ],
)
def test_models_that_cannot_be_taken(tmp_path, text, sentence):
    path = tmp_path / "model.xml"
    path.write_text(text)
    with pytest.raises(InvalidFile, match=sentence):
        Mechanism.from_mjcf(path, SAROSI_DMSP_20_400N, 0.4)


def test_a_file_that_does_not_exist(tmp_path):
    with pytest.raises(InvalidFile, match="does not exist"):
        Mechanism.from_mjcf(Path(tmp_path) / "none.xml", SAROSI_DMSP_20_400N, 0.4)
