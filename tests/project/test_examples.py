"""Every example runs, in an empty directory and a process of its own, and says something."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples"
HARDWARE = ("bench_ethercat.py", "bench_ros2.py")  # want libraries of the machines that they drive, and say so
EXAMPLES = sorted(path.name for path in FOLDER.glob("*.py") if not path.name.startswith("make_"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in EXAMPLES if name not in HARDWARE])
def test_the_example_runs(name, tmp_path):
    done = subprocess.run([sys.executable, "-P", str(FOLDER / name)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


@pytest.mark.parametrize("name", HARDWARE)
def test_an_example_for_hardware_says_that_it_was_not_tested(name):
    text = (FOLDER / name).read_text()
    compile(text, name, "exec")
    assert "NOT TESTED BY US" in text.splitlines()[0]
