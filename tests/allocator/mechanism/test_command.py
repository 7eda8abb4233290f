"""`antagonist allocate --mechanism`: degrees and bar outside, one sentence for what is wrong."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import InvalidInput
from allocator.cli import app
from allocator.mechanism import allocate_mechanism, machines, save_mechanism
from allocator.units import BAR, DEG

ARM = ("allocate", "--mechanism", "arm26")


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_the_answer_is_that_of_python():
    done = run(*ARM, "--posture", "23,-17", "--torque", "9.36,4.09", "--stiffness", "10.17,3.98,8.76", "--json")
    assert done.exit_code == 0
    printed = json.loads(done.stdout)
    K = [[10.17, 3.98], [3.98, 8.76]]
    a = allocate_mechanism(machines.arm26(), np.array([23, -17]) * DEG, K, [9.36, 4.09])
    assert printed["P_bar"] == pytest.approx(a.P / BAR, rel=1e-12)
    assert printed["status"] == "EXACT"
    assert printed["met"]
    assert printed["holds_itself"]
    assert printed["separating_reach"] is None


def test_what_cannot_be_met_has_its_exit_code_and_its_muscles():
    done = run(*ARM, "--posture", "23,-17", "--torque", "9.36,4.09", "--stiffness", "20")
    assert done.exit_code == 3
    assert "STIFFNESS_LIMITED" in done.stdout
    assert "in the way: shoulder flexor upper" in done.stdout
    done = run(*ARM, "--posture", "23,-17", "--stiffness", "20,19", "--priority", "stiffness", "--json")
    printed = json.loads(done.stdout)
    assert printed["separating_reach"] < printed["separating_asked"]


def test_a_file_stands_for_a_machine(tmp_path):
    path = tmp_path / "leg.toml"
    save_mechanism(machines.leg37(), path)
    asked = ("--posture", "5,-5,10", "--torque", "1", "--stiffness", "20,15,9", "--json")
    assert run("allocate", "--mechanism", path, *asked).stdout == run("allocate", "--mechanism", "leg37", *asked).stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--stiffness", "9"), "needs --posture, 2 angles"),
        (("--stiffness", "9", "--posture", "1,2,3"), "--posture 1,2,3: expected 2 .the angles of shoulder, elbow"),
        (("--stiffness", "9", "--posture", "1,x"), "--posture 1,x: expected 2"),
        (("--stiffness", "9", "--posture", "1,400"), "over a turn"),
        (("--stiffness", "9,8,7,6", "--posture", "1,2"), "expected 1 .* or 2 .* or 3 .the upper triangle"),
        (("--stiffness", "inf", "--posture", "1,2"), "expected a finite number"),
        (("--stiffness", "9,50,9", "--posture", "1,2"), "has to be positive definite"),
        (("--stiffness", "9", "--posture", "1,2", "--theta", "5"), "--theta is of a joint"),
        (("--stiffness", "9", "--posture", "1,2", "--radius", "20"), "without the options of a joint"),
        (("--stiffness", "9", "--posture", "1,2", "--valves", "shut"), "a mechanism.s stiffness is isobaric"),
        (("--stiffness", "9", "--posture", "1,2", "--torque", "1,2,3"), "--torque 1,2,3: expected 1"),
    ],
)
def test_wrong_options(arguments, sentence):
    done = run(*ARM, *arguments)
    assert isinstance(done.exception, InvalidInput)
    with pytest.raises(InvalidInput, match=sentence):
        raise done.exception


@pytest.mark.parametrize(
    "arguments", ["--stiffness 7", "--theta 5 --stiffness 7 --posture 1", "--theta 5 --stiffness 7,8"]
)
def test_a_joint_needs_an_angle_and_one_stiffness(arguments):
    done = run("allocate", *arguments.split())
    assert isinstance(done.exception, InvalidInput)
