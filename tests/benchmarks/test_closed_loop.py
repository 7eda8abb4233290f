"""The closed-loop benchmark reads the right figures off a run."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allocator import DEG
from mpc.loops import loop
from mpc.trajectories import LEAD


@pytest.fixture(scope="module")
def bench():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2])
        yield importlib.import_module("benchmarks.closed_loop")


@pytest.fixture(scope="module")
def run(bench):
    return bench.run_case(bench.STANDARD, bench.CASES["steps"], *loop("feedforward", bench.SETTINGS), 1)


def with_errors(run, *errors):
    """The run with the errors [°] (from time, to time, size) of the angle instead of its own."""
    x = run.x.copy()
    x[:, 0] = run.theta_ref
    for begin, end, size in errors:
        x[(run.t >= begin - 1e-9) & (run.t < end - 1e-9), 0] += size * DEG
    return replace(run, x=x)


def test_errors_count_from_the_first_rest_to_the_load_and_with_the_load_to_the_end(bench, run):
    load = bench.CASES["steps"].load_from
    f = bench.figures("steps", with_errors(run, (0, LEAD, 9.0), (LEAD, load, 2.0), (load, 99, 4.0)))
    assert (f.rms, f.worst) == pytest.approx((2.0, 2.0))
    assert f.worst_with_load == pytest.approx(4.0)
    assert 2.0 < f.rms_with_load < 4.0


def test_the_steady_error_is_that_of_the_last_second(bench, run):
    end = run.t[-1]
    f = bench.figures("steps", with_errors(run, (end - 0.99, end - 0.5, -0.1), (end - 0.5, end + 1, 0.3)))
    assert f.steady_mean == pytest.approx(0.1, abs=0.01)
    assert f.steady_swing == pytest.approx(0.4)


def test_the_load_is_on_from_its_time_on(bench, run):
    blind = run.theta - run.theta_ref
    before, after = blind[round(bench.CASES["steps"].load_from / run.dt) - 1], blind[-1]
    assert (after - before) * run.K[-1] == pytest.approx(bench.LOAD, rel=0.5)


def test_a_figure_meets_what_is_asked_up_to_and_with_its_limit(bench):
    assert [bench.verdict(v, 0.8, 0.6) for v in (0.5, 0.6, 0.7, 0.8, 0.9)] == [
        "stretch",
        "stretch",
        "must",
        "must",
        "**no**",
    ]
    assert bench.verdict(np.nan, 0.8, 0.6) == "**no**"
