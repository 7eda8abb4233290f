"""Derivatives are differences; the condensed prediction is the linear model rolled out; the QP is the problem."""

import casadi as ca
import numpy as np
import pytest

from allocator import BAR
from mpc import Plant, Weights
from mpc.codegen.buffered import Buffered
from mpc.model.arm.model import Arm
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.qp.condense import TrackingProblem, condense, increments, sensitivity
from mpc.tracking.terminal import terminal_factor
from mpc.trials.margins import usual_postures

DT, N = 0.01, 6
X0 = np.array([0.23, 0.5, 2.5 * BAR, 3.0 * BAR])
SCALE = np.array([1.0, 1.0, BAR, BAR])


@pytest.fixture
def u():
    return BAR * np.random.default_rng(1).uniform(2, 4, (N, 2))


def linear_rollout(model, u):
    x = [model.x[0]]
    for k in range(len(u)):
        constant = model.x[k + 1] - model.A[k] @ model.x[k] - model.B[k] @ model.u[k]
        x.append(model.A[k] @ x[k] + model.B[k] @ u[k] + constant)
    return np.array(x)


def test_derivatives_equal_central_differences(joint, u):
    plant = Plant(joint=joint, gravity_torque=1.0)
    model = Predictor(plant, DT, N).linearise(X0, u, 0.3)
    step = Buffered(plant.discrete(DT))
    h = 1e-5
    for k in range(N):
        for j in range(4):
            move = h * SCALE[j] * np.eye(4)[j]
            ahead, back = (step(model.x[k] + s * move, u[k], 0.3)[0][0] for s in (1, -1))
            np.testing.assert_allclose(model.A[k][:, j] * SCALE[j], (ahead - back) / (2 * h), rtol=1e-6, atol=1e-6)
            dK = (plant.stiffness(model.x[k] + move) - plant.stiffness(model.x[k] - move)) / (2 * h)
            np.testing.assert_allclose(model.C[k, j] * SCALE[j], dK, rtol=1e-6, atol=1e-7)
            dF = np.subtract(plant.forces(model.x[k] + move), plant.forces(model.x[k] - move)) / (2 * h)
            np.testing.assert_allclose(model.D[k, :, j] * SCALE[j], dF, rtol=1e-6, atol=1e-5)
        for j in range(2):
            move = h * BAR * np.eye(2)[j]
            ahead, back = (step(model.x[k], u[k] + s * move, 0.3)[0][0] for s in (1, -1))
            np.testing.assert_allclose(model.B[k][:, j] * BAR, (ahead - back) / (2 * h), rtol=1e-6, atol=1e-6)


def test_a_motion_is_the_plant_stepped_and_its_linear_model_is_exact_on_it(u):
    plant = Plant()
    predictor = Predictor(plant, DT, N)
    model, motion = predictor.linearise(X0, u, 0.3), predictor.motion(X0, u, 0.3)
    x = X0
    step = Buffered(plant.discrete(DT))
    for k in range(N):
        x = step(x, u[k], 0.3)[0][0]
        np.testing.assert_allclose(motion.x[k + 1], x, rtol=1e-12)
    np.testing.assert_array_equal(model.x, motion.x)
    np.testing.assert_allclose(motion.K, plant.stiffness(motion.x.T), rtol=1e-12)
    np.testing.assert_allclose(motion.F.T, plant.forces(motion.x.T), rtol=1e-12)
    np.testing.assert_allclose(linear_rollout(model, u), model.x, rtol=1e-10)


def test_the_condensed_prediction_is_the_linear_model_rolled_out(u):
    model = Predictor(Plant(), DT, N).linearise(X0, u)
    E = increments([1] * N)
    z = np.random.default_rng(2).normal(size=E.shape[-1])
    condensed = model.x + sensitivity(model.A, model.B, E) @ z
    np.testing.assert_allclose(condensed, linear_rollout(model, u + E @ z), rtol=1e-9)


def test_each_increment_moves_all_later_commands_by_one_bar():
    E = increments([1] * 3)
    z = np.arange(1.0, 9.0)  # changes (1, 2), (3, 4), (5, 6), slacks 7 and 8
    np.testing.assert_allclose(E @ z, BAR * np.array([[1, 2], [4, 6], [9, 12]]))


