"""Nothing of the user's is destroyed: inputs stay, files that exist stay, and files appear whole or not at all."""

import os
import stat
from pathlib import Path

import pytest
from typer.testing import CliRunner

from allocator.errors import CannotWrite, InvalidInput
from allocator.files.atomic import check_writable, replacing, write_text
from allocator.shell.outputs import claim
from mpc.cli import app

CSV = "contraction,pressure_bar,force_N\n" + "".join(
    f"{e / 100},{p},{max(300 * p * (1 - 4 * e / 100), 0):.1f}\n" for p in (1, 3, 5) for e in range(0, 21, 2)
)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(*arguments):
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code != 0
    return str(result.exception)


# --- commands -------------------------------------------------------------------------------------------------------


@pytest.mark.compiles
def test_no_command_writes_over_what_it_reads(here):
    (here / "data.csv").write_text(CSV)
    (here / "track.csv").write_text("t,theta_deg,stiffness\n0,0,7\n1,1,7\n")
    os.link("data.csv", "linked.toml")
    os.symlink("data.csv", "symbolic.toml")
    assert CliRunner().invoke(app, ["init", "joint.toml"]).exit_code == 0
    before = {path.name: path.read_bytes() for path in here.iterdir()}
    for arguments in (
        ("fit", "data.csv", "--out", "data.csv"),
        ("fit", "data.csv", "--out", "./sub/../data.csv"),
        ("fit", "data.csv", "--out", "linked.toml"),
        ("fit", "data.csv", "--out", "symbolic.toml"),
        ("fit-joint", "data.csv", "--out", "data.csv", "--pulley", "20,0.1", "--rest-length", "400"),
        ("track", "track.csv", "--out", "track.csv"),
    ):
        assert "is read by this command" in refused(*arguments, "--force")
    assert {path.name: path.read_bytes() for path in here.iterdir()} == before


def test_a_run_that_is_read_as_a_trajectory_is_not_written_over_by_the_default_name(here):
    (here / "tracking.csv").write_text("t,theta_deg,stiffness\n0,0,7\n1,1,7\n")
    assert "tracking.csv is read by this command" in refused("track", "tracking.csv")


def test_a_file_that_exists_is_replaced_only_by_force(here):
    (here / "data.csv").write_text(CSV)
    (here / "my.toml").write_text("mine")
    arguments = ("fit", "data.csv", "--model", "AffinePolynomial", "--out", "my.toml")
    assert "my.toml exists; give another name, or --force to replace it" in refused(*arguments)
    assert (here / "my.toml").read_text() == "mine"
    assert CliRunner().invoke(app, [*arguments, "--force"]).exit_code == 0
    assert "AffinePolynomial" in (here / "my.toml").read_text()


def test_a_command_replaces_files_of_its_own_default_name(here):
    for _ in range(2):
        assert CliRunner().invoke(app, ["map", "--stiffness", "6:9:1"]).exit_code == 0
    assert [path.name for path in here.iterdir()] == ["map.png"]


def test_a_link_to_itself_is_said(here):
    os.symlink("loop.csv", "loop.csv")
    assert "loop.csv: cannot be read (Too many levels of symbolic links)" in refused(
        "fit", "loop.csv", "--out", "x.toml"
    )
    claim(here / "loop.csv")


def test_one_file_cannot_be_two_outputs(here):
    with pytest.raises(InvalidInput, match="to be written twice"):
        claim(here / "x.png", here / "sub" / ".." / "x.png")


@pytest.mark.compiles
@pytest.mark.parametrize(
    "arguments",
    [
        ("init", "new/folder/x.toml"),
        ("map", "--stiffness", "6:9:1", "--out", "new/folder/x.csv"),
        ("map", "--stiffness", "6:9:1", "--out", "new/folder/x.npz"),
        ("fit", "data.csv", "--model", "AffinePolynomial", "--out", "new/folder/x.toml", "--plot", "new/other/x.png"),
        ("export", "allocation", "--out", "new/folder/c"),
    ],
    ids=lambda arguments: f"{arguments[0]} {arguments[-1]}",
)
def test_missing_directories_are_made(arguments, here):
    (here / "data.csv").write_text(CSV)
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    assert [*(here / "new" / "folder").iterdir()]


# --- the files ------------------------------------------------------------------------------------------------------


def test_what_is_half_written_never_shows(tmp_path):
    path = tmp_path / "a.toml"
    write_text(path, "old")
    seen = []

    def interrupted():
        with replacing(path) as draft:
            draft.write_text("half")
            seen.append(path.read_text())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert seen == ["old"]
    assert path.read_text() == "old"
    assert [*tmp_path.iterdir()] == [path]


def test_a_link_stays_a_link_and_rights_stay_rights(tmp_path):
    path, link = tmp_path / "a.toml", tmp_path / "link.toml"
    path.write_text("old")
    path.chmod(0o640)
    link.symlink_to(path)
    write_text(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_device_is_written_to_and_not_replaced():
    with pytest.raises(CannotWrite, match="/dev/full cannot be written"):
        write_text("/dev/full", "x" * 100_000)
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


def test_write_protection_is_respected(tmp_path, monkeypatch):
    """Also of a file in a directory whose files could be replaced; tests may run as root, so the system is played."""
    path = tmp_path / "a.toml"
    path.write_text("old")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(CannotWrite, match="write-protected"):
        write_text(path, "new")
    assert path.read_text() == "old"
    monkeypatch.setattr(os, "access", lambda place, _: Path(place) != tmp_path)
    for name in ("a.toml", "new.toml", "new/new.toml"):
        with pytest.raises(CannotWrite, match=f"the directory {tmp_path} is write-protected"):
            check_writable(tmp_path / name)
