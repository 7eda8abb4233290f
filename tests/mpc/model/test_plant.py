"""The plant: its equations, its integration, its place among other tools."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import BAR, DEG, InvalidInput, allocate
from allocator.errors import InvalidFile
from mpc import Plant
from mpc.codegen.buffered import Buffered
from mpc.model.storage import save_plant

X0 = np.array([0.3, -1.0, 2.5 * BAR, 3.5 * BAR])
U = np.array([3.0 * BAR, 2.0 * BAR])


def integrated(plant, x, u, d, seconds):
    """By SciPy, to rounding."""
    found = solve_ivp(
        lambda t, x: plant.rate(x, u, d), (0, seconds), x, method="DOP853", rtol=1e-12, atol=[1e-12, 1e-12, 1e-6, 1e-6]
    )
    return found.y[:, -1]


def test_symbols_and_numbers_give_the_same_rates(joint):
    plant = Plant(joint=joint, lag=(0.1, 0.2), gravity_torque=1.5, hanging_angle=-0.2)
    x, u, d = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("d")
    symbolic = ca.Function("f", [x, u, d], [ca.vertcat(*plant.rate(x, u, d))])(X0, U, 0.4)
    np.testing.assert_allclose(symbolic.full()[:, 0], plant.rate(X0, U, 0.4), rtol=1e-12)


def test_at_rest_nothing_moves_and_the_stiffness_is_the_one_asked():
    plant = Plant(gravity_torque=2.0)
    x = plant.at_rest(25 * DEG, 7.6)
    _, acceleration, *drift = plant.rate(x, x[2:])
    assert abs(acceleration) < 1e-9
    assert drift == [0, 0]
    assert plant.stiffness(x) == pytest.approx(7.6, rel=1e-9)


def test_without_input_and_friction_the_energy_of_the_swinging_link_is_kept():
    """At constant equal pressures the muscles are a spring: K θ²/2 is their energy on a pulley with Tondu's law."""
    plant = Plant(damping=0.0, gravity_torque=3.0, gas=False)
    P = np.full(2, 3.0 * BAR)
    x0 = np.array([0.5, 0.0, *P])
    x = integrated(plant, x0, P, 0.0, 0.7)

    def energy(x):
        return plant.inertia * x[1] ** 2 / 2 + plant.stiffness(x) * x[0] ** 2 / 2 - 3.0 * np.cos(x[0])

    assert energy(x) == pytest.approx(energy(x0), rel=1e-9)
    assert abs(x[0] - x0[0]) > 0.1


@pytest.mark.parametrize(("resolution", "tolerance"), [(0.5, 5e-4), (0.02, 2e-9)])
def test_the_discrete_plant_agrees_with_scipy(resolution, tolerance):
    plant = Plant(lag=(0.05, 0.1), gravity_torque=1.0)
    x = Buffered(plant.discrete(0.02, resolution))(X0, U, 0.5)[0][0]
    exact = integrated(plant, X0, U, 0.5, 0.02)
    np.testing.assert_allclose(x - X0, exact - X0, rtol=tolerance)


def test_the_integration_is_of_fourth_order():
    plant = Plant()
    exact = integrated(plant, X0, U, 0.0, 0.4)
    error = [np.abs((Buffered(plant.discrete(0.4, 14.5 * 0.4 / n))(X0, U, 0.0)[0][0] - exact)[0]) for n in (8, 16)]
    assert 12 < error[0] / error[1] < 22


def test_the_torque_for_a_motion_moves_the_link_that_way():
    plant = Plant(gravity_torque=1.0)
    theta, omega, alpha, d = 0.4, 1.0, -5.0, 0.3
    T = plant.torque_for(theta, omega, alpha, d)
    a = allocate(theta, 7.6, T, joint=plant.joint)
    assert plant.rate((theta, omega, a.P1, a.P2), (a.P1, a.P2), d)[1] == pytest.approx(alpha, rel=1e-9)


def test_the_integration_step_follows_the_fastest_part_of_the_plant():
    slow, fast = Plant(), Plant(inertia=0.0005, lag=0.005)
    assert fast.fastest_rate > 5 * slow.fastest_rate
    x = Buffered(fast.discrete(0.02))(X0, U, 0.0)[0][0]
    np.testing.assert_allclose(x, integrated(fast, X0, U, 0.0, 0.02), rtol=1e-2, atol=1e-2)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"inertia": 450.0}, "inertia = 450 kg·m² is over 100; if kg·cm² was meant, divide by 10000"),
        ({"inertia": 0.0}, "inertia = 0.0 has to be one number above 0"),
        ({"damping": -1.0}, "damping = -1.0 has to be one number that is not negative"),
        ({"lag": 0.0}, "lag = 0.0 has to be one number above 0"),
        ({"lag": (0.1, 0.1, 0.1)}, "pair"),
        ({"lag": "slow"}, "'slow' is not a number"),
        ({"slew": 5.0}, "if bar/s was meant"),
        ({"gravity_torque": float("nan")}, "gravity_torque = nan"),
        ({"gravity_torque": 1.0, "hanging_angle": 90.0}, "hanging_angle = 90 rad is over a turn"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(wrong, said):
    with pytest.raises(InvalidInput, match=said.replace("(", r"\(")):
        Plant(**wrong)


def test_a_plant_of_a_file_takes_the_slew_of_other_regulators(tmp_path):
    """No fit finds how fast regulators may be driven: `--slew` on the command line, `slew` here."""
    path = tmp_path / "plant.toml"
    Plant(slew=4 * BAR).save(path)
    assert Plant.load(path).slew == 4 * BAR
    assert Plant.load(path, slew=7 * BAR) == Plant(slew=7 * BAR)
    with pytest.raises(InvalidInput, match="if bar/s was meant"):
        Plant.load(path, slew=7.0)


def test_a_lag_in_milliseconds_is_refused(tmp_path):
    path = tmp_path / "plant.toml"
    save_plant(path, Plant().joint, {"lag": (60.0, 80.0)})
    with pytest.raises(InvalidFile, match="lag = 60 s is none of a regulator; if milliseconds were meant"):
        Plant.load(path)
