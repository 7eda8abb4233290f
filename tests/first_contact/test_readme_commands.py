"""The README's shell commands, in their order, in a new directory with the sample files."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
USER = """
import json
from user import called
with open("commands.json", encoding="utf-8") as file:
    done = [called(*arguments) for arguments in json.load(file)]
with open("done.json", "w", encoding="utf-8") as file:
    json.dump(done, file)
"""
OUTPUTS = (
    "tracking.csv",
    "tracking.png",
    "run.npz",
    "run.png",
    "my.toml",
    "fit.png",
    "my_joint.toml",
    "joint.png",
    "my_map.png",
    "plan.csv",
    "my_plant.toml",
    "motion.png",
    "felt.png",
    "min-jerk.correction.toml",
    "min-jerk.correction.png",
    "repeated.npz",
    "mpc.csv",
    "pid.csv",
)


def commands():
    """Every `antagonist …` of an indented block or within a line, as a list of arguments, in the order of the text."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.findall(r"^    (?:.*/)?antagonist (\w.*)$|`antagonist (\w[^`]*)`", text, re.MULTILINE)
    return [shlex.split(block or inline) for block, inline in found]


def test_the_readme_has_the_whole_way_from_a_table_to_a_controller_and_to_c():
    names = [arguments[0] for arguments in commands()]
    assert [n for n in names if n not in ("allocate", "map")] == [
        "track",
        "fit",
        "track",
        "plan-joint",
        "fit-joint",
        "fit-motion",
        "tune",
        "muscles",
        "measure",
        "track",
        "track",
        "export",
        "track",
        "track",
    ]
    assert {"allocate", "map"} < set(names)


@pytest.mark.slow
def test_the_readme_s_commands_run_in_their_order(tmp_path):
    """In one process: imports and what all controllers share are compiled once; `.ci/run` starts one of its own."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    wanted = commands()
    for arguments in wanted:
        if arguments[0] == "tune":
            arguments += ["--evaluations", "3", "--draws", "2"]  # a few of the minutes that it takes
        if "--repeat" in arguments:
            arguments[arguments.index("--repeat") + 1] = "2"
    path = os.pathsep.join((str(ROOT), str(Path(__file__).parent)))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONWARNINGS": "error::RuntimeWarning"}
    (tmp_path / "commands.json").write_text(json.dumps(wanted), encoding="utf-8")
    user = subprocess.run([sys.executable, "-c", USER], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert user.returncode == 0, user.stderr
    for arguments, done in zip(wanted, json.loads((tmp_path / "done.json").read_text(encoding="utf-8")), strict=True):
        said = f"antagonist {shlex.join(arguments)}: {done['out'][-2000:]}{done['err'][-2000:]}"
        assert done["code"] in (None, 0), f"{done['code']}: {said}"
        assert "Warning" not in done["err"], said
    missing = [name for name in OUTPUTS if not (tmp_path / name).is_file()]
    assert not missing
    assert (tmp_path / "c" / "CMakeLists.txt").is_file()
