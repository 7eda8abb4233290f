"""Responses of loops, and motions that are learned on simulated joints."""

import numpy as np
import pytest
from typer.testing import CliRunner

from mpc import Plant, RealPlant, Reference, simulate
from mpc.cli import app
from mpc.observer.base import Differentiator
from mpc.repetition.learner import Learner
from mpc.repetition.practice import on_time, practise
from mpc.repetition.response import postures, response, responses
from mpc.trials.loops import Settings, loop
from mpc.trials.motions.trajectories import point_to_point, usual_stiffness
from mpc.yardsticks.baselines import FeedForwardControl

PLANT = Plant()
MOTION = point_to_point(usual_stiffness(PLANT.joint))


def test_the_response_is_that_of_a_sine():
    f = 1.0
    controller, observer = FeedForwardControl(PLANT, 0.01), Differentiator(0.01)
    theta, K = postures(MOTION)[1]
    found = response(PLANT, controller, observer, theta, K)
    assert found.T[0, 0, 0] == pytest.approx(1.0, abs=0.01)
    t = 0.01 * np.arange(801)
    asked = theta + 1e-4 * np.sin(2 * np.pi * f * t)
    run = simulate(PLANT, controller, Reference(t, asked, np.full_like(t, K)), observer=observer)
    wave = np.exp(-2j * np.pi * f * t[400:800])
    seen = ((run.theta - theta)[400:800] @ wave) / ((asked - theta)[400:800] @ wave)
    assert found.T[round(f / 0.1), 0, 0] == pytest.approx(seen, abs=0.02)


def test_readings_are_dated_by_their_age():
    t = 0.01 * np.arange(100)
    true, age = np.sin(5 * t), 0.02
    old = np.sin(5 * (t - age))[:, None]
    old[40] = np.nan
    np.testing.assert_allclose(on_time(t, old, age)[3:-3, 0], true[3:-3], atol=2e-3)


@pytest.mark.slow
def test_a_real_joint_learns_what_its_controller_was_not_told():
    real = RealPlant.standard()
    motion = point_to_point(usual_stiffness(real.nominal.joint))
    settings = Settings(real.nominal)
    controller, observer = loop("predictive-pid", settings)
    learner = Learner(motion, responses("predictive-pid", settings, motion, n_draws=1), settings.dt, 4)
    practice = practise(real, controller, learner, observer=observer)
    assert learner.gain > 2
    first, best = (np.abs(run.K - run.K_ref)[learner.course.begin :].mean() for run in (practice.first, practice.best))
    assert best < 1.1 * first


@pytest.mark.slow
def test_a_correction_is_written_played_and_refused_for_another_load(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ["--plant", "real", "--controller", "pid", "--out", "run.csv", "--force"]
    said = CliRunner().invoke(app, ["track", "min-jerk", *options, "--repeat", "2"], catch_exceptions=False).output
    assert "repetition 2: angle error" in said
    assert (tmp_path / "min-jerk.correction.png").stat().st_size > 10_000
    played = ["track", *options, "--from", "min-jerk.correction.toml"]
    assert "played: correction of min-jerk with pid" in CliRunner().invoke(app, played, catch_exceptions=False).output
    refused = CliRunner().invoke(app, [*played, "--load", "a box"])
    assert "another load: no load, not a box" in str(refused.exception)
