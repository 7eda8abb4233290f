"""Tracking with gas in the plant: what is lost by a model without it, that knowing it brings it back, at what cost."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from benchmarks.closed_loop import gas as benchmark
from mpc import KalmanObserver, NonlinearMPC, Plant, RealPlant, TrackingMPC, Weights, simulate, sine
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.qp.step import ReadableQPStep

from ...rigs.followed import missed

GAS = Plant(report_joint(SAROSI_DMSP_20_400N), gas=True)
BARE = replace(GAS, gas=None)


def test_the_feed_forward_s_commands_drive_the_plant_along_the_reference():
    """Open loop for half a second at 1 Hz: what a feed-forward without gas misses is two orders of magnitude more."""
    N, dt = 50, 0.01
    t = dt * np.arange(N + 1)
    rise = np.clip(t / 0.3, 0, 1)
    theta, K = 0.3 * rise**3 * (10 - 15 * rise + 6 * rise**2) * np.cos(6 * t), np.full(N + 1, 7.6)
    with_gas, without = (missed(GAS, model, theta, K, dt) for model in (GAS, BARE))
    assert with_gas < 0.01 * without
    assert with_gas < 0.01 * BAR


@pytest.mark.slow
def test_known_gas_costs_no_accuracy_and_unknown_gas_a_quarter_of_a_degree():
    none, unknown, _, known, _, off = (
        [benchmark.error(benchmark.tracked(case, f, duration=6.0)) for f in (0.25, 0.5, 1.0)]
        for case in benchmark.cases()
    )
    assert unknown[2] > 0.2
    assert unknown == sorted(unknown)
    assert max(known) < 2 * max(none) < 0.002
    assert max(off) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("joint", [GAS.joint, report_joint()], ids=["Sarosi2012", "Tondu2021"])
def test_the_compiled_step_is_the_readable_one_with_gas(joint):
    plant = Plant(joint, gas=True)
    compiled, readable = TrackingMPC(plant), TrackingMPC(plant)
    readable._qp_step = ReadableQPStep(readable.problem, readable._predictor)
    readable._feed_forward = InverseDynamics(plant, readable.dt, readable.N)
    assert compiled.implementation == "compiled"
    reference = sine(20 * DEG, 1.0, 7.6, duration=1.0, ramp=0.5)
    ours, theirs = (simulate(plant, controller, reference) for controller in (compiled, readable))
    assert np.abs(ours.u - theirs.u).max() < 1e-6 * BAR


@pytest.mark.slow
def test_the_nonlinear_mpc_knows_the_gas_as_well():
    reference = sine(20 * DEG, 1.0, 7.6, duration=1.0, ramp=0.5)
    one_qp, to_the_end = (simulate(GAS, make(GAS), reference) for make in (TrackingMPC, NonlinearMPC))
    assert np.abs(one_qp.u - to_the_end.u).max() < 2e-3 * BAR
    assert np.abs(to_the_end.theta - reference.resampled(0.01).theta).max() < 0.05 * DEG


@pytest.mark.slow
def test_a_stiffness_at_a_frequency_is_tracked_as_the_isobaric_one_is():
    plant = replace(GAS, frequency=2.0)
    reference = sine(15 * DEG, 0.5, 9.5, duration=2.0, ramp=0.9)
    run = simulate(plant, TrackingMPC(plant), reference)
    P = run.x[:, 2:].T
    felt = plant.joint.dynamic_stiffness(run.theta, *P, 2.0, plant.lags).real
    np.testing.assert_allclose(run.K, felt, rtol=1e-12)
    np.testing.assert_allclose(felt, run.K_ref, rtol=1e-3)
    assert (plant.joint.stiffness(run.theta, *P) < run.K_ref - 1.5).all()
    assert np.abs(run.theta - run.theta_ref).max() < 0.02 * DEG


@pytest.mark.slow
def test_who_knows_the_gas_does_not_take_it_for_a_fault():
    """On the standard real plant at 1 Hz: dead band, dead time, hysteresis, noise."""
    real = RealPlant.standard(nominal=Plant(GAS.joint, lag=0.12, gas=True))
    reference = sine(20 * DEG, 1.0, 5.5, 0.0, duration=6.0)
    error, well = {}, {}
    for model in (real.nominal, replace(real.nominal, gas=None)):
        known = real.known()
        controller = TrackingMPC(model, compensation=known, weights=Weights.calm())
        observer = KalmanObserver(model, 0.01, compensation=known)
        run = simulate(real, controller, reference, observer=observer, seed=3)
        has = model.gas is not None
        error[has], well[has] = np.sqrt(np.mean((run.theta - run.theta_ref)[200:] ** 2)) / DEG, observer.health.well
    assert error[True] < 0.5 * error[False]
    assert well[True]
