"""A joint and a plant of one's own from the shell."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import AntagonistJoint, Lever, allocate, report_joint, save_machine
from allocator.errors import InvalidFile
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.shell.machine_options import MachineOptions
from allocator.units import BAR, DEG
from mpc import Plant
from mpc.cli import app
from mpc.plant_cli import PlantOptions
from mpc.trials.files import load_recording

LEVER = AntagonistJoint(
    Lever(rest_length=0.4, anchor=0.3, lever=0.03, offset=0.0435),
    SAROSI_DMSP_20_400N,
    SAROSI_DMSP_20_200N,
    friction=0.1,
)
PLANT = Plant(LEVER, inertia=0.02, damping=0.3, lag=(0.05, 0.08), gravity_torque=-0.5, slew=8 * BAR)
ERRORS = "--errors", "theta=0.1,rate=0.3"  # without them robust weights are searched for, which takes seconds
SHORT = ("--dt", "0.02", "--controller", "feedforward", "--plant", "nominal")


def antagonist(*arguments):
    result = CliRunner().invoke(app, [*map(str, arguments)])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.output


def test_a_plant_goes_to_its_file_and_back(tmp_path):
    PLANT.save(tmp_path / "plant.toml")
    assert Plant.load(tmp_path / "plant.toml") == PLANT


def test_a_joint_s_file_is_a_plant_with_the_usual_numbers(tmp_path):
    save_machine(LEVER, tmp_path / "joint.toml")
    assert Plant.load(tmp_path / "joint.toml") == Plant(LEVER)


def test_what_init_writes_is_the_plant_that_is_used_without_it(tmp_path):
    path = tmp_path / "joint.toml"
    antagonist("init", path)
    assert Plant.load(path) == Plant()
    assert path.read_text(encoding="utf-8").count("#") > 20


def test_without_options_the_joint_is_the_report_s():
    assert MachineOptions().build() == report_joint()
    assert PlantOptions().plant() == Plant()


def test_options_change_what_the_file_says_and_nothing_else(tmp_path):
    PLANT.save(tmp_path / "plant.toml")
    options = PlantOptions(machine=str(tmp_path / "plant.toml"), supply=4.0, inertia=0.07, lag="0.2", stops="-30:40")
    joint = replace(LEVER, pressure_limits=(0.0, 4 * BAR), angle_limits=(-30 * DEG, 40 * DEG))
    assert options.plant() == replace(PLANT, joint=joint, inertia=0.07, lag=(0.2, 0.2))


def test_a_wrong_number_of_a_plant_s_file_is_blamed_on_the_file(tmp_path):
    path = tmp_path / "plant.toml"
    PLANT.save(path)
    path.write_text(path.read_text(encoding="utf-8").replace("inertia = 0.02", "inertia = -0.02"), encoding="utf-8")
    with pytest.raises(InvalidFile, match=r"plant\.toml: \[plant\]: inertia = -0.02"):
        PlantOptions(machine=str(path)).plant()


def test_every_option_of_the_joint_and_the_plant_arrives():
    plant = PlantOptions(
        muscle=["sarosi-dmsp-20-400n"], antagonist="sarosi-dmsp-20-200n", radius=25, rest_length="300",
        initial_contraction="0.12", supply=6, stops="-50:60", friction=0.1, inertia=0.01, damping=0.2, lag="0.05:0.06",
        gravity="-0.4,20", slew=7,
    ).plant()  # fmt: skip
    joint = plant.joint
    assert (joint.agonist, joint.antagonist) == (SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N)
    assert joint.geometry.radius == pytest.approx(0.025)
    assert joint.geometry.rest_length == pytest.approx(0.3)
    assert joint.geometry.initial_contraction == 0.12
    assert joint.pressure_limits == pytest.approx((0, 6 * BAR))
    assert joint.angle_limits == pytest.approx((-50 * DEG, 60 * DEG))
    assert (joint.friction, plant.inertia, plant.damping) == (0.1, 0.01, 0.2)
    assert plant.lags == (0.05, 0.06)
    assert (plant.gravity_torque, plant.hanging_angle, plant.slew) == pytest.approx((-0.4, 20 * DEG, 7 * BAR))


def test_two_different_muscles_pull_on_the_joint_that_allocate_answers_for():
    said = antagonist(
        "allocate", "--theta", 10, "--stiffness", 6, "--json",
        "--agonist", "sarosi-dmsp-20-400n", "--antagonist", "sarosi-dmsp-20-200n", "--supply", 6,
    )  # fmt: skip
    muscles = {"agonist": SAROSI_DMSP_20_400N, "antagonist": SAROSI_DMSP_20_200N}
    joint = replace(report_joint(), **muscles, pressure_limits=(0.0, 6 * BAR))
    assert json.loads(said)["P1_bar"] * BAR == pytest.approx(allocate(10 * DEG, 6.0, joint=joint).P1)


@pytest.mark.slow
def test_every_command_takes_the_plant_s_file(tmp_path):
    path = tmp_path / "plant.toml"
    PLANT.save(path)
    run, table = tmp_path / "run.npz", tmp_path / "map.npz"
    antagonist("allocate", "--machine", path, "--theta", 0, "--stiffness", 12)
    antagonist("map", "--machine", path, "--out", table)
    antagonist("track", "steps", "--machine", path, "--out", run, *SHORT)
    said = antagonist("export", "controller", "--machine", path, "--out", tmp_path / "c", "--horizon", 5, *ERRORS)
    assert load_recording(run).plant == PLANT
    with np.load(table) as stored:
        assert stored["theta"][[0, -1]] == pytest.approx(LEVER.angle_range)
    numbers = "inertia 0.02 kg·m², damping 0.3 N·m·s/rad, lag 0.05 and 0.08 s, gravity -0.5 N·m, slew 8 bar/s"
    assert numbers in said
    assert numbers in (tmp_path / "c" / "README.md").read_text(encoding="utf-8")


@pytest.mark.compiles
def test_the_inertia_of_the_shell_reaches_the_run_and_the_c_code(tmp_path):
    run = tmp_path / "run.npz"
    said = antagonist("track", "steps", "--inertia", 0.03, "--gravity", 0.7, "--out", run, *SHORT)
    assert "plant: inertia 0.03 kg·m²" in said
    plant = load_recording(run).plant
    assert (plant.inertia, plant.gravity_torque) == (0.03, 0.7)
    models = []
    for inertia in (0.03, 0.06):
        given = "--inertia", inertia, "--horizon", 5, "--alone", *ERRORS
        antagonist("export", "controller", "--out", tmp_path / str(inertia), *given)
        models.append((tmp_path / str(inertia) / "src" / "model.c").read_text())
    assert models[0] != models[1]


def test_a_file_with_a_word_too_many_is_refused(tmp_path):
    PLANT.save(tmp_path / "plant.toml")
    text = (tmp_path / "plant.toml").read_text(encoding="utf-8")
    for wrong, said in (
        (
            text.replace("[plant]", "[plnat]"),
            "the file of a joint with the routes Lever has no plnat; it has machine, routes, muscle",
        ),
        (
            text.replace("\nlever = ", "\nlevel = "),
            r"^[^:]*: \[routes\]: a Lever has no level; it has rest_length, anchor",
        ),
        (re.sub("\nlever = .*", "", text), r"\[routes\]: a Lever needs lever$"),
        (re.sub("rest_length = .*", "rest_length = 400", text), r"rest_length = 400 m .* pass 0.4"),
        (text.replace("damping", "dampling"), r"\[plant\] has no dampling"),
        (
            text.replace("inertia = 0.02", "inertia = -1"),
            r"\[plant\]: inertia = -1 has to be one number above 0",
        ),
        (text.replace("inertia = 0.02", 'inertia = "much"'), r"inertia = 'much' is not a number"),
    ):
        (tmp_path / "wrong.toml").write_text(wrong, encoding="utf-8")
        with pytest.raises(InvalidFile, match=said):
            Plant.load(tmp_path / "wrong.toml")


def test_the_list_of_muscles_names_every_muscle_and_model():
    from allocator.muscles import MODELS
    from allocator.muscles.catalogue import MUSCLES, SOURCES

    said = antagonist("muscles")
    assert all(name in said for name in [*MUSCLES, *MODELS])
    assert SOURCES.keys() == MUSCLES.keys()
