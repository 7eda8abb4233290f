"""The MPC's part of the speed benchmark cannot be fooled, and a part that is measured alone leaves the others."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from mpc import TrackingMPC
from mpc.plan import Plan

ROOT = Path(__file__).parents[2]


@pytest.fixture
def part(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    return lambda name: importlib.import_module(f"benchmarks.speed.{name}")


def test_a_rival_that_commands_something_else_ends_the_benchmark(part):
    steps, truth = part("mpc_step"), part("truth")

    class Liar(TrackingMPC):
        def step(self, *arguments):
            plan = super().step(*arguments)
            return Plan(plan.u + 5e2, plan.x, plan.K, plan.status, plan.rung, plan.slack, plan.times)

    steps.check_commands(10, {"honest": lambda plant, N: TrackingMPC(plant, 0.01, N, iterations=20)})
    with pytest.raises(truth.BenchmarkFailure, match="liar, N = 10"):
        steps.check_commands(10, {"liar": lambda plant, N: Liar(plant, 0.01, N, iterations=20)})


def test_limits_bind_for_a_part_of_the_loop_in_which_steps_are_timed(part):
    loop = part("mpc_loop").closed_loop(lambda plant: part("mpc_step").mpc(plant, 20), 1.5)
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
