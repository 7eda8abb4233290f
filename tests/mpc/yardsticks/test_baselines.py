"""The controllers of today's practice do what they are known for, and keep the same limits."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from allocator import BAR, DEG, InvalidInput, MissingBackend
from mpc import PlanStatus, Reference, Rung, Weights, simulate, sine
from mpc.model.real import RealPlant
from mpc.observer.base import Differentiator
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.linearise import Predictor
from mpc.trials.loops import CONTROLLERS, Settings, loop
from mpc.trials.metrics import metrics
from mpc.yardsticks.baselines import FeedForwardControl, LQRControl, PIControl, PIDControl, PIDGains

REAL = RealPlant.standard()
PLANT = REAL.nominal
MOVE = sine(amplitude=30 * DEG, K=5.5, duration=3, ramp=1)
STILL = Reference([0, 4], [0.0, 0.0], [5.5, 5.5])
GENTLE = PIDGains(1.0, 6.0, 0.4, 0.02)
BASELINES = [FeedForwardControl, PIDControl, LQRControl]


@pytest.mark.parametrize("control", BASELINES)
def test_on_the_plant_that_is_its_model_every_baseline_follows_its_feed_forward(control):
    run = simulate(PLANT, control(PLANT), MOVE)
    assert metrics(run).theta_rms < 0.15
    assert metrics(run).K_rms < 0.1
    assert metrics(run).limits_kept
    assert (run.status == PlanStatus.CLOSED_FORM).all()
    assert (run.rung == Rung.ALLOCATION).all()


@pytest.mark.compiles
@pytest.mark.parametrize("name", ["pi", "predictive-pid"])
def test_a_compiled_feed_forward_gives_the_same_run(name):
    settings = Settings(PLANT, compensation=REAL.known())
    readable, compiled = (
        simulate(REAL, change(controller), STILL, observer=observer)
        for change in (lambda c: c, lambda c: c.compile())
        for controller, observer in [loop(name, settings)]
    )
    np.testing.assert_allclose(compiled.theta, readable.theta, rtol=0, atol=1e-9)
    np.testing.assert_allclose(compiled.u, readable.u, rtol=0, atol=1e-2)


@pytest.mark.parametrize("control", [*BASELINES, PIControl])
def test_every_baseline_keeps_the_hard_limits_whatever_is_asked(control):
    wild = Reference([0, 0.49, 0.5, 1.0], np.array([0, 0, 110, 110]) * DEG, [5.5, 5.5, 9.0, 9.0])
    run = simulate(REAL, control(PLANT, compensation=REAL.known()), wild)
    broken = metrics(run).violations
    assert broken["commanded pressure"][0] == broken["pressure slew"][0] == 0.0
    assert np.isfinite(run.x).all()


def test_a_load_leaves_an_offset_under_feed_forward_and_none_under_the_pid():
    loaded = RealPlant(PLANT, torque_profile=((0.5, 0.5),))
    blind, pid = (simulate(loaded, c, STILL) for c in (FeedForwardControl(PLANT), PIDControl(PLANT, gains=GENTLE)))
    assert blind.theta[-1] == pytest.approx(0.5 / blind.K[-1], rel=0.02)
    assert abs(pid.theta[-1]) < 0.1 * DEG


@pytest.mark.compiles
def test_the_lqr_takes_the_load_from_the_observer():
    loaded = RealPlant(PLANT, torque_profile=((0.5, 0.5),))
    run = simulate(loaded, LQRControl(PLANT, weights=Weights.calm()), STILL, observer=KalmanObserver(PLANT, 0.01))
    assert abs(run.theta[-1]) < 0.02 * DEG


def test_the_lqr_s_first_answer_is_the_riccati_equation_s():
    """Written anew from the docstring of `mpc.tracking.cost`, in units of bar."""
    weights, dt = Weights.calm(), 0.01
    middle = np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR])
    model = Predictor(PLANT, dt, 1).linearise(middle, middle[None, 2:])
    bar = np.array([1, 1, BAR, BAR])
    A = np.zeros((6, 6))
    A[:4, :4] = model.A[0] / bar[:, None] * bar
    B = np.vstack([model.B[0] / bar[:, None] * BAR, np.eye(2)])
    w_u, w_r, C = weights.u * BAR**2, weights.rate * BAR**2 / dt**2, np.append(model.C[0] * bar, [0, 0])
    D = np.hstack([np.zeros((2, 4)), np.eye(2)])
    Q = np.diag([weights.theta, weights.omega, 0, 0, 0, 0]) + weights.K * np.outer(C, C) + w_r * D.T @ D
    R, cross = (w_u + w_r) * np.eye(2), -w_r * D.T
    S = solve_discrete_are(A, B, Q, R, s=cross)
    gain = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A + cross.T)

    rest = PLANT.at_rest(0.0, 5.5)
    off = rest + np.array([0.02 * DEG, 0.05 * DEG, 0.0, 0.0])  # small: no limit binds
    u = LQRControl(PLANT, dt, weights=weights).step(off, 0.0, 5.5).u[0]
    expected = rest[2:] - BAR * gain @ np.append((off - rest) / bar, [0.0, 0.0])
    np.testing.assert_allclose(u - rest[2:], expected - rest[2:], rtol=1e-6)


def test_the_pid_s_integral_rests_while_a_limit_binds():
    pid, x = PIDControl(PLANT, gains=GENTLE), PLANT.at_rest(0.0, 5.5)
    for _ in range(100):
        pid.step(x, 60 * DEG, 5.5)  # more than the slew limit lets through at once
    far = pid.step(x, 60 * DEG, 5.5).u[0]
    limits = PLANT.joint.pressure_limits
    assert far[0] <= limits[1]
    swing = [pid.step(x, 0.0, 5.5).u[0] for _ in range(120)][-1]
    np.testing.assert_allclose(swing, x[2:], atol=1.0 * BAR)


@pytest.mark.compiles
def test_loops_are_built_by_name_with_or_without_an_observer():
    for name in CONTROLLERS:
        for watched, kind in ((True, KalmanObserver), (False, Differentiator)):
            _, observer = loop(name, Settings(PLANT), watched)
            assert isinstance(observer, kind)
    with pytest.raises(MissingBackend, match="pid"):
        loop("fuzzy", Settings(PLANT))


def test_an_impossible_gain_is_refused_by_its_name():
    with pytest.raises(InvalidInput, match="integral"):
        PIDGains(integral=-1.0)