def test_the_qp_s_cost_is_the_cost_in_the_controller_s_docstring(u):
    plant, weights = Plant(), Weights(theta=2e5, omega=300.0, K=70.0, u=1e-9, rate=1e-11, slack=50.0, slack_square=20.0)
    limits, L, E = Limits.of(plant, DT), terminal_factor(plant, DT, weights), increments([1] * N)
    feed = InverseDynamics(plant, DT, N)(0.2 + 0.05 * np.arange(N + 1) / N, np.full(N + 1, 7.6))
    model = Predictor(plant, DT, N).linearise(X0, u)
    u_last, u_star_last = u[0] - 1e3, feed.u[0] + 2e3
    qp = condense(TrackingProblem(weights, limits, L, (1,) * N, DT), model, feed, u_last, u_star_last)

    def cost(z):
        commands = u + E @ z
        x = linear_rollout(model, commands)
        K = model.K + np.sum(model.C * (x - model.x), axis=1)
        e = commands - feed.u
        rates = np.diff(np.vstack([u_last - u_star_last, e]), axis=0) / DT
        x_star = feed.x[-1]
        xi = np.array([*(x[-1] - x_star), *e[-1]])
        inner = (
            weights.theta * (x[1:N, 0] - feed.x[1:N, 0]) ** 2
            + weights.omega * (x[1:N, 1] - feed.x[1:N, 1]) ** 2
            + weights.K * (K[1:N] - feed.y[1:N, 0]) ** 2
        )
        s, s_F = z[-2:]
        squares = np.sum(inner) + weights.u * np.sum(e**2) + weights.rate * np.sum(rates**2) + np.sum((L @ xi) ** 2)
        price = weights.slack * s + weights.slack_square / 2 * s**2
        price += weights.slack_force * s_F + weights.slack_force_square / 2 * s_F**2
        return squares / 2 + price

    rng = np.random.default_rng(3)
    for z in rng.normal(size=(5, E.shape[-1])):
        assert qp.cost(z) == pytest.approx(cost(z) - cost(0 * z), rel=1e-8)


def test_the_qp_s_bounds_are_the_slew_limit_and_its_rows_supply_joint_range_and_forces(u):
    plant = Plant()
    limits, E = Limits.of(plant, DT, min_force=5.0), increments([1] * N)
    problem = TrackingProblem(Weights(), limits, terminal_factor(plant, DT, Weights()), (1,) * N, DT)
    u = u[0] + 0.5 * (limits.limited(u[0], u) - u[0])  # changes that are not yet at the limit
    model = Predictor(plant, DT, N).linearise(X0, u)
    feed = InverseDynamics(plant, DT, N)(np.full(N + 1, 0.2), np.full(N + 1, 7.6))
    qp = condense(problem, model, feed, u[0], feed.u[0])
    rng = np.random.default_rng(4)
    seen = set()
    for z in rng.normal(size=(400, E.shape[-1])) * rng.choice([1e-3, 0.03, 2.0], size=(400, 1)):
        z[-2:] = np.abs(z[-2:]) * [1, 3000]
        commands = u + E @ z
        dx = (sensitivity(model.A, model.B, E) @ z)[1:]
        theta = model.x[1:, 0] + dx[:, 0]
        F = model.F[1:] + np.einsum("kij,kj->ki", model.D[1:], dx)
        changes = np.abs(np.diff(commands, axis=0, prepend=u[:1]))
        kept = (
            (changes <= limits.step).all()
            and (commands >= limits.pressure[0]).all()
            and (commands <= limits.pressure[1]).all()
            and (theta <= limits.theta[1] + z[-2]).all()
            and (theta >= limits.theta[0] - z[-2]).all()
            and (F >= 5.0 - z[-1]).all()
        )
        assert (qp.violation(z) == 0) == kept
        seen.add(bool(kept))
    assert seen == {True, False}


