"""python-control runs the same loops as `simulate`, to 1e-6."""

import control
import numpy as np
import pytest

from allocator import DEG, InvalidInput
from mpc import KalmanObserver, NonlinearMPC, Plant, RealPlant, TrackingMPC, simulate, sine
from mpc.model.faults import Leak
from mpc.trials import at_rest, closed_loop, sampled_controller, sampled_plant, sampled_real_plant
from mpc.yardsticks.baselines import FeedForwardControl, LQRControl, PIDControl

DT = 0.01
PLANT = Plant()
MOVE = sine(amplitude=30 * DEG, duration=0.3, ramp=0.15, frequency=3.0)
REAL = RealPlant.standard(torque_profile=((0.1, 0.5),))
REAL_MOVE = sine(amplitude=30 * DEG, K=5.5, duration=0.3, ramp=0.15, frequency=3.0)
CONTROLLERS = {
    "mpc": TrackingMPC,
    "nmpc": NonlinearMPC,
    "pid": PIDControl,
    "lqr": LQRControl,
    "feedforward": FeedForwardControl,
}


def responded(plant, controller, reference, d=0.0, **options):
    """States, commands and the response."""
    loop = closed_loop(plant, controller, reference, **options)
    T = DT * np.arange(round(reference.t[-1] / DT) + 1)
    answer = control.input_output_response(loop, T, np.full(T.shape, d), at_rest(plant, DT, reference))
    commands = answer.outputs[[loop.find_output("P1_command"), loop.find_output("P2_command")]]
    return answer.states.T, commands.T[:-1], loop


@pytest.mark.slow
@pytest.mark.parametrize("build", CONTROLLERS.values(), ids=CONTROLLERS)
def test_python_control_runs_the_nominal_loop_as_simulate_does(build):
    run = simulate(PLANT, build(PLANT), MOVE)
    x, u, _ = responded(PLANT, build(PLANT), MOVE)
    np.testing.assert_allclose(u, run.u, rtol=1e-6)
    np.testing.assert_allclose(x, run.x, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("build", [TrackingMPC, PIDControl], ids=["mpc", "pid"])
def test_python_control_runs_the_real_loop_as_simulate_does(build):
    """With dead time, noise of the same seed, friction and the observer's memory."""
    known, model = REAL.known(), REAL.nominal

    def observer():
        return KalmanObserver(model, DT, compensation=known)

    run = simulate(REAL, build(model, compensation=known), REAL_MOVE, observer=observer(), seed=3)
    x, u, _ = responded(REAL, build(model, compensation=known), REAL_MOVE, observer=observer(), seed=3)
    np.testing.assert_allclose(u, run.u, rtol=1e-6)
    np.testing.assert_allclose(x[:, :4], run.x, rtol=1e-6, atol=1e-9)
    other, *_ = responded(REAL, build(model, compensation=known), REAL_MOVE, observer=observer(), seed=4)
    assert np.abs(other - x).max() > 1.0  # [Pa]; the seed matters


@pytest.mark.compiles
def test_a_loop_can_be_run_again_and_leaves_the_controller_as_it_was():
    controller = TrackingMPC(PLANT)
    first, _, loop = responded(PLANT, controller, MOVE)
    T = DT * np.arange(len(first))
    again = control.input_output_response(loop, T, 0 * T, at_rest(PLANT, DT, MOVE))
    np.testing.assert_array_equal(again.states.T, first)
    assert controller.step(first[0], 0.0, 7.6).u[0] == pytest.approx(TrackingMPC(PLANT).step(first[0], 0.0, 7.6).u[0])


@pytest.mark.compiles
def test_a_torque_comes_in_by_the_signal_d():
    loaded = RealPlant(PLANT, torque_profile=((0.0, 0.3),))
    from_outside, *_ = responded(PLANT, PIDControl(PLANT), MOVE, d=0.3)
    run = simulate(loaded, PIDControl(PLANT), MOVE)
    own, *_ = responded(loaded, PIDControl(PLANT), MOVE)
    np.testing.assert_allclose(own[:, :4], run.x, rtol=1e-6, atol=1e-9)
    assert from_outside[-1, 0] == pytest.approx(own[-1, 0], abs=0.05 * DEG)  # the velocity is measured there


@pytest.mark.compiles
def test_a_controller_alone_answers_recorded_measurements_as_it_did_in_the_loop():
    run = simulate(PLANT, TrackingMPC(PLANT), MOVE)
    alone = sampled_controller(TrackingMPC(PLANT), MOVE)
    answer = control.input_output_response(alone, run.t[:-1], run.x[:-1].T)
    np.testing.assert_allclose(answer.outputs.T, run.u, rtol=1e-6)


@pytest.mark.compiles
def test_signals_connect_by_their_names_with_systems_of_python_control():
    """A pure delay of one sample between controller and plant."""
    controller = sampled_controller(PIDControl(PLANT), MOVE)
    names = ["P1_command", "P2_command"]
    delay = control.ss(np.zeros((2, 2)), np.eye(2), np.eye(2), 0, DT, inputs=names, outputs=["P1_late", "P2_late"])
    plant = sampled_plant(PLANT, DT)
    plant.update_names(inputs=["P1_late", "P2_late", "d"])
    loop = control.interconnect([plant, delay, controller], inputs=["d"], outputs=["theta", "K"])
    x0 = at_rest(PLANT, DT, MOVE)
    T = DT * np.arange(20)
    answer = control.input_output_response(loop, T, 0 * T, [*x0, *x0[2:]])
    assert np.isfinite(answer.outputs).all()
    assert answer.outputs[1, 0] == pytest.approx(7.6)


def test_the_real_plant_with_nothing_switched_on_is_the_nominal_one():
    T, x0 = DT * np.arange(30), PLANT.at_rest(0.2, 7.6)
    U = np.vstack([np.full((2, 30), x0[2]), np.full(30, 0.1)])
    nominal = control.input_output_response(sampled_plant(PLANT, DT), T, U, x0)
    real = RealPlant(PLANT)
    start = [*x0, 0.0]
    bare = control.input_output_response(sampled_real_plant(real, DT), T, U, start)
    np.testing.assert_allclose(bare.states[:4], nominal.states, rtol=1e-9)


def test_time_does_not_jump_for_a_controller():
    alone = sampled_controller(PIDControl(PLANT), MOVE)
    alone.output(0.0, [], PLANT.at_rest(0.0, 7.6))
    with pytest.raises(InvalidInput, match="sample 7 does not come after sample 0"):
        alone.output(0.07, [], PLANT.at_rest(0.0, 7.6))


def test_a_plant_with_faults_is_refused_because_faults_remember():
    with pytest.raises(InvalidInput, match="use simulate"):
        sampled_real_plant(RealPlant(PLANT, faults=(Leak(),)), DT)
