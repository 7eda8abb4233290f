"""The light speed measurement: right answers and a whole report; and it cannot be fooled.

What is slower than its floor is named, and fails `--floors` only: CI's machines are busy with other tests.
"""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from allocator import Status, allocate
from allocator.joint.limits import names

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


@pytest.fixture
def part(benchmark_module):
    """A module of the benchmark, by its name."""
    return lambda name: benchmark_module(f"speed.{name}")


def test_the_light_run_answers_rightly_and_reports_all(tmp_path):
    options = ["--light", "--part", "allocation", "--part", "control", "--out"]
    command = [sys.executable, "-W", "error", "-m", "benchmarks.speed", *options, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    report = (tmp_path / "speed.md").read_text(encoding="utf-8")
    assert {"## Allocation", "## Control", "## Limitations", "## Machine and versions"} <= set(report.splitlines())
    with (tmp_path / "speed.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    floors = [row for row in rows if row["floor"] != "nan"]
    assert len(floors) >= 8
    below = {row["what"] for row in floors if float(row["ratio"]) < float(row["floor"])}
    assert all(any(what in line for what in below) for line in done.stdout.splitlines() if line.startswith("TOO SLOW"))
    assert done.stdout.count("TOO SLOW") == len(below)


def test_what_is_slower_than_its_floor_is_found_out(part):
    clock = part("clock")
    slow = clock.versus("x", "ten sums", lambda: [sum(range(2000)) for _ in range(10)], "one", lambda: sum(range(2000)))
    assert not slow.below_its_floor
    assert clock.Measurement("x", "y", 1.0, "call", ratio=slow.ratio, floor=0.9).below_its_floor


@pytest.mark.parametrize("field", ["P1", "K", "status", "limits"])
def test_a_wrong_answer_ends_the_benchmark(part, field):
    targets, truth = part("targets").Targets(50), part("truth")
    right = part("allocation").answers(targets)
    truth.check_same("honest", targets, right)
    wrong = getattr(right, field).copy()
    wrong[7] += 1
    with pytest.raises(truth.BenchmarkFailure, match=f"liar: {field} of 1 targets"):
        truth.check_same("liar", targets, right._replace(**{field: wrong}))


def test_an_optimiser_that_is_far_off_ends_the_benchmark(part):
    truth = part("truth")
    with pytest.raises(truth.BenchmarkFailure, match="0% of the answers are within 50 Pa"):
        truth.check_pressures("wild", np.zeros((3, 2)), np.full((3, 2), 1e5), 50.0)


def test_the_targets_are_of_all_kinds(part):
    found = allocate(*part("targets").Targets(5000).arrays)
    kinds = Status.EXACT, Status.STIFFNESS_LIMITED, Status.BOTH_LIMITED, Status.OUTSIDE_JOINT_RANGE
    assert set(found.status.tolist()) == {*kinds}
    bound = {name for limits in np.unique(found.limits) for name in names(limits)}
    assert bound >= {"P1 upper", "P2 upper", "agonist slack", "antagonist slack", "joint range"}