def test_the_terminal_cost_is_the_cost_of_the_unlimited_future(joint):
    """S is a fixed point: the best first step and then S cost S again; by least squares, not by Riccati's formula."""
    plant, w = Plant(joint=joint), Weights()
    L = terminal_factor(plant, DT, w)
    P = np.full(2, np.mean(joint.pressure_limits))
    middle = np.array([np.mean(joint.angle_range), 0.0, *P])
    model = Predictor(plant, DT, 1).linearise(middle, P[None], plant.balance(middle))
    np.testing.assert_allclose(model.x[1], middle, rtol=1e-9, atol=1e-12)  # a rest
    rng = np.random.default_rng(5)
    for xi in rng.normal(size=(3, 6)) * [0.01, 0.1, 1e4, 1e4, 1e4, 1e4]:
        x, before = xi[:4], xi[4:]
        now = w.theta * x[0] ** 2 + w.omega * x[1] ** 2 + w.K * (model.C[0] @ x) ** 2
        # least squares in e: rows of sqrt(w_u) e, sqrt(w_t) (e - before)/dt, L (A x + B e, e)
        rows = np.vstack(
            [np.eye(2) * w.u**0.5, np.eye(2) * w.terminal_rate**0.5 / DT, L[:, :4] @ model.B[0] + L[:, 4:]]
        )
        right = np.concatenate([np.zeros(2), before * w.terminal_rate**0.5 / DT, -L[:, :4] @ model.A[0] @ x])
        e = np.linalg.lstsq(rows * BAR, right, rcond=None)[0] * BAR
        assert now + np.sum((rows @ e - right) ** 2) == pytest.approx(np.sum((L @ xi) ** 2), rel=1e-6)


def test_feed_forward_commands_drive_the_lagged_pressures_through_the_allocation():
    plant = Plant(lag=(0.05, 0.2), gas=False)
    t = DT * np.arange(N + 1)
    feed = InverseDynamics(plant, DT, N)(0.3 * np.sin(3 * t), 7.6 + 0.2 * t)
    P = feed.x[0, 2:]
    for k in range(N):
        P = feed.u[k] + (P - feed.u[k]) * np.exp(-DT / np.array(plant.lags))
        np.testing.assert_allclose(P, feed.x[k + 1, 2:], rtol=1e-10)
    x = feed.x.T
    accelerations = [plant.rate(x[:, k], feed.x[k, 2:])[1] for k in range(N + 1)]
    np.testing.assert_allclose(accelerations, -0.3 * 9 * np.sin(3 * t), atol=2e-2)
    np.testing.assert_allclose(plant.stiffness(x), 7.6 + 0.2 * t, rtol=1e-9)


def test_what_cannot_be_reached_is_brought_to_the_nearest_that_can():
    plant = Plant()
    feed = InverseDynamics(plant, DT, N)(np.full(N + 1, 2.5), np.full(N + 1, 12.0))
    assert feed.x[:, 0] == pytest.approx(plant.joint.angle_range[1])
    assert (feed.x[:, 2:] <= plant.joint.pressure_limits[1]).all()
    assert (feed.y[:, 0] < 12).all()
    x = feed.x.T
    np.testing.assert_allclose(plant.torque(x), 0.0, atol=1e-9)  # torque comes first


def test_buffers_refuse_sparse_functions():
    x = ca.SX.sym("x", 2)
    with pytest.raises(ValueError, match="sparse"):
        Buffered(ca.Function("f", [x], [ca.diag(x)]))


@pytest.mark.parametrize("plant", [Plant(), Arm.machine("arm26")], ids=["joint", "arm"])
def test_a_constant_preview_has_the_feed_forward_of_one_that_hardly_changes(plant):
    inverse = InverseDynamics(plant, DT, N)
    theta, K = usual_postures(plant)[2]
    theta, K, d = (np.repeat(np.asarray(a)[None], N + 1, axis=0) for a in (theta, K, 0.1 * np.ones(plant.angle_shape)))
    once = inverse(theta, K, d)
    d[-1] += 1e-9  # [N·m]
    each = inverse(theta, K, d)
    np.testing.assert_allclose(once.x, each.x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(once.y, each.y, rtol=1e-6)
    np.testing.assert_allclose(once.u, each.u, rtol=1e-6)
    np.testing.assert_allclose(once.moved, each.moved, atol=1e-8)
