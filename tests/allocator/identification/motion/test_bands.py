"""Bands about predictions and the allowance for an unexplained residual, on errors whose law is known."""

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.identification import fit_motion
from allocator.identification.motion.doubt import Bands, possible_changes, structured
from allocator.identification.motion.problem import MotionProblem
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.static import Difference
from benchmarks.identification import motion_truth_strangers as strangers


def correlated(n, seed):
    """Errors of unit variance that are forgotten within some ten rows."""
    noise, out = np.random.default_rng(seed).normal(size=n), np.empty(n)
    at = 0.0
    for k in range(n):
        at = 0.9 * at + np.sqrt(1 - 0.81) * noise[k]
        out[k] = at
    return out


def test_a_band_holds_95_percent_of_new_errors_and_is_wider_where_errors_are():
    n = 6000
    taut = np.arange(n) // 200 % 2 == 0
    scale = np.where(taut, 1.0, 3.0) * DEG
    bands = Bands.of(scale * correlated(n, 0), np.arange(n) * 5 // n, taut)
    assert bands.taut == pytest.approx(1.96 * DEG, rel=0.1)
    assert bands.other == pytest.approx(5.88 * DEG, rel=0.1)
    assert bands.coverage == pytest.approx(0.95, abs=0.02)
    later = scale * correlated(n, 1)
    _, low, high = bands.about(np.zeros(n), taut)
    for kind in (taut, ~taut):
        assert np.mean((later >= low) & (later <= high) & kind) / np.mean(kind) == pytest.approx(0.95, abs=0.02)


def test_rows_that_were_not_predicted_do_not_count_and_a_rare_kind_has_the_width_of_all():
    errors = np.full(1000, np.nan)
    errors[100:] = np.linspace(-1, 1, 900)
    bands = Bands.of(errors, np.arange(1000) // 200, np.arange(1000) < 950)
    assert bands.other == pytest.approx(0.95, abs=0.01)


def test_noise_is_no_structure_and_a_slow_error_is():
    noise, t = np.random.default_rng(0).normal(size=20_000), 0.02 * np.arange(20_000)
    assert structured(noise) < 0.15
    assert structured(np.sin(t)) == pytest.approx(np.sqrt(0.5), rel=0.01)
    assert structured(np.sin(20 * t)) > 0.6  # a joint that swings, in a model without inertia


def test_no_change_that_moves_the_prediction_as_little_as_the_residual_moves_a_parameter_further():
    rng = np.random.default_rng(0)
    t = 0.05 * np.arange(1500)
    P1, P2 = (np.repeat(rng.uniform(1, 4, 75), 20) * BAR for _ in range(2))
    log, used = MotionLog(t, 0.6 * (P1 - P2) / (P1 + P2), P1, P2), t >= 2
    problem = MotionProblem(log, Difference(4 * BAR), ("lag_up", "lag_down", "dead_time"))
    x = problem.anew(np.array([0.2, 0.3, 0.05, *np.zeros(len(problem.powers))]), used)
    here = problem.run(x, used).theta
    s = 0.02 * DEG  # little enough for differences to be linear
    theta = here + np.sqrt(2) * s * np.sin(0.3 * t)
    disturbed = MotionProblem(MotionLog(t, theta, P1, P2), problem.static, problem.free)
    most = possible_changes(disturbed, x, used, disturbed.values)
    assert most["dead_time"] > 0
    for _ in range(100):
        dx = rng.normal(size=x.size) * problem.sizes() * 1e-5
        moved = disturbed.run(x + dx, used).theta - disturbed.run(x, used).theta
        dx *= 0.7 * s / np.sqrt(np.mean(moved[used] ** 2))
        for i, name in enumerate(problem.free):
            assert abs(dx[i]) <= 1.1 * most[name]


@pytest.mark.slow
def test_the_truth_of_a_joint_that_is_its_own_equation_is_inside_and_so_is_its_later_motion():
    seeds = [1]
    joints = strangers.drawn(seeds)
    u = strangers.commands(1, 2100)
    theta, P = strangers.simulated(joints, u[..., None], gas=True)
    t, half = strangers.STEP * np.arange(len(u)), slice(0, 1400)
    fit = fit_motion(t[half], theta[half, 0], *u[half].T, joint=strangers.given_joint())
    assert fit.problem.gas  # whose compression the log shows
    assert {"lag_up", "lag_down", "lag_ratio"} <= set(fit.parameters)  # regulators of unequal muscles are told apart
    for name, truth in strangers.truths(joints, 0, theta[half, 0], P[half, :, 0]).items():
        if name in fit.parameters:
            assert fit.parameters[name].low <= truth <= fit.parameters[name].high, name
    band = fit.band(t, *u.T)
    inside = (theta[:, 0] >= band.low) & (theta[:, 0] <= band.high)
    assert inside[1400:].mean() > 0.85  # 95 % are expected, of half a minute whose errors are correlated
    assert (band.high - band.low).max() < 0.3 * np.ptp(theta)
