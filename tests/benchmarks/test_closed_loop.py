"""The closed-loop benchmark reads the right figures off a run."""

import csv
import importlib
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc.trials.loops import loop
from mpc.trials.motions.trajectories import LEAD

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bench():
    """The parts of the benchmark by name."""
    names = ("cases", "runs", "report", "stiffness", "__main__")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2])
        yield SimpleNamespace(**{name: importlib.import_module(f"benchmarks.closed_loop.{name}") for name in names})


@pytest.fixture(scope="module")
def run(bench):
    cases = bench.cases
    return bench.runs.run_case(cases.STANDARD, cases.CASES["steps"], *loop("feedforward", cases.SETTINGS), 1)


def with_errors(run, *errors):
    """The run with the errors [°] (from time, to time, size) of the angle instead of its own."""
    x = run.x.copy()
    x[:, 0] = run.theta_ref
    for begin, end, size in errors:
        x[(run.t >= begin - 1e-9) & (run.t < end - 1e-9), 0] += size * DEG
    return replace(run, x=x)


def test_errors_count_from_the_first_rest_to_the_load_and_with_the_load_to_the_end(bench, run):
    load = bench.cases.CASES["steps"].load_from
    f = bench.runs.figures("steps", with_errors(run, (0, LEAD, 9.0), (LEAD, load, 2.0), (load, 99, 4.0)))
    assert (f.rms, f.worst) == pytest.approx((2.0, 2.0))
    assert f.worst_with_load == pytest.approx(4.0)
    assert 2.0 < f.rms_with_load < 4.0


def test_the_steady_error_is_that_of_the_last_second(bench, run):
    end = run.t[-1]
    f = bench.runs.figures("steps", with_errors(run, (end - 0.99, end - 0.5, -0.1), (end - 0.5, end + 1, 0.3)))
    assert f.steady_mean == pytest.approx(0.1, abs=0.01)
    assert f.steady_swing == pytest.approx(0.4)


def test_the_load_is_on_from_its_time_on(bench, run):
    blind = run.theta - run.theta_ref
    before, after = blind[round(bench.cases.CASES["steps"].load_from / run.dt) - 1], blind[-1]
    assert (after - before) * run.K[-1] == pytest.approx(bench.cases.LOAD, rel=0.5)


def test_a_figure_meets_what_is_asked_up_to_and_with_its_limit(bench):
    assert [bench.report.verdict(v, 0.8, 0.6) for v in (0.5, 0.6, 0.7, 0.8, 0.9)] == [
        "stretch",
        "stretch",
        "must",
        "must",
        "**no**",
    ]
    assert bench.report.verdict(np.nan, 0.8, 0.6) == "**no**"


def test_air_is_what_both_pressures_rose(bench):
    P = np.array([[1.0, 3.0], [1.5, 2.0], [1.2, 2.0], [1.4, 2.25]]) * BAR
    assert bench.runs.filled(P) == pytest.approx(0.5 + 0.2 + 0.25)


def test_single_effects_are_told_as_they_are_and_variants_as_the_standard_plant(bench):
    cases = bench.cases
    assert cases.ALONE["nominal"].told.dead_time == cases.ALONE["nominal"].told.friction.mu == 0.0
    assert cases.ALONE["dead time alone"].told.dead_time == cases.STANDARD.dead_time
    assert cases.ALONE["hysteresis alone"].told.friction.mu > 0
    assert all(variant.told == cases.TOLD for variant in cases.VARIANTS.values())


@pytest.fixture(scope="module")
def quick(bench):
    """Rows of a benchmark in which every controller made the same error, the MPC but once."""
    fields_of = {f.name: 0.4 for f in fields(bench.runs.Figures)} | {"limits_exceeded": 0, "slack": 0.0}
    figures = bench.runs.Figures(**fields_of | {"rungs": (7,) + (0,) * (len(bench.runs.RUNGS) - 1)})
    rows = []
    for job in bench.runs.jobs(bench.runs.QUICK, 11):
        for case in job.cases:
            lost = (job.plant, job.controller, case) == ("standard", "mpc", "chirp")
            rows.append(
                bench.runs.Row(job.plant, case, job.controller, 11, replace(figures, rms=0.9) if lost else figures)
            )
    return rows


