"""The promises around the code: commands, imports, names."""

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import allocator
import mpc

ROOT = Path(__file__).parents[2]
HEAVY = ("scipy", "casadi", "osqp", "daqp", "qpsolvers", "cvxpy", "control", "matplotlib", "numba", "rich", "typer")


def test_importing_allocator_loads_numpy_and_nothing_heavy():
    code = f"import sys, allocator; print([m for m in {HEAVY} if m in sys.modules], 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] True"


@pytest.mark.slow
def test_importing_allocator_takes_at_most_four_times_as_long_as_numpy():
    def seconds(code):
        """Of the processor: other work on the machine does not count, but slows it down."""
        code = f"import time; {code}; print(time.process_time())"
        return float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)

    seconds("import allocator")  # writes the byte code
    least = {code: min(seconds(code) for _ in range(3)) for code in ("pass", "import numpy", "import allocator")}
    assert least["import allocator"] - least["pass"] < 4 * (least["import numpy"] - least["pass"])


def commands(text):
    return [line.strip() for line in text.splitlines() if line.strip().startswith("python3 -m venv")]


def test_the_readme_s_two_commands_are_what_ci_runs():
    readme = commands((ROOT / "README.md").read_text())
    assert len(readme) == 2
    assert readme == commands((ROOT / ".ci" / "run").read_text())


def modules():
    for package in (allocator, mpc):
        yield package.__name__
        yield from (m.name for m in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))


@pytest.mark.parametrize("name", list(modules()))
def test_every_name_in_all_exists(name):
    module = importlib.import_module(name)
    assert all(hasattr(module, exported) for exported in module.__all__)


def test_the_version_is_the_same_everywhere():
    pyproject, citation = (ROOT / "pyproject.toml").read_text(), (ROOT / "CITATION.cff").read_text()
    version = re.search(r'^version = "(.+)"', pyproject, re.MULTILINE).group(1)
    assert f"\nversion: {version}\n" in citation
    assert f"version = {{{version}}}" in (ROOT / "docs" / "index.md").read_text()


def test_both_packages_say_that_they_are_typed():
    for package in (allocator, mpc):
        assert (Path(package.__file__).parent / "py.typed").exists()
