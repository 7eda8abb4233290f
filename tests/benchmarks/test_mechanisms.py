"""The report on mechanisms: a small run, its figures, and that a wrong answer fails it."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.mechanisms import nonaffine
from benchmarks.mechanisms.accuracy import Check

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def test_a_small_run_checks_everything(tmp_path):
    command = [sys.executable, "-W", "error", "-m", "benchmarks.mechanisms", "--targets", "200", "--rounds", "1"]
    done = subprocess.run([*command, "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAILED" not in done.stdout
    with (tmp_path / "mechanisms.csv").open(encoding="utf-8") as file:
        rows = {row["what"]: row for row in csv.DictReader(file)}
    faces = rows["arm26 against all 729 faces, of the supply"]
    assert (int(faces["targets"]), float(faces["worst"]) < 1e-9) == (20, True)
    timed = ("compiled batch, one posture", "DAQP, three QPs called from Python")
    assert all(float(rows[f"lexicographic: {name}"]["microseconds"]) > 0 for name in timed)


@pytest.mark.parametrize("worst", [1e-8, float("nan"), float("inf")])
def test_a_wrong_answer_fails(worst):
    assert Check("", 1, worst, 1e-9).failed


@pytest.mark.parametrize("priority", ["torque", "weighted"])
def test_the_gap_of_muscles_that_are_not_affine_is_closed_and_no_start_ends_below_the_bound(priority):
    found = nonaffine.search(priority, 10, 60, seed=4)
    assert (~found.allocation.success).sum() >= 4
    assert found.allocation.gap.max() <= 1e-3
    assert found.allocation.kkt_residual.max() < 1e-7
    assert found.starts >= 20
    assert found.below == 0
