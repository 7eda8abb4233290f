"""The measurement of endpoint stiffness: a small run tells both outcomes apart."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def test_a_small_run_tells_all_targets_apart():
    command = [sys.executable, "-W", "error", "-m", "benchmarks.mechanisms.endpoint", "--targets", "2"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.findall(r"at least: (\d+) of 4", done.stdout) == ["4", "4"]
