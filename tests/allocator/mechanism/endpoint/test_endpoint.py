"""Position, Jacobian and stiffness of an endpoint, against CasADi, MuJoCo and a hand on a spring."""

import casadi
import mujoco
import numpy as np
import pytest

from allocator import InvalidFile, InvalidInput
from allocator.mechanism import Endpoint, Link

LENGTHS = [0.3, 0.25, 0.1]
PLANAR = Endpoint.planar(LENGTHS)
SPATIAL = [
    Link(axis=(0.2, -0.1, 1.0)),
    Link(0, origin=(0.3, 0.0, 0.05), axis=(1.0, 0.3, 0.0), kind="slide", zero=0.02),
    Link(1, origin=(0.1, 0.02, 0.0), axis=(0.0, 1.0, 0.4)),
]
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.02" quat="0.98 0.05 -0.1 0.17">
      <joint name="swing" axis="0 0.1 1"/> <joint name="twist" axis="1 0 0" pos="0.02 0.01 0" ref="0.1"/>
      <geom size="0.02" mass="1"/>
      <body name="lower" pos="0.28 0 0.01" euler="0.2 0 0">
        <joint name="elbow" axis="0.05 0 1" pos="0.01 0.01 0"/>
        <geom size="0.02" mass="1"/>
        <body name="palm" pos="0.2 0.01 0"> <geom size="0.02" mass="1"/> <site name="hand" pos="0.05 0 0.02"/> </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def by_casadi(lengths):
    def x(q):
        angles = [casadi.sum1(q[: i + 1]) for i in range(len(lengths))]
        return [
            sum(length * casadi.cos(angle) for length, angle in zip(lengths, angles, strict=True)),
            sum(length * casadi.sin(angle) for length, angle in zip(lengths, angles, strict=True)),
        ]

    return Endpoint.from_function(len(lengths), x)


def differences(f, q, h=1e-6):
    return np.stack([(f(q + h * e) - f(q - h * e)) / (2 * h) for e in np.eye(q.size)], axis=-1)


def test_a_planar_arm_is_what_its_formula_says():
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (4, 5, 3))
    other = by_casadi(LENGTHS)
    assert (PLANAR.n, PLANAR.dim) == (other.n, other.dim) == (3, 2)
    for ours, theirs in zip(PLANAR.at(q), other.at(q), strict=True):
        assert ours.shape == theirs.shape
        assert ours == pytest.approx(theirs, abs=1e-14)


@pytest.mark.parametrize(
    "endpoint",
    [PLANAR, Endpoint.on_link(SPATIAL, 2, (0.1, 0.05, 0.02)), Endpoint.on_link(SPATIAL, 1, (0.1, 0), axes="zx")],
)
def test_jacobian_and_hessian_are_derivatives(endpoint):
    q = np.array([0.3, -0.2, 0.7])
    assert endpoint.jacobian(q) == pytest.approx(differences(endpoint.position, q), abs=1e-9)
    assert endpoint.hessian(q) == pytest.approx(differences(endpoint.jacobian, q), abs=1e-9)


@pytest.mark.parametrize("name", ["hand", "palm"])
def test_mujoco_finds_the_hand_at_the_same_place_with_the_same_jacobian(tmp_path, name):
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    endpoint = Endpoint.from_mjcf(path, name)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, J = mujoco.MjData(model), np.zeros((3, model.nv))
    for q in np.random.default_rng(1).uniform(-1, 1, (20, 3)):
        data.qpos = q
        mujoco.mj_forward(model, data)
        place = data.site(name).xpos if name == "hand" else data.body(name).xpos
        jacobian = mujoco.mj_jacSite if name == "hand" else mujoco.mj_jacBody
        jacobian(model, data, J, None, (data.site if name == "hand" else data.body)(name).id)
        assert endpoint.position(q) == pytest.approx(place, abs=1e-12)
        assert endpoint.jacobian(q) == pytest.approx(J, abs=1e-12)