def test_the_report_tells_every_plant_and_where_the_mpc_does_not_win(bench, quick):
    text = "\n".join(bench.report.markdown(quick))
    for plant in bench.cases.EVERY:
        assert plant in text
    defeats = text[text.index("Where the MPC does not win") :]
    assert "standard: chirp, RMS: pid 0.4 °, MPC 0.9 °" in defeats
    assert f"{bench.runs.RUNGS[0]} {7 * sum(r.controller == 'mpc' for r in quick)}" in text


def test_a_run_that_is_thrown_off_is_called_unstable_and_gets_no_figures(bench, quick):
    off = [
        r._replace(figures=replace(r.figures, rms=84.4, worst_with_load=158.0))
        if (r.plant, r.case, r.controller) == ("standard", "sine", "pid")
        else r
        for r in quick
    ]
    text = "\n".join(bench.report.markdown(off))
    assert "* standard: pid: sine (1 of 1 runs)" in text
    assert "| unstable runs | 0 | 0 | 0 | 1 | 0 | 0 | 0 | stretch |" in text
    assert "84.4" not in text
    assert "unstable" not in "\n".join(bench.report.markdown(quick)).replace("unstable runs", "").split("## Plant")[1]
    assert bench.report._ratio(off, "standard", "pid") == bench.report._ratio(quick, "standard", "pid")


def test_an_error_that_is_no_number_is_unstable(bench, quick):
    figures = quick[0].figures
    found = [replace(figures, worst_with_load=v).unstable for v in (44.0, 46.0, np.inf, np.nan)]
    assert found == [False, True, True, True]


def test_gains_that_are_placed_place_the_poles(bench):
    cases = bench.cases
    P = 2.5 * BAR
    K = float(cases.MODEL.stiffness(np.array([0.0, 0.0, P, P])))
    for rate in (6.0, 12.0):
        gains = cases.placed(rate)
        poles = np.roots(
            [cases.MODEL.inertia, cases.MODEL.damping + gains.derivative, K + gains.proportional, gains.integral]
        )
        np.testing.assert_allclose(poles, -rate, rtol=1e-3)


def test_every_run_is_a_line_of_the_table(bench, quick, tmp_path):
    bench.__main__.save_rows(quick, tmp_path / "runs.csv")
    with (tmp_path / "runs.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(quick)
    assert {line["plant"] for line in lines} == set(bench.cases.EVERY)
    assert lines[0]["steps_QP"] == "7"


@pytest.mark.parametrize("plant", ["standard", "both +10 %", "Dahl friction"])
def test_a_joint_fitted_to_encoder_pressures_and_a_weight_knows_the_stiffness_of_the_plant(bench, plant):
    fitted, real = bench.stiffness.fitted(plant), bench.cases.EVERY[plant].real
    for P in (2 * BAR, 3 * BAR, 4 * BAR):
        true = float(real.stiffness(np.array([0.0, 0.0, P, P])))
        assert fitted.stiffness(0.0, P, P) == pytest.approx(true, rel=0.04)
    if plant == "Dahl friction":  # the form that is fitted
        assert fitted.friction == pytest.approx(real.friction.mu, rel=0.15)


def test_what_a_fitted_model_changes(bench):
    """The report's model is about 2 N·m/rad off on this plant, the fitted one some 4 %.

    What is fitted takes friction for a share of the pull, which it is not here.
    """
    _, guessed = bench.stiffness.found(bench.stiffness.Experiment("held by Tondu2021", 11))
    _, fitted = bench.stiffness.found(bench.stiffness.Experiment("held by the fitted joint", 11))
    assert guessed.measured == pytest.approx(guessed.asked - 2.0, abs=0.3)
    assert fitted.asked == guessed.asked
    assert fitted.measured == pytest.approx(fitted.asked, rel=0.06)


def test_the_causes_of_the_push_table_add_up(bench):
    pushed = [bench.stiffness.found(e) for e in bench.stiffness.experiments(1) if e.situation == "both +10 %"]
    line = list(bench.stiffness.markdown(pushed))[-2]
    asked, _, _, measured, *causes = (float(cell) for cell in line.split("|")[2:10])
    assert asked + sum(causes) == pytest.approx(measured, abs=0.03)
    assert causes[2] == pytest.approx(0.55, abs=0.05)
