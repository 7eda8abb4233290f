"""The MPC's part of the speed benchmark cannot be fooled, and a part that is measured alone leaves the others."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from mpc import Plant, TrackingMPC, Weights
from mpc.tracking.plan import Plan

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


@pytest.fixture
def part(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    return lambda name: importlib.import_module(f"benchmarks.speed.{name}")


class Shifted(TrackingMPC):
    """Commands what is 5 mbar off from the sample `since` on, as far as the limits let it."""

    since = 0

    def step(self, x, *arguments):
        plan = super().step(x, *arguments)
        u = plan.u + 5e2 * (np.arange(self.N) >= self.since)[:, None]
        return Plan(self.limits.limited(x[2:], u), plan.x, plan.K, plan.status, plan.rung, plan.slack, plan.times)


class ShiftedLater(Shifted):
    """Its first commands are right."""

    since = 5


class FirstOnly(TrackingMPC):
    """Tells one command, and has another objective."""

    def step(self, *arguments):
        plan = super().step(*arguments)
        return Plan(plan.u[:1], plan.x[:2], plan.K[:2], plan.status, plan.rung, plan.slack, plan.times)


OTHER = {"weights": Weights(K=3 * Weights().K)}


@pytest.mark.parametrize(
    ("liar", "settings"), [(Shifted, {}), (ShiftedLater, {}), (TrackingMPC, OTHER), (FirstOnly, OTHER)]
)
def test_a_rival_that_commands_something_else_ends_the_benchmark(part, liar, settings):
    steps, truth = part("steps.step"), part("truth")
    with pytest.raises(truth.BenchmarkFailure, match="liar, N = 10"):
        steps.check_commands(10, {"liar": lambda plant, N: liar(plant, 0.01, N, iterations=20, **settings)})


@pytest.mark.parametrize("honest", [TrackingMPC, FirstOnly])
def test_an_honest_rival_does_not(part, honest):
    part("steps.step").check_commands(10, {"honest": lambda plant, N: honest(plant, 0.01, N, iterations=20)})


@pytest.mark.parametrize("N", [10, 20])
def test_commands_are_compared_where_the_slew_limit_binds_and_where_it_does_not(part, N):
    plant, most = Plant(), []
    for theta, K, d in part("steps.step").tasks(N):
        mpc = TrackingMPC(plant, 0.01, N, iterations=20)
        x = plant.at_rest(0.0, 7.6)
        changes = np.diff(mpc.step(x, theta, K, d).u, axis=0, prepend=x[None, 2:])
        most.append(np.abs(changes).max() / mpc.limits.step)
    assert most[0] == pytest.approx(1.0, rel=1e-6)
    assert most[1] < 0.9


def test_what_was_asked_for_and_missed_is_said(part):
    report, clock, steps = part("report"), part("clock"), part("steps.step")
    notes = [steps.judged("99th percentile 9 medians", 9.0, 4.0), steps.judged("tail 1", 1.0, 4.0), "as it is"]
    slow = clock.Measurement(
        "control", "step", 1e-6, "step", "x", 2e-6, 2.0, 1.9, 2.1, wanted=3.0, note="; ".join(notes)
    )
    fast = clock.Measurement("control", "step", 1e-6, "step", "y", 2e-6, 2.0, 1.9, 2.1, wanted=1.5, note=notes[0])
    said = ["step: 2 times faster than x; 3 asked.", "step: 99th percentile 9 medians, at most 4 asked: missed."]
    assert report.missed([slow, fast]) == said
    assert "≥ 3, missed" in report.row(slow)
    assert "missed" not in report.row(fast).split("|")[-2]


def test_limits_bind_for_a_part_of_the_loop_in_which_steps_are_timed(part):
    loop = part("steps.loop").closed_loop(lambda plant: part("steps.step").mpc(plant, 20), 1.5)
    assert 0.1 < loop.saturated < 0.9
    assert (loop.run.rung == 0).all()
    assert loop.run.estimate[-1, 4] == pytest.approx(1.0, abs=0.1)  # the load is found out


def test_what_is_written_can_be_read_again(part, tmp_path):
    report, clock = part("report"), part("clock")
    found = [
        clock.Measurement("allocation", "a", 1e-6, "call", "b", 2e-6, 2.0, 1.9, 2.1, 1.5, 1.2, "note"),
        clock.Measurement("control", "c", np.nan, "step", note="only words"),
    ]
    assert report.read(tmp_path) == []
    report.write(found, tmp_path)
    assert [repr(m) for m in report.read(tmp_path)] == [repr(m) for m in found]
