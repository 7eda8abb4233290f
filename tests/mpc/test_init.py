"""`antagonist init` with a muscle."""

import pytest
from typer.testing import CliRunner

from allocator.errors import InvalidInput
from allocator.machine_file import load_joint
from allocator.muscles.catalogue import MUSCLES
from mpc import Plant
from mpc.cli import app
from mpc.model.arm.storage import load_arm


def init(path, *options):
    return CliRunner().invoke(app, ["init", str(path), *map(str, options)])


@pytest.mark.parametrize("name", MUSCLES)
def test_a_file_is_written_with_a_muscle_of_the_catalogue(name, tmp_path):
    assert init(tmp_path / "joint.toml", "--muscle", name, "--no-gas").exit_code == 0
    joint = load_joint(tmp_path / "joint.toml")
    assert joint.agonist == joint.antagonist == MUSCLES[name]
    assert Plant.load(tmp_path / "joint.toml").gas is None
    assert init(tmp_path / "arm.toml", "--muscle", name, "--machine", "arm26").exit_code == 0
    assert load_arm(tmp_path / "arm.toml").mechanism.muscles == (MUSCLES[name],) * 6


def test_the_muscle_may_be_a_file_which_is_not_written_over(tmp_path):
    mine = tmp_path / "mine.toml"
    MUSCLES["martens-dmsp-20-300"].save(mine)
    assert init(tmp_path / "joint.toml", "--muscle", mine).exit_code == 0
    assert load_joint(tmp_path / "joint.toml").agonist == MUSCLES["martens-dmsp-20-300"]
    refused = init(mine, "--muscle", mine, "--force").exception
    assert isinstance(refused, InvalidInput)
    assert "is read by this command" in str(refused)


def test_an_unknown_muscle_is_refused_with_those_that_there_are(tmp_path):
    refused = init(tmp_path / "joint.toml", "--muscle", "nope").exception
    assert "unknown muscle 'nope'; available: " in str(refused)
    assert not (tmp_path / "joint.toml").exists()
