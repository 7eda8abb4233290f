"""The bodies of an arm are held against MuJoCo's, and against what a chain's energies say."""

import mujoco
import numpy as np
import pytest

from allocator import InvalidInput
from allocator.mechanism.bodies import BODIES, Bodies

CROOKED = Bodies(
    (0.3, 0.25, 0.2), (1.0, 0.7, 0.4), (0.1, 0.2, 0.05), (0.01, 0.004, 0.002), (0.1, 0.2, 0.3), gravity=(3.0, -9.0)
)
CHAINS = {"arm26": BODIES["arm26"](), "arm48": BODIES["arm48"](), "crooked": CROOKED}


def in_mujoco(bodies):
    """Return MuJoCo's model of the same chain."""
    open_, close = "", ""
    for i in range(bodies.n):
        at = bodies.length[i - 1] if i else 0.0
        I = bodies.inertia[i]  # noqa: E741
        open_ += (
            f'<body pos="{at!r} 0 0"><joint axis="0 0 1" damping="{bodies.damping[i]!r}"/>'
            f'<inertial pos="{bodies.centre[i]!r} 0 0" mass="{bodies.mass[i]!r}" diaginertia="{I!r} {I!r} {I!r}"/>'
        )
        close += "</body>"
    x, y = bodies.gravity
    text = f'<mujoco><option gravity="{x} {y} 0"/><worldbody>{open_}{close}</worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(text)


@pytest.mark.parametrize("bodies", CHAINS.values(), ids=CHAINS)
def test_masses_and_forces_are_those_of_mujoco(bodies):
    model = in_mujoco(bodies)
    data, rng = mujoco.MjData(model), np.random.default_rng(7)
    for _ in range(20):
        q, omega, alpha = rng.uniform(-3, 3, bodies.n), rng.normal(0, 4, bodies.n), rng.normal(0, 20, bodies.n)
        data.qpos[:], data.qvel[:], data.qacc[:] = q, omega, alpha
        mujoco.mj_forward(model, data)
        M = np.zeros((bodies.n, bodies.n))
        mujoco.mj_fullM(model, data, M)
        np.testing.assert_allclose(bodies.mass_matrix(q), M, rtol=0, atol=1e-12)
        data.qacc[:] = alpha
        mujoco.mj_inverse(model, data)
        torque = bodies.torque_for(q, omega, alpha)
        np.testing.assert_allclose(torque, data.qfrc_inverse, rtol=0, atol=1e-10)


@pytest.mark.parametrize("bodies", CHAINS.values(), ids=CHAINS)
def test_symbols_and_stacks_of_postures_give_the_same_numbers(bodies):
    import casadi as ca

    rng = np.random.default_rng(8)
    q, omega, alpha = rng.normal(size=(3, 4, bodies.n))
    s = [ca.SX.sym(name, bodies.n) for name in ("q", "omega", "alpha")]
    symbolic = ca.Function("f", s, [bodies.mass_matrix(s[0]), bodies.torque_for(*s), bodies.points(s[0])])
    together = bodies.mass_matrix(q), bodies.torque_for(q, omega, alpha), bodies.points(q)
    for k in range(4):
        for whole, one in zip(together, symbolic(q[k], omega[k], alpha[k]), strict=True):
            np.testing.assert_allclose(whole[k], np.squeeze(one.full()), rtol=0, atol=1e-12)


def test_gravity_is_the_slope_of_a_potential_and_its_stiffness_the_slope_of_that():
    q, h = np.array([0.4, -1.1, 0.7]), 1e-6
    slope = [(CROOKED.gravity_torque(q + h * e) - CROOKED.gravity_torque(q - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(CROOKED.gravity_stiffness(q), slope, atol=1e-7)


def test_no_energy_comes_from_the_centrifugal_torques():
    rng = np.random.default_rng(9)
    q, omega, h = rng.normal(size=3), rng.normal(size=3), 1e-6
    M_dot = (CROOKED.mass_matrix(q + h * omega) - CROOKED.mass_matrix(q - h * omega)) / (2 * h)
    assert omega @ CROOKED.coriolis(q, omega) == pytest.approx(0.5 * omega @ M_dot @ omega, abs=1e-7)


def test_the_endpoint_is_where_trigonometry_puts_it():
    bodies = BODIES["arm26"]()
    points = bodies.points(np.array([np.pi / 2, -np.pi / 2]))
    np.testing.assert_allclose(points, [[0, 0], [0, 0.31], [0.34, 0.31]], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mass": (1.0, -1.0)}, r"mass\[1\] = -1 kg has to be positive"),
        ({"length": (310.0, 340.0)}, "at most 10"),
        ({"inertia": (0.1, 0.1, 0.1)}, "as many as the others"),
        ({"gravity": 9.81}, r"\(x, y\)"),
        ({"damping": (float("nan"), 0.1)}, "damping"),
    ],
)
def test_what_no_link_can_have_is_refused(change, said):
    good = {"length": (0.3, 0.3), "mass": 1.0, "centre": 0.15, "inertia": 0.01, "damping": 0.1}
    with pytest.raises(InvalidInput, match=said):
        Bodies(**(good | change))


def test_a_joint_of_the_other_sense_turns_the_other_way():
    """In mirrored angles it is the same chain; MuJoCo agrees in tests/mpc/arm/test_mjcf.py."""
    from dataclasses import replace

    turned, s = replace(CROOKED, sense=(1, -1, 1)), np.array([1, -1, 1])
    q, omega, alpha = np.random.default_rng(9).normal(size=(3, 4, 3))
    np.testing.assert_allclose(turned.points(q), CROOKED.points(s * q), atol=1e-15)
    np.testing.assert_allclose(
        turned.torque_for(q, omega, alpha), s * CROOKED.torque_for(s * q, s * omega, s * alpha), atol=1e-13
    )
    expected = s[:, None] * CROOKED.gravity_stiffness(s * q) * s
    np.testing.assert_allclose(turned.gravity_stiffness(q), expected, atol=1e-13)
    with pytest.raises(InvalidInput, match="sense"):
        replace(CROOKED, sense=(1, 2, 1))
    with pytest.raises(InvalidInput, match="sense"):
        replace(CROOKED, sense=(1, 1))


def test_gravity_that_is_one_number_is_refused_with_what_is_expected():
    with pytest.raises(InvalidInput, match=r"gravity = 0.0 has to be \(x, y\) in the plane"):
        Bodies.rods((0.3,), (1.0,), 0.1, gravity=0.0)
