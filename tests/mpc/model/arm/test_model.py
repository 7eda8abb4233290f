"""An arm's formulas are held against the mechanism's numbers, and its derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.errors import MissingBackend
from allocator.joint.geometry import Lever
from allocator.mechanism import Link, Mechanism, Sites, Tables, from_function
from allocator.mechanism.bodies import Bodies
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc.model.arm.model import Arm
from mpc.tracking.linearise import Predictor

RODS = Bodies.rods((0.3, 0.25), (1.0, 0.5), 0.2, (1.0, -9.0))


def crossing():
    """Return a mechanism of straight muscles, with a cable and bends, in the plane of two hinges."""
    links = [Link(-1), Link(0, (0.3, 0.0))]
    sides = [((-0.1, 0.06), (0.08, 0.05)), ((-0.1, -0.06), (0.08, -0.05))]
    paths = [[(-1, a), (0, b)] for a, b in sides]
    paths += [[(0, (0.1, 0.05)), (1, (0.07, 0.04))], [(0, (0.1, -0.05)), (1, (0.07, -0.04))]]
    paths += [[(-1, (-0.1, 0.07)), (0, (0.1, 0.06)), (1, (0.06, 0.05))]]
    routes = Sites((0.2, 0.2, 0.28, 0.28, 0.5), links, paths, 0.0)
    length = routes.at(np.zeros(2)).length
    routes = Sites((length / 0.86).tolist(), links, paths, 0.0)
    return Mechanism(routes, SAROSI_DMSP_20_400N, angle_limits=((-0.5, 0.5), (-0.5, 0.5)))


def warped():
    routes = from_function(
        0.4,
        2,
        lambda q: [
            0.35 - 0.02 * q[0] + 0.004 * q[0] ** 2 * q[1],
            0.35 + 0.03 * q[1] ** 2 - 0.02 * q[1],
            0.34 + 0.02 * q[0],
        ],
    )
    return Mechanism(routes, SAROSI_DMSP_20_400N)


ARMS = {
    "arm26": Arm.machine("arm26"),
    "arm48": Arm.machine("arm48"),
    "sites": Arm(crossing(), RODS),
    "function": Arm(warped(), RODS, lag=(0.05, 0.1, 0.2)),
}


def states(arm, count=5, seed=3):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.3, 0.3, (count, arm.n))
    return np.hstack([q, rng.normal(0, 2, (count, arm.n)), rng.uniform(1e5, 4e5, (count, arm.m))])


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_formulas_give_the_mechanism_s_numbers(arm):
    import casadi as ca

    s = arm.statics
    f = ca.Function("f", [s.q, s.P], [s.torque, s.stiffness, s.forces])
    for x in states(arm):
        q, P = x[: arm.n], x[2 * arm.n :]
        torque, K, F = (np.squeeze(value.full()) for value in f(q, P))
        np.testing.assert_allclose(torque, arm.mechanism.torque(q, P), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(K, arm.mechanism.stiffness(q, P), rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(F, arm.mechanism.forces(q, P), rtol=1e-12)


def test_a_joint_s_geometry_is_a_formula_too():
    from allocator import AntagonistJoint

    joint = AntagonistJoint(Lever(0.4, 0.35, 0.05), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    arm = Arm(Mechanism.from_joint(joint), Bodies.rods((0.3,), (1.0,), 0.1))
    test_formulas_give_the_mechanism_s_numbers(arm)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_the_linear_model_is_the_motion_s_derivative(arm):
    N, h = 3, 1e-5
    predictor = Predictor(arm, 0.01, N)
    x, rng = states(arm, 1)[0], np.random.default_rng(4)
    u, d = rng.uniform(1e5, 4e5, (N, arm.m)), rng.normal(size=(N, arm.n))
    model = predictor.linearise(x, u, d)
    np.testing.assert_allclose(predictor.motion(x, u, d).x, model.x, rtol=1e-12, atol=1e-12)
    scale = np.concatenate([np.ones(2 * arm.n), np.full(arm.m, 1e5)])
    for i in range(arm.size):
        e = h * scale * np.eye(arm.size)[i]
        up, down = predictor.motion(x + e, u, d), predictor.motion(x - e, u, d)
        slope = (up.x[1] - down.x[1]) / (2 * h * scale[i])
        np.testing.assert_allclose(model.A[0][:, i] / scale * scale[i], slope / scale * scale[i], atol=1e-6)
        for found, ups, downs in ((model.C, up.K, down.K), (model.D, up.F, down.F)):
            np.testing.assert_allclose(found[0][:, i] * scale[i], (ups[0] - downs[0]) / (2 * h), atol=1e-4)
    e = np.zeros_like(u)
    e[0, 1] = h * 1e5
    slope = (predictor.motion(x, u + e, d).x[1] - predictor.motion(x, u - e, d).x[1]) / (2 * h)
    np.testing.assert_allclose(model.B[0][:, 1] * 1e5 / scale, slope / scale, atol=1e-7)


def test_the_motion_of_a_sample_is_scipy_s():
    from scipy.integrate import solve_ivp

    arm = replace(ARMS["sites"], gas=False)
    mechanism, bodies = arm.mechanism, arm.bodies
    x, u, d = states(arm, 1)[0], np.full(arm.m, 3e5), np.array([0.5, -0.3])

    def rate(t, x):
        q, omega, P = x[:2], x[2:4], x[4:]
        pushing = mechanism.torque(q, P) - bodies.bias(q, omega) + d
        return np.concatenate([omega, np.linalg.solve(bodies.mass_matrix(q), pushing), (u - P) / arm.lags])

    exact = solve_ivp(rate, (0, 0.01), x, rtol=1e-11, atol=1e-12).y[:, -1]
    found = Predictor(arm, 0.01, 1).motion(x, u[None], d[None]).x[1]
    np.testing.assert_allclose(found[:4], exact[:4], rtol=2e-4)
    np.testing.assert_allclose(found[4:], exact[4:], rtol=1e-9)
    fine = arm.discrete(0.01, resolution=0.02)(x, u, d).full().ravel()
    np.testing.assert_allclose(fine[:4], exact[:4], atol=1e-9)


def test_a_run_s_stiffness_and_forces_are_the_mechanism_s_even_of_an_arm_that_turned_over():
    arm, gains = Arm.machine("arm26"), np.array([1.1, 0.9, 1.0, 1.2, 0.8, 1.0])
    x = np.concatenate([[0.3, 0.7], np.zeros(2), np.linspace(1e5, 4e5, 6)])
    K, F = arm.along(np.stack([x, x + np.array([2 * np.pi, *np.zeros(9)])]), gains)
    np.testing.assert_allclose(F[0], gains * arm.mechanism.forces(x[:2], x[4:]), rtol=1e-12)
    muscles = zip(gains, arm.mechanism.at(x[:2]), x[4:], strict=True)
    by_each = [gain * muscle.stiffness(P) for gain, muscle, P in muscles]
    np.testing.assert_allclose(K[0], sum(by_each), rtol=1e-12)
    assert np.isfinite(K[1]).all()
    assert np.isfinite(F[1]).all()


def test_svec_has_the_length_of_the_matrix():
    K = np.random.default_rng(1).normal(size=(5, 4, 4))
    K = K + K.swapaxes(1, 2)
    arm = ARMS["arm48"]
    np.testing.assert_allclose(np.linalg.norm(arm.svec(K), axis=-1), np.linalg.norm(K, axis=(1, 2)))
    np.testing.assert_allclose(arm.matrix(arm.svec(K)), K)


def test_what_is_no_arm_is_refused():
    two = ARMS["arm26"]
    with pytest.raises(InvalidInput, match="bodies of 1 links for a mechanism with n = 2"):
        Arm(two.mechanism, Bodies.rods((0.3,), (1.0,), 0.1))
    with pytest.raises(InvalidInput, match="multiply by 1e5"):
        Arm(two.mechanism, two.bodies, slew=5.0)
    with pytest.raises(InvalidInput, match="lag"):
        Arm(two.mechanism, two.bodies, lag=(0.1, 0.1))
    with pytest.raises(MissingBackend, match="arm26"):
        Arm.machine("leg38")
    grid = np.linspace(-0.5, 0.5, 5)
    lengths = 0.34 + 0.02 * np.stack([grid, -grid], axis=1)
    tables = Tables(0.4, (tuple(grid),), lengths)
    with pytest.raises(InvalidInput, match="Tables: an arm's model needs lengths that are formulas"):
        Arm(Mechanism(tables, SAROSI_DMSP_20_400N), Bodies.rods((0.3,), (1.0,), 0.1)).statics  # noqa: B018


@pytest.mark.parametrize(
    "changed", [{"origin": (0.2, 0.0)}, {"zero": 0.4}, {"axis": (0.0, 1.0, 0.0)}, {"kind": "slide"}]
)
def test_sites_on_another_chain_than_the_bodies_are_refused(changed):
    """Torques of the muscles and of gravity, and the hand, would be those of two different arms."""
    mechanism = crossing()
    first, second = mechanism.routes.links
    routes = replace(mechanism.routes, links=(first, replace(second, **changed)))
    with pytest.raises(InvalidInput, match=r"link 1 of the routes .* expected parent = 0, origin = \(0.3, 0.0, 0.0\)"):
        Arm(replace(mechanism, routes=routes), RODS)
    lifted = replace(second, origin=(0.3, 0.0, 0.05))
    assert Arm(replace(mechanism, routes=replace(routes, links=(first, lifted))), RODS).n == 2


@pytest.mark.parametrize("mechanism", [crossing(), warped()], ids=["sites", "functions"])
def test_a_run_with_a_silent_encoder_has_outputs(mechanism):
    """A record of a loop holds NaN where there is neither a reading nor an estimate; its errors are still wanted."""
    arm = Arm(mechanism, RODS)
    x = np.tile(np.concatenate([[0.1, -0.2, 0.0, 0.0], np.full(arm.m, 2e5)]), (3, 1))
    x[1, 1] = np.nan
    K, F = arm.along(x)
    np.testing.assert_array_equal(K[[0, 2]], arm.stiffness(x[[0, 2]]))
    np.testing.assert_array_equal(F[[0, 2]], arm.forces(x[[0, 2]]))
    assert np.isnan(K[1]).all()
    assert np.isnan(F[1]).all()
