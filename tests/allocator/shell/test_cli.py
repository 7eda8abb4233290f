"""`antagonist allocate` as a person meets it."""

import json
import math
import re
import subprocess
import sys

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from allocator import Muscle, allocate, report_joint
from allocator.machine_file import save_machine
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.cli import app


def antagonist(*arguments):
    code = "import sys; from mpc.cli import main; sys.argv[0] = 'antagonist'; main()"
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)


def test_allocate_prints_what_the_library_answers():
    result = CliRunner().invoke(app, ["allocate", "--theta", "30", "--stiffness", "7.5", "--torque", "1"])
    answer = allocate(30 * DEG, 7.5, 1.0)
    assert result.exit_code == 0
    for text in ("EXACT", f"{answer.P1 / BAR:.4f}", f"{answer.P2 / BAR:.4f}", "torque and stiffness are met"):
        assert text in result.output


def test_allocate_holds_the_link_of_a_file_against_its_gravity(tmp_path):
    path = tmp_path / "plant.toml"
    save_machine(report_joint(), path)
    with path.open("a") as file:
        file.write("\n[plant]\ngravity_torque = 2.0\nhanging_angle = 0.1\n")
    asked = ["allocate", "--machine", str(path), "--theta", "30", "--stiffness", "7.5", "--torque", "0.5"]
    result = CliRunner().invoke(app, asked)
    weight = 2.0 * math.sin(30 * DEG - 0.1)
    answer = allocate(30 * DEG, 7.5, 0.5 + weight)
    assert f"{answer.P1 / BAR:.4f}" in result.output
    assert f"{weight:.3g} N·m of the torque balance gravity" in result.output
    assert json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)["gravity_Nm"] == pytest.approx(weight)


def test_allocate_says_what_is_in_the_way():
    result = CliRunner().invoke(app, ["allocate", "--theta", "30", "--stiffness", "20"])
    assert result.exit_code == 3
    assert "STIFFNESS_LIMITED" in result.output
    assert "P1 upper" in result.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--theta", "30", "--stiffness", "-1"], "K = -1 N·m/rad has to be positive"),
        (["--theta", "3000", "--stiffness", "7"], "theta = 3000° is over a turn"),
        (["--theta", "30", "--stiffness", "7", "--method", "magic"], "unknown method 'magic'"),
        (["--theta", "nan", "--stiffness", "7"], "--theta nan: expected a finite number [degrees]"),
        (["--theta", "30", "--stiffness", "7", "--muscle", "biceps"], "unknown muscle 'biceps'"),
        (["--theta", "30", "--stiffness", "7", "--muscle", "none.toml"], "none.toml: does not exist"),
        (["--theta", "30", "--stiffness", "7", "--solver", "daqp"], "belongs to the methods convex, nlp, qp"),
    ],
)
def test_wrong_input_is_one_sentence_and_a_code(arguments, said):
    done = antagonist("allocate", *arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_a_fitted_muscle_goes_from_file_to_pressures(tmp_path):
    """`antagonist fit` writes what `antagonist allocate --muscle` and `Muscle.load` read."""
    path = tmp_path / "my.toml"
    fitted = CliRunner().invoke(app, ["fit", "--model", "Sarosi2012", "--out", str(path)])
    assert fitted.exit_code == 0
    arguments = ["--theta", "10", "--stiffness", "5", "--torque", "1", "--muscle", str(path)]
    result = CliRunner().invoke(app, ["allocate", *arguments])
    answer = allocate(10 * DEG, 5.0, 1.0, joint=report_joint(Muscle.load(path)))
    assert result.exit_code == 0
    assert f"{answer.P1 / BAR:.4f}" in result.output
    assert f"{answer.K_std:.2g}" in result.output


def test_a_muscle_without_covariance_has_no_standard_deviation(tmp_path):
    """A fitted agonist beside a published antagonist, whose error is unknown, not 0."""
    path = tmp_path / "my.toml"
    assert CliRunner().invoke(app, ["fit", "--model", "Sarosi2012", "--out", str(path)]).exit_code == 0
    mixed = ["allocate", "--theta", "10", "--stiffness", "5", "--agonist", str(path)]
    mixed += ["--antagonist", "sarosi-dmsp-20-400n"]
    said = json.loads(CliRunner().invoke(app, [*mixed, "--json"]).stdout)
    assert said["F1_std_N"] > 0
    assert said["F2_std_N"] is None
    shown = CliRunner().invoke(app, mixed).output
    assert "± 0 N" not in shown
    assert "antagonist counts as exact" in shown


@pytest.mark.parametrize("method", ["exact", "qp", "nlp", "convex"])
def test_every_method_answers_on_the_command_line(method):
    result = CliRunner().invoke(app, ["allocate", "--theta", "10", "--stiffness", "7.5", "--method", method])
    assert result.exit_code == 0
    assert "EXACT" in result.output


def test_a_joint_goes_from_file_to_pressures(tmp_path):
    joint, path = report_joint(SAROSI_DMSP_20_400N), tmp_path / "joint.toml"
    save_machine(joint, path)
    result = CliRunner().invoke(app, ["allocate", "--theta", "10", "--stiffness", "6", "--machine", str(path)])
    assert result.exit_code == 0
    assert f"{allocate(10 * DEG, 6.0, joint=joint).P1 / BAR:.4f}" in result.output


@pytest.mark.compiles
@pytest.mark.parametrize("command", ["allocate", "map", "fit", "fit-joint", "plan-joint", "track"])
def test_the_help_keeps_the_units(command):
    shown = CliRunner().invoke(app, [command, "--help-all"]).output
    options = [param for param in get_command(app).commands[command].params if param.help]
    units = {unit for option in options for unit in re.findall(r"\[[^\]]+\]", option.help)}
    assert units or command == "fit"
    joined = " ".join(shown.split())
    assert all(unit in joined for unit in units)
