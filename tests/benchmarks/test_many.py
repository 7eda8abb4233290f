"""Many runs are timed whole, and runs that come out otherwise than those of `simulate` end the benchmark."""

import csv
from dataclasses import replace

import numpy as np
import pytest

pytestmark = pytest.mark.slow


@pytest.fixture
def many(benchmark_module, monkeypatch):
    """The module, with loops that are over soon."""
    module = benchmark_module("many")
    move = module.rested_sine()
    begun = replace(move, t=move.t[:40], theta=move.theta[:40], K=move.K[:40])
    monkeypatch.setattr(module, "rested_sine", lambda: begun)
    return module


def test_all_runs_are_made_and_written(many, tmp_path):
    row = many.measured("one", many.setting(), many.one_plant(5), 2)
    assert (row.runs, row.pairs, row.compiled) == (5, 2, 5)
    assert row.difference < 1e-9
    assert row.least <= row.ratio <= row.most
    many.write([row], tmp_path)
    with (tmp_path / "many.csv").open(encoding="utf-8") as file:
        (read,) = csv.DictReader(file)
    assert float(read["ratio"]) == row.ratio
    assert many.line(row) in (tmp_path / "many.md").read_text(encoding="utf-8")


def test_runs_that_come_out_otherwise_end_it(many, monkeypatch):
    def other(plants, *arguments, **options):
        moved = [replace(plant, force_gains=(1.0 + 1e-6, 1.0)) for plant in plants]
        return honest(moved, *arguments, **options)

    honest = many.simulate_many
    monkeypatch.setattr(many, "simulate_many", other)
    with pytest.raises(many.BenchmarkFailure, match="`simulate` and `simulate_many` differ by"):
        many.measured("one", many.setting(), many.one_plant(2), 1)


def test_what_was_asked_for_and_missed_is_said(many):
    row = many.Row("one", 10, 2, 0.4, 0.05, 8.0, 7.0, 9.0, 1e-13, 10, 2.0, 1.25, 1.6, 1.02, 1.7)
    assert "8.00 (7.0 to 9.0) | 6 |" in many.line(row)
    assert "1.60, missed | 2 | 1.02 | 1.70 |" in many.line(row)


def test_a_status_that_differs_is_a_difference(many):
    run = many.simulate(many.one_plant(1)[0].nominal, many.setting().controller, many.rested_sine())
    assert many.difference(run, run) == 0.0
    assert many.difference(run, replace(run, status=run.status + 1)) == np.inf
    assert many.difference(run, replace(run, x=run.x + 1e-6)) == pytest.approx(1e-6)
