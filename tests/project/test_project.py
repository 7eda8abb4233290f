"""The promises around the code: commands, imports, names."""

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import allocator
import mpc

ROOT = Path(__file__).parents[2]
HEAVY = ("scipy", "casadi", "osqp", "daqp", "qpsolvers", "cvxpy", "control", "matplotlib", "numba", "rich", "typer")


def test_importing_allocate_loads_numpy_and_nothing_heavy():
    loaded = f"[m for m in {HEAVY} if m in sys.modules], 'numpy' in sys.modules"
    code = f"import sys; from allocator import allocate; print({loaded})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] True"


def test_the_command_handles_interrupts_before_numpy_is_loaded():
    code = "import sys, mpc.__main__; print([m for m in ('numpy', 'typer') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_sub_packages_are_imported_on_first_use():
    code = "import allocator, mpc; print(allocator.joint.__name__, mpc.export.__name__, hasattr(mpc, 'nothing'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["allocator.joint", "mpc.export", "False"]


def test_importing_allocate_loads_at_most_three_times_as_many_modules_as_numpy():
    def modules(line):
        code = f"import sys; before = len(sys.modules); {line}; print(len(sys.modules) - before)"
        return int(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)

    assert modules("from allocator import allocate") <= 3 * modules("import numpy")


def commands(text):
    return [line.strip() for line in text.splitlines() if line.strip().startswith("python3 -m venv")]


def test_the_readme_s_two_commands_are_what_ci_runs():
    readme = commands((ROOT / "README.md").read_text())
    assert len(readme) == 2
    assert readme == commands((ROOT / ".ci" / "run").read_text())


def test_every_test_that_ci_names_is_there():
    script = (ROOT / ".ci" / "run").read_text()
    named = re.findall(r"tests/[\w/.{},-]+", script)
    assert len(named) > 5
    printed = subprocess.run(
        ["bash", "-c", f"printf '%s\\n' {' '.join(named)}"], capture_output=True, text=True, check=True
    )
    assert [path for path in printed.stdout.split() if not (ROOT / path).exists()] == []


def modules():
    for package in (allocator, mpc):
        yield package.__name__
        yield from (m.name for m in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))


def test_packages_alone_say_what_they_export_and_all_of_it_exists():
    for name in modules():
        module = importlib.import_module(name)
        if hasattr(module, "__all__"):
            assert hasattr(module, "__path__"), name
            assert module.__all__ != [], name
            assert [exported for exported in module.__all__ if not hasattr(module, exported)] == [], name


def test_the_version_is_the_same_everywhere():
    pyproject, citation = (ROOT / "pyproject.toml").read_text(), (ROOT / "CITATION.cff").read_text()
    version = re.search(r'^version = "(.+)"', pyproject, re.MULTILINE).group(1)
    assert f"\nversion: {version}\n" in citation
    assert f"version = {{{version}}}" in (ROOT / "docs" / "index.md").read_text()


def test_both_packages_say_that_they_are_typed():
    for package in (allocator, mpc):
        assert (Path(package.__file__).parent / "py.typed").exists()
