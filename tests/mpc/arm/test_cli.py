"""`antagonist arm` from a stranger's side."""

import csv

import pytest
from typer.testing import CliRunner

from mpc.cli import app
from mpc.tracking.qp.step import SlowStep
from mpc.trials import arm_trajectories as references


def run(*options):
    return CliRunner().invoke(app, ["arm", *map(str, options)])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def brief(monkeypatch):
    monkeypatch.setitem(references.REFERENCES, "hold", lambda arm: references.hold(arm, 0.4))


@pytest.mark.slow
def test_it_writes_film_picture_and_table_and_says_how_it_went(folder, brief):
    result = run("--reference", "hold", "--dt", "0.02", "--horizon", "8")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in folder.iterdir()) == ["arm.csv", "arm.gif", "arm.png"]
    for said in ("angle error, shoulder [°]", "stiffness error, K12", "kept", "compiled", "filmed by"):
        assert said in result.output
    with (folder / "arm.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 21  # 0.4 s of 20 ms, and the beginning
    assert abs(float(rows[-1]["shoulder_deg"]) - 20) < 0.1


@pytest.mark.slow
def test_a_real_plant_under_a_load_is_followed_too(folder):
    result = run("--reference", "hold", "--plant", "real", "--load", "1", "--out", "run.csv")
    assert result.exit_code == 0, result.output
    with (folder / "run.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert abs(float(rows[-1]["shoulder_deg"]) - 20) < 0.3
    assert [path.name for path in folder.iterdir()] == ["run.csv"]


ARM = """<mujoco><worldbody><site name="a" pos="-.3 .05 0"/><site name="b" pos="-.3 -.05 0"/>
<body><joint name="elbow" axis="0 0 1" damping=".2" range="-45 45"/>
<geom name="roll" type="cylinder" size=".06 .02" mass=".1"/>
<site name="s" pos="0 .08 0"/><site name="t" pos="0 -.08 0"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".01" mass=".5" contype="0" conaffinity="0"/>
<site name="c" pos=".05 .05 0"/><site name="d" pos=".05 -.05 0"/><site name="tip" pos=".25 0 0"/></body></worldbody>
<tendon><spatial name="flexor"><site site="a"/>{over}<site site="c"/></spatial>
<spatial name="extensor"><site site="b"/>{under}<site site="d"/></spatial></tendon></mujoco>"""
STRAIGHT = {"over": "", "under": ""}
ROUND = {"over": '<geom geom="roll" sidesite="s"/>', "under": '<geom geom="roll" sidesite="t"/>'}


@pytest.mark.slow
def test_a_stranger_s_model_is_moved_and_drawn(folder, brief):
    (folder / "mine.xml").write_text(ARM.format(**ROUND), encoding="utf-8")
    given = ("--machine", "mine.xml", "--rest-length", "300", "--reference", "hold", "--dt", "0.02", "--horizon", "6")
    with pytest.warns(SlowStep, match="not compiled"):
        result = run(*given, "--out", "run.png", "--out", "run.csv")
    assert result.exit_code == 0, result.output
    for text in ("readable", "the way of flexor", "angle error, elbow [°]", "hand: tip", "sarosi-dmsp-20-400n"):
        assert text in " ".join(result.output.split())
    with (folder / "run.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert abs(float(rows[-1]["elbow_deg"]) - float(rows[-1]["elbow_ref_deg"])) < 0.1


def test_a_model_that_does_not_tell_its_muscles_lengths_is_asked_for_them(folder):
    (folder / "mine.xml").write_text(ARM.format(**STRAIGHT), encoding="utf-8")
    result = run("--machine", "mine.xml")
    assert "its tendons are 350" in str(result.exception)


def test_other_files_are_not_replaced_silently(folder):
    (folder / "run.csv").write_text("mine\n")
    result = run("--out", "run.csv")
    assert result.exit_code != 0
    assert "run.csv exists; give another name, or --force" in str(result.exception)
    assert (folder / "run.csv").read_text() == "mine\n"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--machine", "arm99"), "arm26"),
        (("--reference", "square"), "circle"),
        (("--seed", "-1"), "--seed = -1 has to be a whole number, 0 or more"),
        (("--reference", "draw", "--machine", "arm48"), "n = 2 joints"),
        (("--machine", "nowhere.xml"), "does not exist"),
        (("--muscle", "sarosi-dmsp-20-400n"), "--machine FILE.xml"),
        (("--track", "foot"), "hand, joints"),
        (("--plant", "odd"), "nominal"),
        (("--out", "run.txt"), "a run is written as"),
        (("--dt", "5"), "--dt 5"),
        (("--load", "nan"), "--load"),
    ],
)
def test_what_makes_no_sense_is_one_sentence(folder, options, said):
    result = run(*options)
    assert result.exit_code != 0
    assert said in str(result.exception)
    assert not list(folder.iterdir())