@pytest.mark.parametrize(
    "endpoint", [Endpoint.planar([0.3, 0.3]), PLANAR, Endpoint.on_link(SPATIAL, 2, (0.1, 0.05, 0))]
)
def test_joints_feel_a_hand_on_a_spring(endpoint):
    """A hand that exerts f - K_x (x - x0) needs torques whose slope over the joints is -K_q   (M4)"""
    rng = np.random.default_rng(2)
    q = rng.uniform(-1, 1, endpoint.n)
    f, root = rng.uniform(-20, 20, endpoint.dim), rng.uniform(-1, 1, (endpoint.dim, endpoint.dim))
    K_x, x = 100 * root @ root.T, endpoint.position(q)
    torque = differences(lambda p: endpoint.torque(p, f - K_x @ (endpoint.position(p) - x)), q)
    assert endpoint.joint_stiffness(q, K_x, f) == pytest.approx(-torque, abs=1e-6)


def test_the_inverse_of_the_endpoint_s_stiffness_is_its_compliance():
    rng = np.random.default_rng(3)
    q, f = rng.uniform(0.2, 1, (20, 3)), rng.uniform(-5, 5, (20, 2))
    root = rng.uniform(-1, 1, (20, 3, 3))
    K_q = 10 * np.eye(3) + 5 * root @ root.swapaxes(-1, -2)
    J = PLANAR.jacobian(q)
    held = K_q + np.einsum("ki,kiab->kab", f, PLANAR.hessian(q))
    compliance = J @ np.linalg.inv(held) @ J.swapaxes(-1, -2)
    assert PLANAR.stiffness(q, K_q, f) @ compliance == pytest.approx(np.broadcast_to(np.eye(2), (20, 2, 2)), abs=1e-12)
    two = Endpoint.planar([0.3, 0.3])
    K_x = np.array([[300.0, 80.0], [80.0, 200.0]])
    assert two.stiffness(q[:, :2], two.joint_stiffness(q[:, :2], K_x, f), f) == pytest.approx(
        np.broadcast_to(K_x, (20, 2, 2))
    )


def test_hidden_joints_that_fall_leave_no_endpoint_stiffness():
    q = [0.3, 0.4, 0.5]
    hidden = np.linalg.svd(PLANAR.jacobian(q))[2][-1]
    assert np.isnan(PLANAR.stiffness(q, np.eye(3) - 2 * np.outer(hidden, hidden))).all()
    assert np.isfinite(PLANAR.stiffness(q, np.eye(3) - 0.5 * np.outer(hidden, hidden))).all()


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Endpoint.planar([300, 300]), r"lengths\[0\] = 300 m is no link; if millimetres, divide by 1000"),
        (lambda: Endpoint.planar(0.3), r"lengths have the shape \(\); expected a row of n links"),
        (
            lambda: Endpoint.on_link(SPATIAL, 3, (0.1, 0.0)),
            "the point is on link 3; expected a whole number from -1 .* to 2",
        ),
        (lambda: Endpoint.on_link(SPATIAL, 1, 0.1), "the point is on link 1: position = 0.1 .* two or three"),
        (lambda: Endpoint.on_link(SPATIAL, 1, (0.1, 0), axes="xx"), "axes = 'xx' have to be different letters"),
        (lambda: Endpoint.from_function(2, lambda q: "far"), "'far', no CasADi expression"),
        (lambda: Endpoint.from_function(0, lambda q: q), "Endpoint.from_function: n = 0"),
        (lambda: PLANAR.position([0.1, 0.2]), r"q has the shape \(2,\); expected \(…, 3\) .* dim = 2 .* n = 3"),
        (lambda: PLANAR.position([10.0, 20.0, 30.0]), "if degrees were meant"),
        (lambda: PLANAR.torque([0.1] * 3, [1.0, 2.0, 3.0]), r"force has the shape \(3,\); expected \(…, 2\) \[N\]"),
        (lambda: PLANAR.joint_stiffness([0.1] * 3, np.eye(3)), r"K_x has the shape \(3, 3\); expected \(…, 2, 2\)"),
        (lambda: PLANAR.joint_stiffness([0.1] * 3, [[1.0, 2.0], [0.0, 1.0]]), "K_x is not symmetric"),
        (lambda: PLANAR.stiffness([0.0] * 3, np.eye(3)), r"Jacobian is singular at x = \(0.65, 0\) m"),
        (lambda: Endpoint.on_link(SPATIAL[:2], 1, (0.1, 0)).stiffness([0.1] * 2, np.eye(2)), "3 coordinates .* n = 2"),
    ],
)
def test_wrong_endpoints(make, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        make()


def test_a_model_without_such_a_body_lists_what_it_has(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    with pytest.raises(InvalidFile, match="no site or body called 'fist'; it has hand, world, upper, lower, palm"):
        Endpoint.from_mjcf(path, "fist")
