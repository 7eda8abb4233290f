"""The benchmark of the exported C: it runs, and its report holds what was measured."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

from ..rigs.needs import needs

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


@needs("gcc")
def test_a_short_run_reports_c_faster_than_python_in_both_precisions(tmp_path):
    command = [sys.executable, "-m", "benchmarks.speed.exported", "--steps", "220", "--horizon", "5"]
    subprocess.run([*command, "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=True)
    with (tmp_path / "exported.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["horizon"], row["precision"]) for row in rows] == [("5", "double"), ("5", "single")]
    assert all(0 < float(row["c_step"]) < float(row["python_step"]) for row in rows)
    assert all(0 < float(row["c_step"]) <= float(row["c_step_worst"]) for row in rows)
    double, single = (float(row["error"]) for row in rows)
    assert double < 1e-8 < single < 1e-3  # of the supply
    report = (tmp_path / "exported.md").read_text()
    assert report.count("| 5 | double |") == 2
