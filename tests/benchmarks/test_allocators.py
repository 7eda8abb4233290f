"""The comparison of the allocators with the analytic inverse: its laws, its report, and that it cannot be fooled."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
ZERO = 1e-5  # [N·m]


@pytest.fixture(scope="module")
def quick_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    command = [sys.executable, "-W", "error", "-m", "benchmarks.allocators", "--quick", "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.fixture(scope="module")
def scores(quick_run):
    return read(quick_run / "allocators.csv")


def read(path):
    with path.open(encoding="utf-8") as file:
        return [{name: number(text) for name, text in row.items()} for row in csv.DictReader(file)]


def number(text):
    try:
        return float(text)
    except ValueError:
        return text


def by(scores, *contenders, **wanted):
    chosen = [s for s in scores if s["contender"] in contenders and all(s[k] == v for k, v in wanted.items())]
    assert chosen
    return chosen


def allocators(scores, **wanted):
    names = {s["contender"] for s in scores if not s["contender"].startswith("inverse")}
    assert len(names) == 6
    return by(scores, *names, **wanted)


def test_no_allocator_breaks_a_limit_or_slackens_a_cable(scores):
    assert {(s["within_limits"], s["taut"], s["nan"]) for s in allocators(scores)} == {(1, 1, 0)}


def test_the_inverse_breaks_limits_on_the_ranges_of_figure_8(scores):
    (raw,) = by(scores, "inverse", set="Fig. 8", priority="torque")
    (clipped,) = by(scores, "inverse, clipped", set="Fig. 8", priority="torque")
    assert raw["within_limits"] < clipped["within_limits"] < 1  # clipping does not tauten a slack cable


def test_no_torque_is_lost_by_an_allocator_but_by_the_clipped_inverse(scores):
    assert max(s["T_worst_reachable"] for s in allocators(scores, priority="torque")) < ZERO
    for name in ("inverse, clipped", "inverse, in the box"):
        assert min(s["T_worst_reachable"] for s in by(scores, name, priority="torque")) > 100 * ZERO


def test_the_priorities_order_the_errors(scores):
    """Of the exact answers the torque-first ones err least in torque, the stiffness-first ones in stiffness."""
    for first in by(scores, "exact", priority="torque"):
        (other,) = by(scores, "exact", priority="stiffness", set=first["set"], joint=first["joint"])
        assert first["T_rms"] <= other["T_rms"]
        assert first["K_rms"] >= other["K_rms"]


def test_back_ends_agree_with_exact(scores):
    assert max(s["distance_to_exact"] for s in allocators(scores)) < 1e-4
    for priority in ("torque", "stiffness"):  # the weighted cost of Tondu2021 has local optima
        assert {s["worse_than_exact"] for s in allocators(scores, priority=priority)} == {0}


def test_the_warm_start_saves_iterations_and_is_the_answer_where_the_target_is_feasible(quick_run):
    gains = read(quick_run / "allocators_warm_start.csv")
    assert len(gains) == 2 * 4 * 5
    assert {g["iterations_warm"] for g in gains if g["set"] == "feasible"} == {0}
    assert sum(g["iterations_cold"] for g in gains) > 1.5 * sum(g["iterations_warm"] for g in gains)


def test_the_report_has_its_sections_and_pictures(quick_run):
    report = (quick_run / "allocators.md").read_text(encoding="utf-8")
    titles = [
        "Main table",
        "Plots",
        "Comparison",
        *(f"Priority: {p}" for p in ("torque", "stiffness", "weighted")),
    ]
    titles += ["Time", "Warm start", "Limitations", "Machine and versions"]
    assert [line[3:] for line in report.splitlines() if line.startswith("## ")] == titles
    pictures = [line.split("](")[1].rstrip(")") for line in report.splitlines() if line.startswith("![")]
    assert len(pictures) == 4
    assert all((quick_run / name).stat().st_size > 5000 for name in pictures)


@pytest.fixture
def part(benchmark_module):
    """A module of the benchmark, by its name."""
    return lambda name: benchmark_module(f"allocators.{name}")


LIES = {
    "status EXACT, but": lambda a: a._replace(status=0 * a.status),
    "but the residual is 0.5 of": lambda a: a._replace(residual=a.residual + 0.5),
    "breaks a limit": lambda a: a._replace(P1=a.P1 + 5e5),
}


@pytest.mark.parametrize(("said", "lie"), LIES.items(), ids=LIES.keys())
def test_a_lie_ends_the_benchmark(part, said, lie):
    targets, contenders, truth = part("targets"), part("contenders"), part("truth")
    grid = targets.report_grid(5, 4)
    exact = contenders.EXACT.answer(grid, "torque")
    truth.check(grid, "torque", "honest", exact, exact)
    with pytest.raises(truth.BenchmarkFailure, match=f"liar with priority torque .*{said}"):
        truth.check(grid, "torque", "liar", lie(exact), exact)


def test_an_optimum_that_is_beaten_ends_the_benchmark(part):
    targets, contenders, truth = part("targets"), part("contenders"), part("truth")
    grid = targets.report_grid(5, 4)
    exact = contenders.EXACT.answer(grid, "torque")
    wrong = exact._replace(P1=exact.P1 * 0.99)
    with pytest.raises(truth.BenchmarkFailure, match="better than the exact one"):
        truth.check(grid, "torque", "back-end", exact, wrong)


def test_a_slack_cable_gives_neither_torque_nor_stiffness(part):
    """The report's K = 6 N·m/rad at θ = 0 asks for 0.81 bar, at which both cables hang: nothing is there."""
    targets, contenders, measures = part("targets"), part("contenders"), part("measures")
    middle = targets.TargetSet("slack", next(iter(targets.JOINTS)), np.zeros(1), np.full(1, 6.0), np.zeros(1))
    answer = contenders.INVERSES[0].answer(middle, "torque")
    assert answer.P1 == pytest.approx([0.81e5], rel=5e-3)
    found = measures.effect(middle, answer)
    assert (found.T[0], found.K[0], bool(found.taut[0]), bool(found.within[0])) == (0, 0, False, False)
