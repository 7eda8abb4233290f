"""The report on exactness: a small run, its figures, and that it keeps what it did not measure again."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def run(out, *options):
    command = [
        sys.executable,
        "-W",
        "error",
        "-m",
        "benchmarks.exactness",
        "--targets",
        "60",
        "--out",
        str(out),
        *options,
    ]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def read(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_small_run_reports_all_priorities_and_is_added_to(tmp_path):
    done = run(tmp_path, "--only", "Sarosi2012 pulley")
    assert done.returncode == 0, done.stdout + done.stderr
    (times,) = {tuple(sorted(row)) for row in read(tmp_path / "exactness_time.csv")}
    assert {"scalar_before", "scalar_after", "batch"} <= set(times)
    done = run(tmp_path, "--only", "Hogan1984 table", "--no-times")
    assert done.returncode == 0, done.stdout + done.stderr
    rows = read(tmp_path / "exactness.csv")
    assert [(row["muscle"], row["priority"]) for row in rows] == [
        (muscle, priority) for muscle in ("Sarosi2012", "Hogan1984") for priority in ("torque", "stiffness", "weighted")
    ]
    assert all(int(row["random"]) >= 60 and int(row["made"]) >= 30 for row in rows)
    assert {row[name] for row in rows for name in ("beaten", "refused", "false_status", "false_intervals")} == {"0"}
    assert len(read(tmp_path / "exactness_time.csv")) == 3
    report = (tmp_path / "exactness.md").read_text(encoding="utf-8")
    assert "| Sarosi2012 | pulley | torque |" in report
    assert "| Hogan1984 | table | weighted |" in report


def test_a_joint_that_there_is_not_is_refused_in_a_sentence(tmp_path):
    done = run(tmp_path, "--only", "Hogan 1984")
    assert done.returncode == 2
    assert "no joint has Hogan 1984 in its name" in done.stderr
    assert not list(tmp_path.iterdir())
