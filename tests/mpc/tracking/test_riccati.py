"""Riccati equations whose solution is singular, and factors of semidefinite matrices."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from allocator import BAR, InvalidInput, report_joint
from allocator.muscles import PolynomialMcKibben
from mpc import Plant, Weights
from mpc.tracking.cost import diagonal
from mpc.tracking.terminal import middle, regulator, semidefinite_factor, solve_riccati, terminal_factor
from mpc.yardsticks.baselines import LQRControl

# fitted to measured forces; its stiffness does not depend on the pressure: B. Tondu, arXiv 2104.13167, (13) and (14)
FITTED = PolynomialMcKibben(
    0.009754012444384256, 0.448526590071032, (20028076.53180563, -68061407.99044406, 263112850.18461978)
)
EITHER = {"report": Plant(), "no pressure changes K": Plant(replace(report_joint(), agonist=FITTED, antagonist=FITTED))}


def either(seed):
    """The default weights, each changed by up to a factor of 100 either way."""
    default = Weights()
    names = ("theta", "omega", "K", "u", "rate", "terminal_rate")
    factors = 10.0 ** np.random.default_rng(seed).uniform(-2, 2, len(names))
    return replace(default, **{n: getattr(default, n) * f for n, f in zip(names, factors, strict=True)})


@pytest.mark.parametrize("rounding", [-1e-16, 0.0, 1e-16])
@pytest.mark.parametrize("rank", [0, 1, 3, 6])
def test_a_semidefinite_matrix_has_a_factor_whatever_the_sign_of_its_least_eigenvalue(rank, rounding):
    rng = np.random.default_rng(rank)
    rows = rng.normal(size=(rank, 6)) * 10.0 ** rng.uniform(-3, 3, 6)
    S = rows.T @ rows
    S = S + rounding * np.diag(S).max() * np.eye(6)
    L = semidefinite_factor(S)
    assert (np.diag(L) >= 0).all()
    np.testing.assert_array_equal(np.tril(L, -1), 0)
    np.testing.assert_allclose(L.T @ L, S, atol=1e-14 * np.abs(S).max(initial=0.0))


def test_a_definite_matrix_has_its_cholesky_factor():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(6, 6))
    S = A @ A.T
    np.testing.assert_allclose(semidefinite_factor(S), np.linalg.cholesky(S).T, rtol=1e-10, atol=1e-12)


def test_pressures_that_change_neither_torque_nor_stiffness_cost_nothing_beyond_the_horizon():
    L = terminal_factor(EITHER["no pressure changes K"], 0.01, Weights())
    alike, apart = np.array([0, 0, 1, 1, 0, 0]) * BAR, np.array([0, 0, 1, -1, 0, 0]) * BAR
    assert np.linalg.norm(L @ alike) < 1e-6 * np.linalg.norm(L @ apart)


@pytest.mark.parametrize("plant", EITHER.values(), ids=EITHER.keys())
@pytest.mark.parametrize("dt", [0.001, 0.01, 0.05])
def test_the_solution_satisfies_its_equation(plant, dt):
    for seed in range(20):
        weights = either(seed)
        A, B, Q, R, N = given = regulator(middle(plant, dt), dt, diagonal(weights), weights.terminal_rate)
        S = solve_riccati(*given)
        across = B.T @ S @ A + N.T
        again = A.T @ S @ A + Q - across.T @ np.linalg.solve(R + B.T @ S @ B, across)
        np.testing.assert_allclose(again, S, rtol=0, atol=1e-10 * np.abs(S).max())


def test_no_command_makes_a_riccati_cost_smaller_than_the_optimal_one():
    A, B, Q, R, N = given = regulator(middle(Plant(), 0.01), 0.01, diagonal(Weights()), Weights().terminal_rate)
    S, xi = solve_riccati(*given), np.array([0.01, 0.1, 0.2, -0.1, 0.1, 0.0])
    best = -np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A + N.T) @ xi

    def cost(u):
        after = A @ xi + B @ u
        return xi @ Q @ xi + 2 * xi @ N @ u + u @ R @ u + after @ S @ after

    assert cost(best) == pytest.approx(xi @ S @ xi, rel=1e-9)
    for away in np.random.default_rng(0).normal(size=(20, 2)):
        assert cost(best + 0.1 * away) > cost(best)


@pytest.mark.parametrize("growth", [1.1, 1.0, -1.0, np.nan])
def test_a_motion_that_does_not_fade_and_that_no_input_reaches_is_refused(growth):
    A, B = block_diag(0.5, growth), np.array([[1.0], [0.0]])
    with pytest.raises(InvalidInput, match="no solution"):
        solve_riccati(A, B, np.eye(2), np.eye(1), np.zeros((2, 1)))


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_that_stays_but_costs_nothing_is_no_obstacle(seed):
    T = np.random.default_rng(seed).normal(size=(3, 3))
    one = np.linalg.inv(T)
    A, B = T @ block_diag(0.5, 1.0, 0.9) @ one, T @ np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    C = np.array([[1.0, 0.0, 2.0]]) @ one
    S = solve_riccati(A, B, C.T @ C, np.eye(2), np.zeros((3, 2)))
    assert np.abs(S @ T[:, 1]).max() < 1e-6 * np.abs(S).max()


def test_the_regulator_of_such_a_joint_moves_it():
    plant = EITHER["no pressure changes K"]
    x = np.array([0.0, 0.0, 2.5e5, 2.5e5])
    u = LQRControl(plant).step(x, 0.1, float(plant.joint.stiffness(0.0, *x[2:]))).u[0]
    assert u[0] > u[1]  # the agonist pulls towards a greater angle
