"""An arm whose muscles hold gas is predicted as MuJoCo's bodies with that gas move."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.joint.gas import Gas
from allocator.units import DEG
from mpc import Compensation
from mpc.arm.mjcf import to_mjcf
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.linearise import Predictor
from mpc.trials.motions.arm_trajectories import circle
from mpc.trials.simulation import in_motion, simulate

FILLED = Arm.machine("arm26")
PLAIN = replace(FILLED, gas=False)


def plant(**given):
    arm, text = PLAIN, to_mjcf(PLAIN.mechanism, PLAIN.bodies, timestep=0.0005)
    return MujocoPlant(text, arm.mechanism.muscles, lag=arm.lag, slew=arm.slew, gas=True, nominal=arm, **given)


def test_the_motion_is_that_of_mujoco_s_bodies_and_gas():
    tested, N, dt = plant(), 20, 0.01
    x = np.concatenate([[0.3, -0.2], [2.0, -3.0], np.linspace(2.5e5, 3.5e5, 6)])
    tested.reset(x[:2], x[4:], omega=x[2:4])
    u = np.tile(x[4:], (N, 1)) + 2e4 * np.sin(np.arange(N))[:, None]
    d = np.zeros((N, 2))
    predicted = {arm.gas is not None: Predictor(arm, dt, N).motion(x, u, d) for arm in (PLAIN, FILLED)}
    tested.supply.slew = np.inf
    for command in u:
        tested.step(command, dt)
    end = np.concatenate([tested.q, tested.omega, tested.P / 1e5])
    with_gas, without = (np.append(predicted[key].x[-1, :4], predicted[key].x[-1, 4:] / 1e5) for key in (True, False))
    assert np.abs(end - with_gas).max() < 2e-3
    assert np.abs(end - without).max() > 0.1


def test_the_derivatives_of_the_formula_are_differences():
    N, dt = 2, 0.01
    model = Predictor(FILLED, dt, N)
    x = np.concatenate([[0.3, -0.2], [2.0, -3.0], np.linspace(2.5e5, 3.5e5, 6)])
    u, d = np.tile(x[4:], (N, 1)), np.zeros((N, 2))
    slope = model.linearise(x, u, d).A[0]
    steps = np.append(np.full(4, 1e-5), np.full(6, 1.0))
    for i, step in enumerate(steps):
        away = step * np.eye(10)[i]
        ends = [model.motion(x + sign * away, u, d).x[1] for sign in (1, -1)]
        found = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(slope[:, i], found, rtol=1e-5, atol=1e-6 * abs(found).max())


@pytest.mark.slow
def test_a_controller_that_knows_the_gas_follows_more_closely():
    asked, errors = circle(PLAIN, frequency=1.0, turns=0.8), {}
    controllers = {"knows": TrackingMPC(FILLED), "does not": TrackingMPC(PLAIN, compiled=False)}
    assert controllers["knows"].implementation == "compiled"
    for name, controller in controllers.items():
        run = simulate(plant(), controller, asked, x0=in_motion(PLAIN, asked))
        errors[name] = np.sqrt(np.mean((run.theta - run.theta_ref)[30:] ** 2, axis=0)) / DEG
        assert set(run.rung) == {0}
    assert (errors["knows"] <= 0.05).all()
    assert (errors["knows"] <= errors["does not"] / 5).all()


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True], ids=["readable", "compiled"])
def test_the_first_command_is_within_the_slew_of_the_measured_pressures(compiled):
    """The motion during the dead time moves the pressures."""
    controller = TrackingMPC(FILLED, compensation=Compensation(dead_time=0.03), compiled=compiled)
    x = np.concatenate([[0.3, -0.2], [4.0, -5.0], np.linspace(2.5e5, 3.5e5, 6)])
    plan = controller.step(x, [-0.3, 0.3], np.diag([9.0, 8.0]))
    most = FILLED.slew * controller.dt
    assert np.abs(plan.u[0] - x[4:]).max() == pytest.approx(most, rel=1e-9)


def test_gas_that_there_is_not_is_one_sentence():
    with pytest.raises(InvalidInput, match="True or False"):
        replace(PLAIN, gas=1.3)
    assert FILLED.gas == FILLED.mechanism.gas
    assert replace(PLAIN, gas=Gas(kappa=1.4)).mechanism.gas.kappa == 1.4
    assert PLAIN.gas is replace(FILLED, gas=None).gas is None


def test_muscles_of_unknown_volume_hold_as_much_as_braids_that_pull_like_them():
    muscle = replace(FILLED.mechanism.muscles[0], inner_radius=None, rest_volume=None)
    mechanism = replace(FILLED.mechanism, muscles=(muscle,) * 6)
    filled = Arm(mechanism, FILLED.bodies)
    L = mechanism.routes.rest_length[0]
    assert 0.5 < filled.mechanism.muscles[0].volume_at_rest(L) / FILLED.mechanism.muscles[0].volume_at_rest(L) < 2
    assert Arm(mechanism, FILLED.bodies, gas=False).mechanism == mechanism
    assert "cm³" in filled.summary
    assert Arm(mechanism, FILLED.bodies, gas=False).summary.endswith("no gas")
