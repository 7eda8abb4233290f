"""`antagonist allocate` as a person meets it."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from allocator import allocate
from allocator.cli import app
from allocator.units import BAR, DEG


def antagonist(*arguments):
    code = "import sys; from mpc.cli import main; sys.argv[0] = 'antagonist'; main()"
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)


def test_allocate_prints_what_the_library_answers():
    result = CliRunner().invoke(app, ["allocate", "--theta", "30", "--stiffness", "7.5", "--torque", "1"])
    answer = allocate(30 * DEG, 7.5, 1.0)
    assert result.exit_code == 0
    for text in ("EXACT", f"{answer.P1 / BAR:.4f}", f"{answer.P2 / BAR:.4f}", "torque and stiffness are met"):
        assert text in result.output


def test_allocate_says_what_is_in_the_way():
    result = CliRunner().invoke(app, ["allocate", "--theta", "30", "--stiffness", "20"])
    assert result.exit_code == 0
    assert "STIFFNESS_LIMITED" in result.output
    assert "P1 upper" in result.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--theta", "30", "--stiffness", "-1"], "K = -1 N·m/rad has to be positive"),
        (["--theta", "3000", "--stiffness", "7"], "over a turn"),
        (["--theta", "30", "--stiffness", "7", "--method", "magic"], "unknown method 'magic'"),
        (["--theta", "nan", "--stiffness", "7"], "theta = nan is not finite"),
    ],
)
def test_wrong_input_is_one_sentence_and_a_code(arguments, said):
    done = antagonist("allocate", *arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
