"""`antagonist track` of several joints from a stranger's side."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import Gas, InvalidFile, save_machine
from allocator.mechanism import machines
from allocator.mechanism.bodies import BODIES
from allocator.presentation import progress
from mpc.cli import app
from mpc.model.arm.model import Arm
from mpc.model.arm.storage import load_arm, save_arm
from mpc.model.compensation import Compensation
from mpc.model.friction.dahl import Friction
from mpc.track_cli.arm import _dry_friction, _other
from mpc.tracking.qp.step import SlowStep
from mpc.trials.files import load_recording
from mpc.trials.motions import arm_trajectories as references

EXAMPLE = Path(__file__).parents[3] / "examples" / "hand_path.csv"


def run(*options):
    given = () if "--machine" in options else ("--machine", "arm26")
    return CliRunner().invoke(app, ["track", *given, *map(str, options)])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def brief(monkeypatch):
    monkeypatch.setitem(references.REFERENCES, "hold", lambda arm: references.hold(arm, 0.4))


@pytest.mark.slow
def test_it_writes_film_picture_and_table_and_says_how_it_went(folder, brief):
    result = run("hold", "--dt", "0.02", "--horizon", "8")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in folder.iterdir()) == ["tracking.csv", "tracking.gif", "tracking.png"]
    other = "not known to the controller: muscles of Wickramatunge2010", "a quarter of the friction", "M_s = "
    for said in ("angle error, shoulder [°]", "stiffness error, K12", "kept", "compiled", "filmed by", *other):
        assert said in " ".join(result.output.split())
    with (folder / "tracking.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 21  # 0.4 s of 20 ms, and the beginning
    assert abs(float(rows[-1]["shoulder_deg"]) - 20) < 0.1


@pytest.mark.slow
def test_a_pipe_learns_how_many_samples_are_left_and_the_errors_before_the_film(folder, brief, monkeypatch):
    monkeypatch.setattr(progress, "_TELLS", 0.0)
    output = run("hold", "--dt", "0.02", "--horizon", "8", "--out", "run.gif").output
    order = ("simulating: 1 of 20, about", "time of a step [ms]", "filming: 1 of 9, about", "written: run.gif")
    assert sorted(order, key=output.index) == list(order)


@pytest.mark.slow
def test_a_real_plant_under_a_load_is_followed_too(folder):
    result = run("hold", "--plant", "real", "--payload", "1", "--out", "run.csv")
    assert result.exit_code == 0, result.output
    assert "not known to the controller: muscles 5 % stronger or weaker" in " ".join(result.output.split())
    with (folder / "run.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert abs(float(rows[-1]["shoulder_deg"]) - 20) < 0.3
    assert [path.name for path in folder.iterdir()] == ["run.csv"]


@pytest.mark.slow
def test_the_hand_follows_the_example_s_path(folder):
    result = run("--reference", EXAMPLE, "--plant", "nominal", "--dt", "0.02", "--horizon", "8", "--out", "run.csv")
    assert result.exit_code == 0, result.output
    assert "trajectory: hand_path, 5.6 s" in result.output
    with (folder / "run.csv").open(encoding="utf-8") as file:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)]
    q = np.radians([[row["shoulder_deg"], row["elbow_deg"]] for row in rows])
    x, y = Arm.machine("arm26").bodies.endpoint.position(q).T * 1e3
    assert np.minimum(np.abs(np.abs(y) - 60), np.minimum(np.abs(x - 575), np.abs(x - 630))).max() < 1  # [mm]
    assert [rows[-1][name] for name in ("K11", "K12", "K22")] == pytest.approx([11.5, 3.5, 9.5], abs=0.01)


def test_a_reference_that_cannot_be_meant_is_one_sentence(folder):
    (folder / "far.csv").write_text("t,x_mm,y_mm\n0,900,0\n1,900,0\n", encoding="utf-8")
    for given, said in (
        (("--reference", "far.csv"), "far.csv, line 2: the hand does not reach (900, 0) mm"),
        (("circle", "--reference", "far.csv"), "two trajectories are asked for"),
        (("--reference", "none.csv"), "none.csv"),
    ):
        result = run(*given, "--out", "run.csv")
        assert result.exit_code != 0
        assert said in str(result.exception)


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
    rubbing = ARM.format(**ROUND).replace('damping=".2"', 'damping=".2" frictionloss=".02"')
    (folder / "mine.xml").write_text(rubbing, encoding="utf-8")
    given = ("hold", "--machine", "mine.xml", "--rest-length", "300", "--dt", "0.02", "--horizon", "6")
    with pytest.warns(SlowStep, match="not compiled"):
        result = run(*given, "--plant", "nominal", "--out", "run.png", "--out", "run.csv")
    assert result.exit_code == 0, result.output
    said = "readable", "the way of flexor", "angle error, elbow [°]", "hand: tip", "sarosi-dmsp-20-400n"
    for text in (*said, "dry friction, up to 0.02 N·m per joint; controller and observer know nothing of it"):
        assert text in " ".join(result.output.split())
    with (folder / "run.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert abs(float(rows[-1]["elbow_deg"]) - float(rows[-1]["elbow_ref_deg"])) < 0.1


def test_the_other_plant_of_an_arm_with_gas_holds_some_in_every_muscle():
    arm = replace(Arm.machine("arm26"), gas=True)
    other, _ = _other(arm)
    for muscle, own, length in zip(
        other.mechanism.muscles, arm.mechanism.muscles, arm.mechanism.routes.rest_length, strict=True
    ):
        assert type(muscle) is not type(own)
        assert 0.5 < muscle.volume_at_rest(length) / own.volume_at_rest(length) < 2


def test_a_loop_that_knows_half_of_the_dry_friction_says_so():
    known = Compensation(frictions=(Friction(coulomb=0.2), Friction(coulomb=0.1)))
    (said,) = _dry_friction([0.4, 0.2], known)
    assert said.endswith("up to 0.4 N·m per joint; controller and observer know 50% of it")
    assert [*_dry_friction([0.2, 0.1], known), *_dry_friction([0.0, 0.0], Compensation())] == []


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


@pytest.mark.slow
def test_a_recorded_run_is_a_trajectory(folder, brief):
    few = "--dt", "0.02", "--horizon", "8"
    assert run("hold", *few, "--out", "run.npz", "--out", "run.mcap").exit_code == 0
    result = run("run.npz", *few, "--out", "again.npz")
    assert result.exit_code == 0, result.output
    first, again = map(load_recording, ("run.npz", "again.npz"))
    np.testing.assert_array_equal(again.theta_ref, first.theta_ref)
    np.testing.assert_allclose(again.u, first.u, rtol=1e-6)
    assert (folder / "run.mcap").stat().st_size > 1000


def test_a_mujoco_model_has_no_recording_and_that_is_said_before_its_run(folder):
    (folder / "arm.xml").write_text(ARM.format(**STRAIGHT))
    result = run("--machine", "arm.xml", "--rest-length", "300", "--out", "run.npz")
    assert "run.npz: an arm from a MuJoCo model cannot be written to a file; keep" in str(result.exception)
    assert [path.name for path in folder.iterdir()] == ["arm.xml"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--machine", "arm99"), "arm26"),
        (("square",), "circle"),
        (("--seed", "-1"), "--seed = -1 has to be a whole number, 0 or more"),
        (("draw", "--machine", "arm48"), "n = 2 joints"),
        (("--machine", "nowhere.xml"), "does not exist"),
        (("--hand", "tip"), "--machine FILE.xml"),
        (("--stiffness-of", "foot"), "hand, joints"),
        (("--plant", "odd"), "nominal"),
        (("--out", "run.txt"), "a run is written as"),
        (("--dt", "5"), "--dt 5"),
        (("--payload", "nan"), "--payload"),
        (("--controller", "pid"), "--controller is for one joint"),
        (("--stiffness", "7"), "--stiffness is for one joint"),
        (("--amplitude", "2"), "--amplitude is for one joint"),
        (("--no-observer",), "--observer is for one joint"),
        (("--gravity", "1"), "--gravity is for one joint"),
        (("--frequency", "3"), "K of an arm is isobaric"),
        (("--radius", "20"), "--radius is for one joint"),
        (("--lag", "0.1:0.2"), "--lag 0.1:0.2: expected one time or 6, one a muscle"),
        (("--muscle", "sarosi-dmsp-20-400n", "--muscle", "sarosi-dmsp-20-200n"), "--muscle is given 2 times"),
    ],
)
def test_what_makes_no_sense_is_one_sentence(folder, options, said):
    result = run(*options)
    assert result.exit_code != 0
    assert said in str(result.exception)
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_an_arm_that_init_wrote_and_somebody_edited_is_followed(folder, brief):
    assert CliRunner().invoke(app, ["init", "mine.toml", "--machine", "arm26"]).exit_code == 0
    assert load_arm("mine.toml") == Arm.machine("arm26")
    text = (folder / "mine.toml").read_text(encoding="utf-8")
    (folder / "mine.toml").write_text(text.replace("lag = 0.1", "lag = 0.08"), encoding="utf-8")
    given = (
        "--machine",
        "mine.toml",
        "--supply",
        "6",
        "--slew",
        "7",
        "--out",
        "run.csv",
        "--dt",
        "0.02",
        "--horizon",
        "6",
    )
    result = run("hold", *given)
    assert result.exit_code == 0, result.output
    assert "2 joints, 6 muscles, lag 0.08 s, slew 7 bar/s" in result.output
    said = run("hold", "--machine", "mine.toml", "--out", "mine.toml", "--force").exception
    assert "a run is written as" in str(said)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[bodies]", "[links]", "the file of a machine with the routes Pulleys has no links"),
        ("lag = 0.1", "lagg = 0.1", r"\[plant\] has no lagg; it has lag, slew, gas"),
        ("slew = 500000.0", "slew = 5.0", "if bar/s was meant"),
        ("mass =", "masses =", r"\[bodies\] has no masses; it has length, mass"),
        ("mass = [1.2, 0.8]", "mass = [1.2]", r"\[bodies\]: Bodies: mass"),
    ],
)
def test_a_file_that_is_no_arm_is_refused_by_its_name(folder, old, new, said):
    save_arm(Arm.machine("arm26"), "mine.toml")
    text = (folder / "mine.toml").read_text(encoding="utf-8")
    assert old in text
    (folder / "mine.toml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InvalidFile, match=said) as refusal:
        load_arm("mine.toml")
    assert str(refusal.value).startswith("mine.toml")


def test_arms_come_back_from_their_files(folder):
    crooked = replace(BODIES["leg37"](), centre=(0.1, 0.2, 0.05), gravity=(3.0, -9.0))
    for arm in (Arm.machine("arm48"), replace(Arm.machine("leg37"), bodies=crooked)):
        save_arm(arm, "mine.toml")
        assert load_arm("mine.toml") == arm
        arm = replace(arm, lag=tuple(0.05 + 0.01 * i for i in range(arm.m)), gas=Gas(kappa=1.2))
        save_arm(arm, "mine.toml")
        assert load_arm("mine.toml") == arm


def test_one_joint_has_no_hand(folder):
    said = CliRunner().invoke(app, ["track", "--hand", "tip"]).exception
    assert "go with a --machine of several joints" in str(said)
    save_machine(machines.arm26(), "still.toml")
    assert "is not an arm that can move: the table [bodies] is missing" in str(run("--machine", "still.toml").exception)
